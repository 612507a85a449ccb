"""What takes long of a scan is worked out beside the loop, before a tick gets it."""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import SsmError
from ..monitor import PreparedScan, RangeReader

SWITCH_INTERVAL_S = 2e-4
"""How long the loop may have to wait for the interpreter while the thread uses it; 5 ms is Python's own."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ready:
    """A scan that a tick may have.

    Attributes:
        prepared: The scan.
        arrived_ns: When it arrived, monotonic [ns]: being prepared makes it no younger.
    """

    prepared: PreparedScan
    arrived_ns: int


class ScanPreparation:
    """A thread that prepares the newest scan; what came meanwhile is left out, but for the last.

    The compiled search holds no lock of the interpreter, so the loop runs on. A scan that fails is dropped
    and told, and the source grows stale.

    Args:
        reader: Prepares scans; nobody else may ask it to.
        failed: Called in the thread with what went wrong.
    """

    def __init__(self, reader: RangeReader, failed: Callable[[str], None]) -> None:
        self._reader = reader
        self._failed = failed
        self._changed = threading.Condition()
        self._waiting: tuple[NDArray[np.float64], NDArray[np.float64], int] | None = None
        self._ready: deque[Ready] = deque(maxlen=1)
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        threading.Thread(target=self._run, name="scans", daemon=True).start()

    def submit(self, ranges: NDArray[np.float64], position: NDArray[np.float64], arrived_ns: int) -> None:
        """Have a scan prepared, in place of one that still waits.

        Args:
            ranges: (m,), [m].
            position: (n,), [rad], when it arrived.
            arrived_ns: When that was at the latest, monotonic [ns].
        """
        with self._changed:
            self._waiting = ranges, position, arrived_ns
            self._changed.notify()

    def take(self) -> Ready | None:
        """Return the newest scan that is ready, once."""
        return self._ready.popleft() if self._ready else None

    def _run(self) -> None:
        while True:
            with self._changed:
                while self._waiting is None:
                    self._changed.wait()
                ranges, position, arrived_ns = self._waiting
                self._waiting = None
            try:
                prepared = self._reader.prepare(ranges, position)
            except SsmError as error:
                self._failed(str(error))
                continue
            self._ready.append(Ready(prepared=prepared, arrived_ns=arrived_ns))

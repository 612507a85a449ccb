"""Counters and timings of a running service."""

from __future__ import annotations

import itertools
import os
from collections import Counter, deque
from pathlib import Path

import numpy as np

WINDOW = 5000
"""Ticks over which percentiles are taken."""

INTERVALS = 16
"""Times between two values of which the longest counts as the period."""


class Timings:
    """The last ``WINDOW`` durations, for percentiles; adding one costs no allocation."""

    def __init__(self) -> None:
        self._values = np.zeros(WINDOW, dtype=np.int64)
        self._count = 0

    def add(self, duration_ns: int) -> None:
        """Add a duration [ns]."""
        self._values[self._count % WINDOW] = duration_ns
        self._count += 1

    def summary(self) -> dict[str, float]:
        """Return p50, p99 and max [µs] over the window; empty before the first."""
        if self._count == 0:
            return {}
        values = self._values[: min(self._count, WINDOW)]
        p50, p99 = np.percentile(values, [50, 99]).tolist()
        return {"p50": p50 / 1e3, "p99": p99 / 1e3, "max": int(values.max()) / 1e3}


class RecentGreatest:
    """The greatest value of the last while: of at least ``window_ns``, and of at most twice that.

    Args:
        window_ns: The while [ns].
    """

    def __init__(self, window_ns: int) -> None:
        self._window_ns = window_ns
        self._begin_ns = 0
        self._values: tuple[int | None, int | None] = None, None

    def add(self, value: int, now_ns: int) -> None:
        """Add a value at a time, monotonic [ns]."""
        before, latest = self._moved(now_ns)
        self._values = before, value if latest is None else max(value, latest)

    def at(self, now_ns: int) -> int | None:
        """Return the greatest value; ``None`` where there was none lately."""
        before, latest = self._moved(now_ns)
        if before is None or latest is None:
            return latest if before is None else before
        return max(before, latest)

    def _moved(self, now_ns: int) -> tuple[int | None, int | None]:
        windows = (now_ns - self._begin_ns) // self._window_ns
        if windows > 0:
            latest = self._values[1]
            self._values = (latest if windows == 1 else None), None
            self._begin_ns = now_ns if windows > 1 else self._begin_ns + self._window_ns
        return self._values


class Intervals:
    """The longest time between the last values of one source.

    Args:
        silence_ns: A longer time [ns] than this is a silence and not a period; measuring begins anew.
    """

    def __init__(self, silence_ns: int) -> None:
        self._silence_ns = silence_ns
        self._times: deque[int] = deque(maxlen=INTERVALS + 1)
        self.greatest_ns = 0

    def add(self, now_ns: int) -> None:
        """Note that a value came, monotonic [ns]."""
        if self._times and now_ns - self._times[-1] > self._silence_ns:
            self._times.clear()
        self._times.append(now_ns)
        self.greatest_ns = max((b - a for a, b in itertools.pairwise(self._times)), default=0)


class Rejections:
    """Refused messages by source and cause, and the last refusal of each source in words."""

    def __init__(self) -> None:
        self.counts: dict[str, Counter[str]] = {}
        self.last: dict[str, str] = {}

    def add(self, source: str, cause: str, text: str) -> None:
        """Count one refusal."""
        self.counts.setdefault(source, Counter())[cause] += 1
        self.last[source] = text[:300]


def resident_bytes() -> int | None:
    """Return this process's resident memory [bytes]; ``None`` where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")

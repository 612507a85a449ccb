"""The latch outlives the service: its state is kept in a file, written beside the loop."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from ..wire.latch import IntegrityError, Latch

RETRY_S = 1.0
"""Between two attempts to write [s]."""

MAX_BYTES = 65_536


class LatchState(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the file holds.

    Attributes:
        latched: Why ``stop`` is latched.
        fault: The last error's fault.
        where: Where it was noticed.
        at_ns: When, UTC in ns since 1970: no other clock goes on over a restart.
    """

    latched: str | None = None
    fault: str | None = None
    where: str = ""
    at_ns: int = 0


def state_file(folder: Path | None, robot: str) -> Path:
    """Return where a robot's latch is kept.

    Args:
        folder: The folder; by default ``ssm-service`` in ``$XDG_STATE_HOME`` or ``~/.local/state``.
        robot: Its name on the network.
    """
    if folder is None:
        # As the XDG base directory specification has it, a relative path there does not count.
        base = os.environ.get("XDG_STATE_HOME", "")
        folder = Path(base if os.path.isabs(base) else os.path.expanduser("~/.local/state")) / "ssm-service"
    return folder / f"{robot}.json"


def load_latch(path: Path, interval_s: float) -> Latch:
    """Return the latch as it was kept; what cannot be read is latched.

    An error whose time lies in the future counts as one of now.

    Args:
        path: The file.
        interval_s: Of the profile [s].
    """
    try:
        with path.open("rb") as file:
            state = msgspec.json.decode(file.read(MAX_BYTES), type=LatchState)
    except (FileNotFoundError, NotADirectoryError):
        return Latch(interval_s)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return Latch(interval_s, latched=f"{path} cannot be read: {error}"[:300])
    if state.fault is None:
        return Latch(interval_s, latched=state.latched)
    age_s = max(time.time_ns() - state.at_ns, 0) * 1e-9
    last = IntegrityError(fault=state.fault, where=state.where, at_s=time.monotonic() - age_s)
    return Latch(interval_s, last=last, latched=state.latched)


def state_of(latch: Latch) -> LatchState:
    """Return what the file should hold now."""
    if (last := latch.last) is None:
        return LatchState(latched=latch.latched)
    at_ns = time.time_ns() - round((time.monotonic() - last.at_s) * 1e9)
    return LatchState(latched=latch.latched, fault=last.fault, where=last.where, at_ns=at_ns)


class LatchFile:
    """Writes states in a thread of its own, the newest one as soon as it can, again until it succeeds.

    A state that is written survives a power cut: it is in place whole, or the one before it is.

    Args:
        path: The file.
        say: Called in the thread with lines for people.
        warn: Called in the thread with what keeps it from writing.
    """

    def __init__(self, path: Path, say: Callable[[str], None], warn: Callable[[str], None]) -> None:
        self._path, self._say, self._warn = path, say, warn
        self._changed = threading.Condition()
        self._waiting: LatchState | None = None
        self._lines: list[str] = []
        self._ending = False
        self._thread = threading.Thread(target=self._run, name="latch", daemon=True)
        self._thread.start()

    def save(self, state: LatchState, line: str = "") -> None:
        """Have a state written, in place of one that still waits, and a line said."""
        with self._changed:
            self._waiting = state
            if line:
                self._lines.append(line)
            self._changed.notify()

    def close(self, timeout_s: float = 1.0) -> None:
        """Write what waits, if that can be done in time, and end."""
        with self._changed:
            self._ending = True
            self._changed.notify()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            with self._changed:
                while self._waiting is None and not self._ending:
                    self._changed.wait()
                if self._waiting is None:
                    return
                state, lines = self._waiting, self._lines
                self._waiting, self._lines = None, []
            for line in lines:
                self._say(line)
            if not self._written(state):
                with self._changed:
                    self._waiting = self._waiting or state
                    if self._ending:
                        return
                    self._changed.wait(RETRY_S)

    def _written(self, state: LatchState) -> bool:
        try:
            write_whole(self._path, msgspec.json.encode(state))
        except OSError as error:
            self._warn(f"a latched stop would not outlive this process: {self._path}: {error.strerror}")
            return False
        return True


def write_whole(path: Path, content: bytes) -> None:
    """Put a file in place whole, and wait until it is on the disk.

    Raises:
        OSError: It cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)

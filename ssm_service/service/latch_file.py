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
    """Writes states beside the loop, the newest one as soon as it can, again until it succeeds.

    One thread puts a state in place, where it outlives this process at once; another one waits until it is on
    the disk, where it outlives a power cut. So a state never waits for the disk to take the one before it. A
    power cut in between may leave a file that cannot be read: that is latched.

    Args:
        path: The file.
        say: Called in a thread with lines for people.
        warn: Called in a thread with what keeps it from writing.
    """

    def __init__(self, path: Path, say: Callable[[str], None], warn: Callable[[str], None]) -> None:
        self._path, self._say, self._warn = path, say, warn
        self._changed = threading.Condition()
        self._waiting: LatchState | None = None
        self._placed: LatchState | None = None
        self._lines: list[str] = []
        self._ending = self._all_placed = False
        self._threads = [
            threading.Thread(target=self._place, name="latch", daemon=True),
            threading.Thread(target=self._sync, name="latch-disk", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def save(self, state: LatchState, line: str = "") -> None:
        """Have a state written, in place of one that still waits, and a line said."""
        with self._changed:
            self._waiting = state
            if line:
                self._lines.append(line)
            self._changed.notify_all()

    def close(self, timeout_s: float = 1.0) -> None:
        """Write what waits, if that can be done in time, and end."""
        deadline = time.monotonic() + timeout_s
        with self._changed:
            self._ending = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join(max(deadline - time.monotonic(), 0.0))

    def _place(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._waiting is not None or self._ending)
                    if self._waiting is None:
                        return
                    state, lines = self._waiting, self._lines
                    self._waiting, self._lines = None, []
                for line in lines:
                    self._say(line)
                if self._done(put_whole, msgspec.json.encode(state)):
                    with self._changed:
                        self._placed = state
                        self._changed.notify_all()
                elif not self._again(state):
                    return
        finally:
            with self._changed:
                self._all_placed = True
                self._changed.notify_all()

    def _sync(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._placed is not None or self._all_placed)
                state, self._placed = self._placed, None
            if state is None:
                return
            if not self._done(sync) and not self._again(state):
                return

    def _again(self, state: LatchState) -> bool:
        """Have a failed state written after a while, or a newer one at once; return whether it will be."""
        with self._changed:
            self._changed.wait_for(lambda: self._ending or self._waiting is not None, RETRY_S)
            self._waiting = self._waiting or state
            self._changed.notify_all()
            return not self._ending

    def _done(self, step: Callable[..., None], *content: bytes) -> bool:
        try:
            step(self._path, *content)
        except OSError as error:
            self._warn(f"a latched stop would not outlive this process: {self._path}: {error.strerror}")
            return False
        return True


def put_whole(path: Path, content: bytes) -> None:
    """Put a file in place whole; see ``sync`` for when it is on the disk.

    Raises:
        OSError: It cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        part.write_bytes(content)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def sync(path: Path) -> None:
    """Wait until a file, as it is in place now, is on the disk, with its name.

    Raises:
        OSError: It is not there, or the disk does not take it.
    """
    for one in (path, path.parent):
        descriptor = os.open(one, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

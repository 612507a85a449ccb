"""Errors of integrity: counted always, and latched where the profile says so."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from ..config import LatchConfig
from ..wire.latch import Latch
from .latch_file import LatchFile, load_latch, state_of


class IntegrityWatch:
    """Counts errors of integrity by fault; where it has a latch, the second one within its interval latches.

    Args:
        latch: The latch, if the profile has one.
        file: Keeps it over a restart.
    """

    def __init__(self, latch: Latch | None = None, file: LatchFile | None = None) -> None:
        self.counts: Counter[str] = Counter()
        self._latch = latch
        self._file = file
        self._save("" if self.latched is None else f"stop is latched from before: {self.latched}")

    @property
    def latched(self) -> str | None:
        """Why the zone is held at stop; ``None`` where it is not."""
        return None if self._latch is None else self._latch.latched

    def add(self, fault: str, where: str, now_ns: int) -> None:
        """Take note of an error.

        Args:
            fault: The fault of transmission.
            where: Where it was noticed, e.g. ``in/joints``.
            now_ns: The time, monotonic [ns].
        """
        self.counts[fault] += 1
        if self._latch is not None and self._latch.error(fault, where, now_ns * 1e-9):
            why = self._latch.latched
            self._save("" if why is None else f"stop is latched until `ssm reset`: {why}")

    def reset(self) -> str | None:
        """Acknowledge; return what was latched, or remembered."""
        if self._latch is None:
            return None
        cleared = self._latch.reset()
        self._save("" if cleared is None else f"reset: {cleared}")
        return cleared

    def close(self) -> None:
        """See that the file is written."""
        if self._file is not None:
            self._file.close()

    def _save(self, line: str) -> None:
        if self._latch is not None and self._file is not None:
            self._file.save(state_of(self._latch), line)


def integrity_watch(
    config: LatchConfig | None, path: Path, say: Callable[[str], None], warn: Callable[[str], None]
) -> IntegrityWatch:
    """Return the watch for a profile; ``path`` is not touched where that has no latch.

    Args:
        config: The profile's ``latch``.
        path: Where the latch is kept.
        say: Gets lines for people, in another thread.
        warn: Gets what must stand in ``health``, in another thread.
    """
    if config is None:
        return IntegrityWatch()
    # Read before the thread may write.
    latch = load_latch(path, config.interval_s)
    return IntegrityWatch(latch, LatchFile(path, say, warn))

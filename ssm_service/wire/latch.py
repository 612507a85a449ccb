"""When errors of integrity are taken for a broken network: the second one within an interval latches."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class IntegrityError:
    """One message that shows a fault of transmission.

    Attributes:
        fault: The fault, e.g. ``corruption``.
        where: Where it was noticed, e.g. ``in/joints``.
        at_s: When, monotonic [s].
    """

    fault: str
    where: str
    at_s: float

    def __str__(self) -> str:
        return f"{self.fault} on {self.where}"


class Latch:
    """Remembers the last error of integrity, and latches when another one follows within the interval.

    It says so until ``reset``, whatever comes in between.

    Args:
        interval_s: The interval [s].
        last: The last error, if one is remembered from before.
        latched: Why it is latched already, if it is.
    """

    def __init__(
        self, interval_s: float, *, last: IntegrityError | None = None, latched: str | None = None
    ) -> None:
        self._interval_s = interval_s
        self._last = last
        self._latched = latched

    @property
    def last(self) -> IntegrityError | None:
        """The error that another one may follow."""
        return self._last

    @property
    def latched(self) -> str | None:
        """Why it is latched; ``None`` where it is not."""
        return self._latched

    def error(self, fault: str, where: str, now_s: float) -> bool:
        """Take note of an error; return whether that changed anything.

        Args:
            fault: The fault.
            where: Where it was noticed.
            now_s: The time, monotonic [s]. One before the last error's counts as the same moment.
        """
        if self._latched is not None:
            return False
        before, self._last = self._last, IntegrityError(fault=fault, where=where, at_s=now_s)
        if before is not None and now_s - before.at_s <= self._interval_s:
            after_s = max(now_s - before.at_s, 0.0)
            self._latched = f"{self._last}, {after_s:.1f} s after {before}"
        return True

    def reset(self) -> str | None:
        """Acknowledge: forget the errors; return why it was latched, or what was remembered, if anything."""
        cleared = self._latched
        if cleared is None and self._last is not None:
            cleared = str(self._last)
        self._last = self._latched = None
        return cleared

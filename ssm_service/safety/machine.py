"""Severity falls on at once and is lifted slowly."""

from __future__ import annotations

from .zones import Zone


class ZoneMachine:
    """Turns the zone that one tick alone would give into the zone in force.

    A more severe zone takes effect in the same tick. A milder one needs ``recovery_ticks`` ticks in a row
    that are all milder than the zone in force; it is then the most severe of those that is taken, so a
    tick that was only yellow never lets green through. It starts in ``stop``.
    """

    def __init__(self, recovery_ticks: int) -> None:
        self._needed = recovery_ticks
        self._zone = Zone.STOP
        self._good = 0
        self._worst = Zone.GREEN

    @property
    def zone(self) -> Zone:
        """The zone in force."""
        return self._zone

    @property
    def recovering(self) -> bool:
        """Whether the zone in force is more severe than the last tick alone would be."""
        return self._good > 0

    def step(self, zone: Zone) -> Zone:
        """Take the zone that this tick alone would give; return the zone in force."""
        if zone >= self._zone:
            self._zone = zone
            self._reset()
            return self._zone
        self._good += 1
        self._worst = max(self._worst, zone)
        if self._good >= self._needed:
            self._zone = self._worst
            self._reset()
        return self._zone

    def _reset(self) -> None:
        self._good = 0
        self._worst = Zone.GREEN

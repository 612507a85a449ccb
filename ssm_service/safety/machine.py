"""Severity falls on at once and is lifted slowly."""

from __future__ import annotations

from .zones import Zone


class ZoneMachine:
    """Turns the zone that one tick alone would give into the zone in force.

    The zone in force is the most severe of the last ``recovery_ticks`` ticks; before the first tick they
    count as ``stop``. So a more severe zone takes effect in the same tick, and a milder one needs
    ``recovery_ticks`` ticks in a row that are all milder than the zone in force; it is then the most severe
    of those, so a tick that was only yellow never lets green through.

    A window, and not a count that begins anew after each step, because only so is it monotone: of two runs,
    the one whose ticks are never milder is in force never milder. (With a count, a fault can come in the
    very tick that lets green through earlier than it would have come without the fault.)
    """

    def __init__(self, recovery_ticks: int) -> None:
        self._needed = recovery_ticks
        self._zone = Zone.STOP
        # For how many ticks each zone still holds.
        self._left = dict.fromkeys(Zone, 0)
        self._left[Zone.STOP] = recovery_ticks

    @property
    def zone(self) -> Zone:
        """The zone in force."""
        return self._zone

    def step(self, zone: Zone) -> Zone:
        """Take the zone that this tick alone would give; return the zone in force."""
        for other, left in self._left.items():
            self._left[other] = max(left - 1, 0)
        self._left[zone] = self._needed
        self._zone = max(other for other, left in self._left.items() if left)
        return self._zone

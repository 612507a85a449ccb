"""Zones and what they allow: distance to zone, zone to speed ([Kang2022] II-B-1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from ..config import ProfileConfig, ZoneConfig


class Zone(IntEnum):
    """Zones in rising order of severity, so that ``max`` is always the safe choice."""

    GREEN = 0
    YELLOW = 1
    RED = 2
    STOP = 3

    @property
    def word(self) -> str:
        """The zone's name in messages: ``green``, ``yellow``, ``red`` or ``stop``."""
        return self.name.lower()


@dataclass(frozen=True, slots=True, kw_only=True)
class ZoneProfile:
    """A zone profile in force.

    Attributes:
        name: The profile's name in the robot file.
        config: Its distances and limits.
    """

    name: str
    config: ProfileConfig

    def zone_at(self, distance: float) -> Zone:
        """Return the zone for a distance [m] by the profile's steps alone.

        The edges belong to the nearer zone. Contact, which is any distance at or below 0, is a protective
        stop, also without steps. A distance that is not a number is unknown, and unknown is a stop as well.
        """
        yellow, red = self.config.yellow, self.config.red
        if distance > (0.0 if yellow is None else yellow.distance_m):
            return Zone.GREEN
        if distance > (0.0 if red is None else red.distance_m):
            return Zone.YELLOW
        if distance > 0.0:
            return Zone.RED
        return Zone.STOP

    def joint_speed(self, zone: Zone) -> float | None:
        """Return the zone's joint speed limit [rad/s]; ``None`` where the joint's own limit stands."""
        if zone is Zone.STOP:
            return 0.0
        step = self._step(zone)
        return None if step is None else step.joint_speed_rad_s

    def speed_scaling(self, zone: Zone) -> float:
        """Return the speed scaling, 0 to 1, that consumers are told.

        A profile without steps has these zones only by its separation, which says what they allow, and by
        doubts. A doubt worth red allows the share at which red begins, one worth yellow its square root
        (a half where red is a quarter, as in [Kang2022]).
        """
        if zone is Zone.STOP:
            return 0.0
        step, separation = self._step(zone), self.config.separation
        if step is not None:
            return step.speed_scaling
        if zone is Zone.GREEN or separation is None:
            return 1.0
        return separation.red_scaling if zone is Zone.RED else math.sqrt(separation.red_scaling)

    def _step(self, zone: Zone) -> ZoneConfig | None:
        return {Zone.RED: self.config.red, Zone.YELLOW: self.config.yellow}.get(zone)

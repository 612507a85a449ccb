"""Zones and what they allow: distance to zone, zone to speed ([Kang2022] II-B-1)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from ..config import ProfileConfig


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
        """Return the zone for a distance [m].

        The edges belong to the nearer zone. Contact, which is any distance at or below 0, is a protective
        stop. A distance that is not a number is unknown, and unknown is a stop as well.
        """
        if distance > self.config.yellow.distance_m:
            return Zone.GREEN
        if distance > self.config.red.distance_m:
            return Zone.YELLOW
        if distance > 0.0:
            return Zone.RED
        return Zone.STOP

    def joint_speed(self, zone: Zone) -> float | None:
        """Return the zone's joint speed limit [rad/s]; ``None`` where the joint's own limit stands."""
        if zone is Zone.GREEN:
            return None
        if zone is Zone.YELLOW:
            return self.config.yellow.joint_speed_rad_s
        if zone is Zone.RED:
            return self.config.red.joint_speed_rad_s
        return 0.0

    def speed_scaling(self, zone: Zone) -> float:
        """Return the speed scaling, 0 to 1, that consumers are told."""
        if zone is Zone.GREEN:
            return 1.0
        if zone is Zone.YELLOW:
            return self.config.yellow.speed_scaling
        if zone is Zone.RED:
            return self.config.red.speed_scaling
        return 0.0

"""Watches the true arm among the true obstacles, and says whose fault a contact is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ssm_service.model import Pairs, Robot, closing_gradients, moved_by
from ssm_service.monitor.command import zone_speed_limit
from ssm_service.safety import Zone, ZoneProfile
from ssm_service.simulation import Plant

from .avoidance_outcome import Outcome
from .avoidance_sight import Sight

Array = NDArray[np.float64]

STANDING_M_S = 1e-3
AS_FAST_AS_MAY = 0.8
"""A link that retreats with this share of what it may has done what it could."""

THREATENED_M = 0.05
"""Nearer than this to something that comes, a link is about to be touched."""

HELPLESS_M_S = 0.005
"""A link that could retreat no faster than this has nowhere to go."""


class Judge:
    """Watches one run.

    Args:
        arm: The arm.
    """

    def __init__(self, arm: Robot) -> None:
        self._arm = arm
        self._moved = np.array([moved_by(arm, link) for link in arm.monitored_links])
        self._profile = ZoneProfile(name="avoidance", config=arm.config.file.profiles["avoidance"])
        self._touching: set[tuple[int, str]] = set()

    def limit_at(self, distance: float) -> Array:
        """Return each joint's speed limit at a distance [m], (n,); in contact that of red, to get free."""
        zone = min(self._profile.zone_at(distance), Zone.RED)
        return zone_speed_limit(self._arm, self._profile, Zone(zone))

    def look(self, plant: Plant, sight: Sight, told: Array, time_s: float, into: Outcome) -> None:
        """Look at one instant.

        Args:
            plant: The true arm.
            sight: The true distances.
            told: (n,) the speed limit that the method was told last [rad/s].
            time_s: When.
            into: Takes what is seen.
        """
        into.instants += 1
        into.least_m = min(into.least_m, sight.least_m)
        limit = self.limit_at(sight.least_m)
        into.over += bool((np.abs(plant.velocity) > 1.01 * limit + 1e-4).any())
        touching: set[tuple[int, str]] = set()
        if sight.least_m <= 0.0:
            touching = self._contacts(plant, sight, told, time_s, into)
        self._touching = touching

    def _contacts(
        self, plant: Plant, sight: Sight, told: Array, time_s: float, into: Outcome
    ) -> set[tuple[int, str]]:
        """Judge the contacts that are new, and return all."""
        pairs = sight.pairs()
        near = (pairs.distance <= 0.0).nonzero()[0]
        sight.distances.refine(pairs, near.tolist())
        touching = set()
        for row in near[pairs.distance[near] <= 0.0].tolist():
            key = (int(pairs.link[row]), pairs.obstacles[pairs.obstacle[row]])
            touching.add(key)
            if key not in self._touching:
                self._judge(Contact.of(self._arm, self._moved, pairs, row, plant, sight, told), time_s, into)
        return touching

    @staticmethod
    def _judge(contact: Contact, time_s: float, into: Outcome) -> None:
        """Say whose fault a new contact is."""
        where = (
            f"{contact.link} and {contact.obstacle} at {time_s:.2f} s: link closes at {contact.closing:.3f}, "
            f"might retreat at {contact.might:.3f}, obstacle comes at {contact.comes:.3f} m/s"
        )
        came = contact.comes > STANDING_M_S
        if came and contact.might < HELPLESS_M_S and contact.closing <= STANDING_M_S:
            into.helpless += 1
        elif came and contact.might >= HELPLESS_M_S and -contact.closing >= AS_FAST_AS_MAY * contact.might:
            into.retreating += 1
        elif not into.contact:
            into.contact = "drove" if contact.closing > STANDING_M_S else "yielding"
            into.where = where
            return
        into.info.setdefault("apart", where)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """One contact.

    Attributes:
        link: The link.
        obstacle: The obstacle's id.
        closing: How fast the link closes by itself [m/s].
        might: How fast it could retreat within zone, joint limits and what else is near [m/s].
        comes: How fast the obstacle closes by itself [m/s].
    """

    link: str
    obstacle: str
    closing: float
    might: float
    comes: float

    @classmethod
    def of(
        cls,
        arm: Robot,
        moved: NDArray[np.bool_],
        pairs: Pairs,
        row: int,
        plant: Plant,
        sight: Sight,
        told: Array,
    ) -> Contact:
        """Return the contact of one pair; ``moved``: (links, n) which joints move which link."""
        near = (pairs.distance < 0.1).nonzero()[0]
        spatial = arm.kinematics(plant.position).spatial_jacobian
        gradients = closing_gradients(
            spatial, moved[pairs.link[near]], pairs.point_on_link[near], pairs.normal[near]
        )
        own = int((near == row).nonzero()[0][0])
        speeds = np.array([one.velocity or (0.0, 0.0, 0.0) for one in sight.obstacles])
        coming = np.einsum("ij,ij->i", pairs.normal[near], speeds[pairs.obstacle[near]])
        threatened = (coming > STANDING_M_S) & (pairs.distance[near] < THREATENED_M)
        config = arm.config.file.motion.filter
        admitted = config.approach_gain * (pairs.distance[near] - config.contact_m).clip(0.0)
        # What else is about to be touched must not retreat more slowly for it.
        admitted[threatened] = np.minimum(admitted, gradients @ plant.velocity)[threatened]
        return cls(
            link=pairs.links[pairs.link[row]],
            obstacle=pairs.obstacles[pairs.obstacle[row]],
            closing=float(gradients[own] @ plant.velocity),
            might=_greatest_retreat(arm, gradients, own, admitted, plant.position, told),
            comes=float(coming[own]),
        )


def _greatest_retreat(
    arm: Robot, gradients: Array, own: int, admitted: Array, position: Array, limit: Array
) -> float:
    """Return how fast one of some pairs could open while no other closes faster than admitted [m/s]."""
    margin = arm.config.file.limits.position_margin_rad
    room_below = position > arm.position_lower + margin
    room_above = position < arm.position_upper - margin
    best = linprog(
        gradients[own],
        A_ub=np.delete(gradients, own, axis=0),
        b_ub=np.delete(admitted, own),
        bounds=np.column_stack([np.where(room_below, -limit, 0.0), np.where(room_above, limit, 0.0)]),
        method="highs",
    )
    return -float(best.fun) if best.success else 0.0

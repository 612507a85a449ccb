"""The protective separation of every pair at one tick, and the speeds that it leaves ([TS15066])."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..config import SeparationConfig
from ..model import DistanceModel, Kinematics, Obstacle, Pairs, Robot, closing_gradients, moved_by
from ..safety import (
    Closing,
    ReactionTime,
    ZoneProfile,
    admissible_shares,
    level_speeds,
    max_closing_speeds,
)
from .range_rows import RangeRowMaker, RangeRows
from .ranges import RangeReading
from .reaction import stopping_levels
from .separated import Limit, PairTable, Separated, joined

Array = NDArray[np.float64]

MOST_EXACT = 8
"""Pairs that one tick measures to the links' triangles at most; the others keep their hulls' distance."""

EXACT_BELOW = 1.5
"""Share of the joint speeds, by its hull, below which a pair is measured to the link's triangles.

A hull's witness points may lie beside the link's own, so that its share, unlike its distance, is no bound of
the link's: this leaves room for it.
"""


class Sight(Struct, frozen=True, kw_only=True, eq=False):
    """What one tick sees, as far as its separation depends on it.

    Attributes:
        kinematics: Frames and Jacobians now.
        velocity: (n,), [rad/s], as measured; zeros where it is not known.
        pairs: Links and tracked obstacles; ``None`` without a fresh tracker.
        obstacles: The same obstacles.
        reading: The newest scan; ``None`` without a fresh one.
        reactions: T_r of each fresh source.
    """

    kinematics: Kinematics
    velocity: Array
    pairs: Pairs | None = None
    obstacles: Sequence[Obstacle] = ()
    reading: RangeReading | None = None
    reactions: Mapping[str, ReactionTime]


class SeparationStep:
    """Measures, pair by pair, what the equation leaves; keeps nothing between ticks.

    Pairs with tracked obstacles are measured by the links' hulls, and the ``MOST_EXACT`` of them that leave
    the least share of the speed, of those that leave less than ``EXACT_BELOW``, by the triangles. Both are
    sound: a hull holds its link, so that whoever is kept apart from the hull, distance and closing speed
    alike, is kept apart from the link. The triangles leave more room, and give the speed of the link's own
    nearest point. The person's speed is the profile's, or, where the profile says so and a tracker knows it,
    the obstacle's own, but not below the profile's floor: all of it and not only its part towards the robot,
    as directions change.

    Args:
        robot: The robot; its file has stopping data of all joints that move.
        profile: The profile, whose ``range_estimator`` says what readings are.
        config: The profile's separation.
    """

    def __init__(self, robot: Robot, profile: ZoneProfile, config: SeparationConfig) -> None:
        self._config = config
        self._levels = stopping_levels(robot)
        self._free = robot.free
        self._limits = np.zeros(len(robot.joint_names))
        self._limits[robot.free] = robot.velocity_limit[robot.free]
        self._moved = np.array([moved_by(robot, link) for link in robot.monitored_links])
        self._ranges = RangeRowMaker(robot, config, profile.config.range_estimator)
        self._links = robot.monitored_links + tuple([array.link for array in robot.sensor_arrays])
        self._monitored = len(robot.monitored_links)
        self._speeds_of: Sequence[Obstacle] = ()
        self._speeds: Array | None = None

    def share_of(self, velocity: Array) -> float:
        """Return the greatest share of its limit that any free joint has in a velocity, (n,) [rad/s]."""
        return float((np.abs(velocity[self._free]) / self._limits[self._free]).max())

    def step(self, sight: Sight, distances: DistanceModel) -> Separated:
        """Return every pair with its terms.

        Args:
            sight: What this tick sees. Its pairs are measured exactly where it matters, in place.
            distances: What measured the pairs last.
        """
        found, rows = None, None
        if sight.pairs is not None:
            found = self._of_pairs(sight, sight.pairs, None)
            if self._refine(sight, sight.pairs, found, distances):
                found = None
        if sight.reading is not None:
            tracked = sight.pairs is not None
            rows = self._ranges.rows(sight.reading, sight.kinematics, tracked=tracked)
        if found is not None and rows is None:
            return found  # nothing has changed since
        return self._of_pairs(sight, sight.pairs, rows)

    def _refine(self, sight: Sight, pairs: Pairs, hulls: Separated, distances: DistanceModel) -> bool:
        """Measure the pairs to the triangles where that could matter; return whether it did for any."""
        left = _left(hulls.max_closing_speed, hulls.table.closing.greatest(self._limits))
        near = (left < EXACT_BELOW).nonzero()[0]
        order = near[np.lexsort((hulls.table.distance[near], left[near]))].tolist()
        if order:
            distances.refine(pairs, order[:1])
            if not self._stops(sight, pairs, order[0]):
                distances.refine(pairs, order[1:MOST_EXACT])
        return bool(order)

    def _stops(self, sight: Sight, pairs: Pairs, row: int) -> bool:
        """Tell whether one pair as it is leaves no speed at all: then no other one can change the stop."""
        config, reaction = self._config, sight.reactions["obstacles"].total
        fixed = config.intrusion_m + config.robot_uncertainty_m + config.human_uncertainty_m
        human = self._human_speeds(sight.obstacles)[pairs.obstacle[row]]
        return not float(pairs.distance[row]) - fixed > human * (reaction + float(self._levels.times[0]))

    def of_pairs(self, sight: Sight) -> Separated:
        """Return the same for pairs with tracked obstacles alone, as they are."""
        return self._of_pairs(sight, sight.pairs, None)

    def _of_pairs(self, sight: Sight, pairs: Pairs | None, rows: RangeRows | None) -> Separated:
        tables = [self._tracked(sight, pairs)] if pairs is not None else []
        tables += [self._seen(sight, rows)] if rows is not None else []
        table, config, levels = joined(tables, len(self._limits)), self._config, self._levels
        closing_speed, greatest = table.closing.at(sight.velocity), table.closing.greatest(self._limits)
        fixed = config.intrusion_m + config.robot_uncertainty_m + table.uncertainty
        by_level = level_speeds(table.distance, table.human_speed, table.reaction_time, fixed, levels)
        allowed = max_closing_speeds(by_level, greatest, levels)
        shares = admissible_shares(allowed, greatest)
        return Separated(
            table=table,
            links=self._links,
            closing_speed=closing_speed,
            max_closing_speed=allowed,
            shares=shares,
            scaling=float(shares.min(initial=1.0)),
            limiting=_limiting(allowed, greatest, table.distance),
            limit=Limit(closing=table.closing, by_level=by_level, levels=levels),
            level=levels.level_at(self.share_of(sight.velocity)),
            reactions=sight.reactions,
            intrusion=config.intrusion_m,
            robot_uncertainty=config.robot_uncertainty_m,
            red_scaling=config.red_scaling,
        )

    def _tracked(self, sight: Sight, pairs: Pairs) -> PairTable:
        """Return the pairs with tracked obstacles."""
        gradients = closing_gradients(
            sight.kinematics.spatial_jacobian, self._moved[pairs.link], pairs.point_on_link, pairs.normal
        )
        count = len(pairs)
        return PairTable(
            ids=pairs.obstacles,
            link=pairs.link,
            obstacle=pairs.obstacle,
            distance=pairs.distance,
            exact=pairs.exact,
            point_on_link=pairs.point_on_link,
            point_on_obstacle=pairs.point_on_obstacle,
            normal=pairs.normal,
            human_speed=self._human_speeds(sight.obstacles)[pairs.obstacle],
            uncertainty=np.full(count, self._config.human_uncertainty_m),
            reaction_time=np.full(count, sight.reactions["obstacles"].total),
            closing=Closing.directed(gradients),
        )

    def _seen(self, sight: Sight, rows: RangeRows) -> PairTable:
        """Return the pairs of the rings' readings; nobody knows whose speed they are."""
        count, directed = len(rows.distance), len(rows.gradients)
        gradients = np.zeros((count, len(self._limits)))
        gradients[:directed] = rows.gradients
        undirected = np.arange(count) >= directed
        return PairTable(
            ids=(),
            link=rows.link + self._monitored,
            obstacle=np.full(count, -1, dtype=np.intp),
            distance=rows.distance,
            exact=np.zeros(count, dtype=np.bool_),
            point_on_link=rows.point_on_link,
            point_on_obstacle=rows.point_on_obstacle,
            normal=rows.normal,
            human_speed=np.full(count, self._config.human_speed_m_s),
            uncertainty=rows.uncertainty,
            reaction_time=np.full(count, sight.reactions["ranges"].total),
            closing=Closing(gradients=gradients, undirected=undirected, jacobians=rows.jacobians),
        )

    def _human_speeds(self, obstacles: Sequence[Obstacle]) -> Array:
        """Return v_h of each obstacle, worked out once for each message."""
        if self._speeds is None or self._speeds_of is not obstacles:
            self._speeds_of = obstacles
            self._speeds = np.array([self._human_speed(obstacle) for obstacle in obstacles])
        return self._speeds

    def _human_speed(self, obstacle: Obstacle) -> float:
        config = self._config
        if obstacle.velocity is None or not config.tracked_velocity:
            return config.human_speed_m_s
        return max(config.human_speed_floor_m_s, math.hypot(*obstacle.velocity))


def _limiting(allowed: Array, greatest: Array, distance: Array) -> int | None:
    """Return the pair that leaves the least share, also beyond all of it; of equal ones the nearest."""
    if not len(allowed):
        return None
    return int(np.lexsort((distance, _left(allowed, greatest)))[0])


def _left(allowed: Array, greatest: Array) -> Array:
    """Return what share of the joint speeds each pair leaves, (p,), also where that is more than 1."""
    share = np.full(len(allowed), np.inf)
    np.divide(allowed, greatest, out=share, where=greatest > 0.0)
    share[allowed <= 0.0] = 0.0
    return share

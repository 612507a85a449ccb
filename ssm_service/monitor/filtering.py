"""The method ``filter``: the programme's rows from every link–obstacle pair of a tick."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model import DistanceModel, Pairs, Robot, closing_gradients, moved_by
from ..motion import (
    Box,
    Circulation,
    Filtered,
    VelocityFilter,
    approach_speeds,
    barrier_bounds,
    contact_bounds,
    softness,
    task_metric,
    velocity_box,
)
from ..motion.filter import DAMPING_M_RAD
from ..motion.self_collision import SelfCollision
from .snapshot import Snapshot

Array = NDArray[np.float64]

MOST_EXACT = 4
"""Pairs of a tick that are measured to the link's triangles, those that hold the motion back most.

The hulls alone would do: they are never too far."""

EXACT_BELOW_M = 0.15
"""Beyond this the hull's few millimetres make no difference."""


class Rows(NamedTuple):
    """The programme's p rows.

    Attributes:
        gradients: (p, n) g [m/rad].
        bounds: (p,) b [m/s].
        ceilings: (p,) c [m/s].
        approach: (p,) the obstacle's own speed towards the link [m/s].
        normals: (p, 3) unit, from the obstacle to the link, base frame; 0 where none is told.
        pair: (p,) indices into ``Snapshot.pairs``; -1 for what a ring sees and for the arm itself.
    """

    gradients: Array
    bounds: Array
    ceilings: Array
    approach: Array
    normals: Array
    pair: NDArray[np.intp]


BLOCKED_SHARE = 0.3
"""The way counts as blocked where less than this of the wanted velocity of the end effector is left."""


class Filtering:
    """Brings a wanted velocity within what every pair and every joint admits, and goes round what blocks it.

    Tracked obstacles enter with their velocities; one whose velocity nobody knows counts as standing, as the
    zones and the profile's separation answer for what it may do. What a ring sees nearest is one pair more.

    Attributes:
        last: What the programme said at the last tick; ``None`` before.

    Args:
        robot: The robot.
        period_s: Time from tick to tick [s].
    """

    def __init__(self, robot: Robot, period_s: float) -> None:
        self._robot = robot
        self._config = robot.config.file.motion.filter
        self._period_s = period_s
        self._filter = VelocityFilter()
        self._itself = SelfCollision(robot)
        self._circulation = Circulation(self._config)
        self._goal: bytes | None = None
        self._blocked, self._normal = False, np.zeros(3)
        self._links = robot.monitored_links
        self._moved = {link: moved_by(robot, link) for link in self._links}
        for array in robot.sensor_arrays:
            self._moved.setdefault(array.link, moved_by(robot, array.link))
        self._moved_rows = np.array([self._moved[link] for link in self._links])
        self.last: Filtered | None = None

    def reset(self) -> None:
        """Forget the ticks before."""
        self.last = None
        self._circulation.reset()
        self._blocked, self._normal = False, np.zeros(3)

    def around(self, snapshot: Snapshot, linear: Array) -> Array:
        """Return the wanted velocity of the end effector with what leads round what blocked the last tick.

        Args:
            snapshot: Robot and target, which is a ``position`` or a ``pose``.
            linear: (3,) towards the goal [m/s], base frame.
        """
        goal = snapshot.target.value[:3]
        if self._goal != goal.tobytes():
            self._goal = goal.tobytes()
            self._circulation.reset()
        place = snapshot.kinematics.transform_end_effector_to_base[:3, 3]
        distance = math.dist(place.tolist(), goal.tolist())
        return linear + self._circulation.step(linear, self._normal, self._blocked, distance, self._period_s)

    def step(
        self,
        snapshot: Snapshot,
        wanted: Array,
        previous: Array | None,
        speed_limit: Array,
        distances: DistanceModel,
    ) -> Array:
        """Return the admissible velocity nearest to the wanted one, (n,) [rad/s].

        Args:
            snapshot: Robot and surroundings.
            wanted: (n,) [rad/s].
            previous: (n,) the last command [rad/s]; ``None`` where no acceleration limit binds.
            speed_limit: (n,) of the zone [rad/s].
            distances: Measures the pairs exactly that hold the motion back.
        """
        free, box = self._robot.free, self._box(snapshot, previous, speed_limit)
        metric = None
        if snapshot.target.kind != "joint_velocity":
            metric = task_metric(snapshot.kinematics.jacobian)
        itself = self._of_itself(snapshot, box)
        rows = self._rows(snapshot, itself)
        found = self._solve(wanted[free], rows, box, metric)
        if self._refine(snapshot.pairs, rows.pair[list(found.active)], distances):
            rows = self._rows(snapshot, itself)
            found = self._solve(wanted[free], rows, box, metric)
        self.last = found
        velocity = np.zeros(len(wanted))
        velocity[free] = found.velocity
        self._look(snapshot.kinematics.jacobian, wanted[free], found, rows.normals)
        return velocity

    def _box(self, snapshot: Snapshot, previous: Array | None, speed_limit: Array) -> Box:
        """Return what the joints' limits admit; without a command before, as after full speed either way."""
        if previous is None:
            backward = self._box(snapshot, -speed_limit, speed_limit)
            return Box(backward.lower, self._box(snapshot, speed_limit, speed_limit).upper)
        robot, free = self._robot, self._robot.free
        limits = robot.config.file.limits
        return velocity_box(
            snapshot.joints.position[free],
            previous[free],
            robot.position_lower[free],
            robot.position_upper[free],
            speed_limit[free],
            limits.position_margin_rad,
            limits.acceleration_rad_s2,
            self._period_s,
        )

    @staticmethod
    def _refine(pairs: Pairs | None, active: NDArray[np.intp], distances: DistanceModel) -> bool:
        """Measure the pairs exactly that hold the motion back; tell whether there were any."""
        if pairs is None:
            return False
        active = active[active >= 0][:MOST_EXACT]
        inexact = active[(pairs.distance[active] < EXACT_BELOW_M) & ~pairs.exact[active]]
        if len(inexact):
            distances.refine(pairs, inexact.tolist())
        return bool(len(inexact))

    def _look(self, jacobian: Array, wanted: Array, found: Filtered, normals: Array) -> None:
        """Keep whether the pairs left nearly nothing of the end effector's motion, and which one most."""
        asked, left = jacobian @ wanted, jacobian @ found.velocity
        size = float(asked @ asked)
        stopped = size > 0.0 and float(asked @ left) < BLOCKED_SHARE * size
        self._blocked = bool(found.active) and stopped
        self._normal = normals[found.active[0]] if found.active else np.zeros(3)

    def _solve(self, wanted: Array, rows: Rows, box: Box, metric: Array | None) -> Filtered:
        return self._filter.solve(
            wanted,
            rows.gradients[:, self._robot.free],
            rows.bounds,
            box,
            metric,
            rows.ceilings,
            softness(rows.bounds, rows.approach, DAMPING_M_RAD),
        )

    def _rows(self, snapshot: Snapshot, itself: Rows) -> Rows:
        """Return the rows of all pairs within the influence distance, and those of the arm itself."""
        found = [itself]
        if snapshot.pairs is not None and len(snapshot.pairs):
            found.append(self._tracked(snapshot, snapshot.pairs))
        for thing in snapshot.things:
            if thing.source == "ranges":
                pair = np.array([-1])
                moved = self._moved[thing.link][np.newaxis]
                points, normals = thing.point_on_link[np.newaxis], thing.normal[np.newaxis]
                found.append(
                    self._made(
                        snapshot, moved, np.array([thing.distance]), points, normals, np.zeros(1), pair
                    )
                )
        return Rows(*(np.concatenate(column) for column in zip(*found, strict=True)))

    def _tracked(self, snapshot: Snapshot, pairs: Pairs) -> Rows:
        near = (pairs.distance < self._config.influence_distance_m).nonzero()[0]
        speeds = np.array([one.velocity or (0.0, 0.0, 0.0) for one in snapshot.obstacles])
        normals = pairs.normal[near]
        approach = approach_speeds(normals, speeds[pairs.obstacle[near]])
        moved = self._moved_rows[pairs.link[near]]
        return self._made(
            snapshot, moved, pairs.distance[near], pairs.point_on_link[near], normals, approach, near
        )

    def _made(
        self,
        snapshot: Snapshot,
        moved: NDArray[np.bool_],
        distance: Array,
        points: Array,
        normals: Array,
        approach: Array,
        pair: NDArray[np.intp],
    ) -> Rows:
        return Rows(
            gradients=closing_gradients(snapshot.kinematics.spatial_jacobian, moved, points, normals),
            bounds=barrier_bounds(distance, approach, self._config),
            ceilings=contact_bounds(distance, approach, self._config),
            approach=approach,
            normals=normals,
            pair=pair,
        )

    def _of_itself(self, snapshot: Snapshot, box: Box) -> Rows:
        """Return the rows of the links against each other, which are not soft and never ask for a retreat.

        The links know where they are: the barrier's gain is that of the contact distance.
        """
        speeds = np.zeros(len(self._robot.joint_names))
        speeds[self._robot.free] = np.maximum(-box.lower, box.upper)
        margin, gain = self._config.self_margin_m, self._config.contact_gain
        spatial = snapshot.kinematics.spatial_jacobian
        distance, gradients = self._itself.rows(snapshot.joints.position, spatial, speeds, margin, gain)
        bounds = np.maximum(gain * (distance - margin), 0.0)
        count = len(bounds)
        none = np.full(count, -1)
        return Rows(gradients, bounds, bounds, np.zeros(count), np.zeros((count, 3)), none)

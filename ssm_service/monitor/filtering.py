"""The method ``filter``: the programme's rows from every link–obstacle pair of a tick."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model import DistanceModel, Pairs, Robot, closing_gradients, moved_by
from ..motion import Filtered, VelocityFilter, approach_speeds, barrier_bounds, task_metric, velocity_box
from .snapshot import Snapshot

Array = NDArray[np.float64]

MOST_EXACT = 6
"""Pairs of a tick that are measured to the link's triangles, the nearest ones; hulls are never too far."""

EXACT_BELOW_M = 0.15
"""Beyond this the hull's few millimetres make no difference."""


class Filtering:
    """Brings a wanted velocity within what every pair and every joint admits; keeps the last result.

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
        self._links = robot.monitored_links
        self._moved = {link: moved_by(robot, link) for link in self._links}
        for array in robot.sensor_arrays:
            self._moved.setdefault(array.link, moved_by(robot, array.link))
        self._moved_rows = np.array([self._moved[link] for link in self._links])
        self.last: Filtered | None = None

    def reset(self) -> None:
        """Forget the tick before."""
        self.last = None

    def step(
        self,
        snapshot: Snapshot,
        wanted: Array,
        previous: Array,
        speed_limit: Array,
        distances: DistanceModel,
    ) -> Array:
        """Return the admissible velocity nearest to the wanted one, (n,) [rad/s].

        Args:
            snapshot: Robot and surroundings.
            wanted: (n,) [rad/s].
            previous: (n,) the last command [rad/s].
            speed_limit: (n,) of the zone [rad/s].
            distances: Measures the nearest pairs exactly.
        """
        robot, free = self._robot, self._robot.free
        limits = robot.config.file.limits
        box = velocity_box(
            snapshot.joints.position[free],
            previous[free],
            robot.position_lower[free],
            robot.position_upper[free],
            speed_limit[free],
            limits.position_margin_rad,
            limits.acceleration_rad_s2,
            self._period_s,
        )
        gradients, bounds = self._rows(snapshot, distances)
        metric = None
        if snapshot.target.kind != "joint_velocity":
            metric = task_metric(snapshot.kinematics.jacobian)
        self.last = self._filter.solve(wanted[free], gradients[:, free], bounds, box, metric)
        velocity = np.zeros(len(wanted))
        velocity[free] = self.last.velocity
        return velocity

    def _rows(self, snapshot: Snapshot, distances: DistanceModel) -> tuple[Array, Array]:
        """Return g, (p, n), and b, (p,), of all pairs within the influence distance."""
        gradients, bounds = [np.empty((0, len(self._robot.joint_names)))], [np.empty(0)]
        if snapshot.pairs is not None and len(snapshot.pairs):
            tracked = self._tracked(snapshot, snapshot.pairs, distances)
            gradients.append(tracked[0])
            bounds.append(tracked[1])
        for thing in snapshot.things:
            if thing.source == "ranges":
                points, normals = thing.point_on_link[np.newaxis], thing.normal[np.newaxis]
                spatial = snapshot.kinematics.spatial_jacobian
                moved = self._moved[thing.link][np.newaxis]
                gradients.append(closing_gradients(spatial, moved, points, normals))
                bounds.append(barrier_bounds(np.array([thing.distance]), np.zeros(1), self._config))
        return np.concatenate(gradients), np.concatenate(bounds)

    def _tracked(self, snapshot: Snapshot, pairs: Pairs, distances: DistanceModel) -> tuple[Array, Array]:
        near = (pairs.distance < self._config.influence_distance_m).nonzero()[0]
        order = near[np.argsort(pairs.distance[near], kind="stable")]
        nearest = order[:MOST_EXACT]
        exact = nearest[(pairs.distance[nearest] < EXACT_BELOW_M) & ~pairs.exact[nearest]]
        if len(exact):
            distances.refine(pairs, exact.tolist())
        speeds = np.array([one.velocity or (0.0, 0.0, 0.0) for one in snapshot.obstacles])
        normals = pairs.normal[near]
        gradients = closing_gradients(
            snapshot.kinematics.spatial_jacobian,
            self._moved_rows[pairs.link[near]],
            pairs.point_on_link[near],
            normals,
        )
        approach = approach_speeds(normals, speeds[pairs.obstacle[near]])
        return gradients, barrier_bounds(pairs.distance[near], approach, self._config)

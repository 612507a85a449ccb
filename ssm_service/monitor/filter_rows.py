"""The rows of the programme of ``filter``: every pair of links, or of link and obstacle, that can matter.

A row binds only where the pair can come nearer faster than it may. How fast the points of a link can move is
bounded, so most pairs are told from that and from balls round link and obstacle not to matter, and only the
others are measured. The solution is that of all rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model import DistanceModel, Obstacle, Pairs, Robot, closing_gradients, moved_by
from ..motion import approach_speeds, barrier_bounds, contact_bounds
from ..motion.self_collision import SelfCollision, link_levers
from .decision import Nearest
from .snapshot import Snapshot

Array = NDArray[np.float64]

MOST_EXACT: Final = 4
"""Pairs of a tick that are measured to the link's triangles, the nearest ones.

The hulls alone would do: they are never too far."""

MOST_LOOSE: Final = 6
"""Hull pieces that are measured because joints could bring them near, before it is asked what links do."""

EXACT_BELOW_M: Final = 0.06
"""Beyond this the hull's few millimetres make no difference."""


class Rows(NamedTuple):
    """The programme's p rows.

    Attributes:
        gradients: (p, n) g [m/rad].
        bounds: (p,) b [m/s].
        ceilings: (p,) c [m/s].
        approach: (p,) the obstacle's own speed towards the link [m/s].
        normals: (p, 3) unit, from the obstacle to the link, base frame; 0 for a pair of links.
    """

    gradients: Array
    bounds: Array
    ceilings: Array
    approach: Array
    normals: Array


class RowMaker:
    """Makes the rows of each tick.

    Tracked obstacles enter with their velocities; one whose velocity nobody knows counts as standing, as the
    zones and the profile's separation answer for what it may do. What a ring sees nearest is one pair more.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._config = robot.config.file.motion.filter
        links = {*robot.monitored_links, *(array.link for array in robot.sensor_arrays)}
        self._moved = {link: moved_by(robot, link) for link in links}
        self._moved_rows = np.array([self._moved[link] for link in robot.monitored_links])
        self._levers = link_levers(robot)
        self._fixed = ~self._moved_rows[:, robot.free].any(axis=1)
        self._robot = robot
        self._itself: SelfCollision | None = None
        self._obstacles: Sequence[Obstacle] = ()
        self._velocities, self._least = np.empty((0, 3)), np.empty(0)

    def prepare(self) -> SelfCollision:
        """Do now what the first rows would have to wait for."""
        if self._itself is None:
            self._itself = SelfCollision(self._robot)
        return self._itself

    def at(self, snapshot: Snapshot, velocity: Array, distances: DistanceModel) -> Rows:
        """Return every row that a joint velocity could offend.

        Args:
            snapshot: Robot and surroundings.
            velocity: (n,) [rad/s].
            distances: Has the snapshot's obstacles.
        """
        return self._rows(snapshot, np.abs(velocity), velocity, distances)

    def within(self, snapshot: Snapshot, speeds: Array, distances: DistanceModel) -> Rows:
        """Return every row that some velocity could offend that is no faster than this, (n,) [rad/s]."""
        return self._rows(snapshot, speeds, None, distances)

    def _rows(
        self, snapshot: Snapshot, speeds: Array, velocity: Array | None, distances: DistanceModel
    ) -> Rows:
        found = [self._of_itself(snapshot, speeds)]
        if snapshot.obstacles:
            found.append(self._tracked(snapshot, speeds, velocity, distances))
        if snapshot.echo is not None:
            found.append(self._seen(snapshot, snapshot.echo))
        found = [one for one in found if len(one.bounds)] or found[:1]
        if len(found) == 1:
            return found[0]
        return Rows(*(np.concatenate(column) for column in zip(*found, strict=True)))

    def _tracked(
        self, snapshot: Snapshot, speeds: Array, velocity: Array | None, distances: DistanceModel
    ) -> Rows:
        if snapshot.obstacles is not self._obstacles:
            self._obstacles = snapshot.obstacles
            self._velocities = np.array([one.velocity or (0.0, 0.0, 0.0) for one in snapshot.obstacles])
            own = np.sqrt((self._velocities * self._velocities).sum(axis=1))
            self._least = self._config.margin_m + own / self._config.approach_gain
        position, pairs, reach = snapshot.joints.position, None, self._levers @ speeds
        if velocity is not None:
            pairs = distances.below(position, self._limits(reach), most=MOST_LOOSE)
        if pairs is None:
            if velocity is not None:
                spatial = snapshot.kinematics.spatial_jacobian
                moving = distances.link_speeds(position, spatial, self._moved_rows, velocity)
                reach = np.minimum(reach, moving)
            pairs = distances.below(position, self._limits(reach))
        if not len(pairs):
            return _none(len(position))
        self._measure(pairs, distances)
        approach = approach_speeds(pairs.normal, self._velocities[pairs.obstacle])
        moved = self._moved_rows[pairs.link]
        return self._made(snapshot, moved, pairs.distance, pairs.point_on_link, pairs.normal, approach)

    def _limits(self, reach: Array) -> Array:
        """Return how near pairs must be to matter, (links, obstacles) [m].

        Beyond this b is more than the links' (links,) and the obstacle's speeds together. What no free joint
        moves, a programme of the joints has nothing to say of.
        """
        limits: Array = (reach / self._config.approach_gain)[:, np.newaxis] + self._least
        np.minimum(limits, self._config.influence_distance_m, out=limits)
        limits[self._fixed] = -math.inf
        return limits

    @staticmethod
    def _measure(pairs: Pairs, distances: DistanceModel) -> None:
        """Measure the nearest of the pairs to the triangles."""
        near = (pairs.distance < EXACT_BELOW_M).nonzero()[0]
        if len(near) > MOST_EXACT:
            near = near[np.argsort(pairs.distance[near], kind="stable")[:MOST_EXACT]]
        distances.refine(pairs, near.tolist())

    def _seen(self, snapshot: Snapshot, thing: Nearest) -> Rows:
        moved = self._moved[thing.link][np.newaxis]
        points, normals = thing.point_on_link[np.newaxis], thing.normal[np.newaxis]
        return self._made(snapshot, moved, np.array([thing.distance]), points, normals, np.zeros(1))

    def _made(
        self,
        snapshot: Snapshot,
        moved: NDArray[np.bool_],
        distance: Array,
        points: Array,
        normals: Array,
        approach: Array,
    ) -> Rows:
        return Rows(
            gradients=closing_gradients(snapshot.kinematics.spatial_jacobian, moved, points, normals),
            bounds=barrier_bounds(distance, approach, self._config),
            ceilings=contact_bounds(distance, approach, self._config),
            approach=approach,
            normals=normals,
        )

    def _of_itself(self, snapshot: Snapshot, speeds: Array) -> Rows:
        """Return the rows of the links against each other, which are not soft and never ask for a retreat.

        The links know where they are: the barrier's gain is that of the contact distance.
        """
        margin, gain = self._config.self_margin_m, self._config.contact_gain
        spatial = snapshot.kinematics.spatial_jacobian
        distance, gradients = self.prepare().rows(snapshot.joints.position, spatial, speeds, margin, gain)
        count = len(distance)
        if not count:
            return _none(len(speeds))
        bounds = np.maximum(gain * (distance - margin), 0.0)
        return Rows(gradients, bounds, bounds, np.zeros(count), np.zeros((count, 3)))


@lru_cache(maxsize=8)
def _none(count: int) -> Rows:
    """Return no rows for so many joints."""
    return Rows(np.empty((0, count)), np.empty(0), np.empty(0), np.empty(0), np.empty((0, 3)))

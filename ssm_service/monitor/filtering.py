"""The method ``filter``: the programme of a tick, and what leads round what blocks it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..model import DistanceModel, Robot
from ..motion import Box, Circulation, Filtered, VelocityFilter, softness, task_metric, velocity_box
from ..motion.filter import DAMPING_M_RAD
from .filter_rows import RowMaker, Rows
from .snapshot import Snapshot

Array = NDArray[np.float64]

BLOCKED_SHARE: Final = 0.3
"""The way counts as blocked where less than this of the end effector's wanted motion is left."""

MEMORY_S: Final = 0.4
"""Time constant of what is left of it: a passing hindrance is none."""

ROOM: Final = 1.2
"""The programme looks first at what could matter at so many times the speed that is wanted."""


class Filtering:
    """Brings a wanted velocity within what every pair and every joint admits, and goes round what blocks it.

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
        self._circulation = Circulation(self._config)
        self._goal: bytes | None = None
        self._blocked, self._share, self._normal = False, 1.0, np.zeros(3)
        self._rows = RowMaker(robot)
        self._faster = False
        self._all_free = len(robot.free) == len(robot.joint_names)
        self.last: Filtered | None = None

    def prepare(self) -> None:
        """Do now what the first tick would have to wait for."""
        self._rows.prepare()

    def reset(self) -> None:
        """Forget the ticks before."""
        self.last, self._faster = None, False
        self._circulation.reset()
        self._blocked, self._share, self._normal = False, 1.0, np.zeros(3)

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
            distances: Measured the pairs; says more of those that can matter.
        """
        free, box = self._robot.free, self._box(snapshot, previous, speed_limit)
        metric = None
        if snapshot.target.kind != "joint_velocity":
            metric = task_metric(snapshot.kinematics.jacobian)
        found, rows = self._solve(snapshot, wanted[free], box, metric, distances)
        self.last = found
        velocity = np.zeros(len(wanted))
        velocity[free] = found.velocity
        start = np.minimum(np.maximum(wanted[free], box.lower), box.upper)
        self._look(snapshot.kinematics.jacobian, start, found, rows.normals)
        return velocity

    def _solve(
        self, snapshot: Snapshot, wanted: Array, box: Box, metric: Array | None, distances: DistanceModel
    ) -> tuple[Filtered, Rows]:
        """Return the solution of the programme with all rows, and those that it needed.

        Rows that cannot bind at the speeds of a solution do not change it. So it is looked first at those
        that can at little more than the wanted speed, and at the others only where the solution is faster, or
        the last one was.
        """
        fastest = np.maximum(-box.lower, box.upper)
        start = np.minimum(np.maximum(wanted, box.lower), box.upper)
        slow = np.minimum(fastest, ROOM * float(np.abs(start).max()))
        if not self._faster:
            rows = self._rows.rows(snapshot, self._whole(slow), distances)
            # A retreat takes what speed there is.
            if not (len(rows.bounds) and float(rows.bounds.min()) < 0.0):
                found = self._solved(wanted, rows, box, metric)
                if bool((np.abs(found.velocity) <= slow).all()):
                    return found, rows
        rows = self._rows.rows(snapshot, self._whole(fastest), distances)
        found = self._solved(wanted, rows, box, metric)
        self._faster = bool((np.abs(found.velocity) > slow).any())
        return found, rows

    def _solved(self, wanted: Array, rows: Rows, box: Box, metric: Array | None) -> Filtered:
        gradients = rows.gradients if self._all_free else rows.gradients[:, self._robot.free]
        slack = softness(rows.bounds, rows.approach, DAMPING_M_RAD)
        return self._filter.solve(wanted, gradients, rows.bounds, box, metric, rows.ceilings, slack)

    def _whole(self, free: Array) -> Array:
        """Return values of the free joints as those of all, 0 for the others, (n,)."""
        if self._all_free:
            return free
        whole = np.zeros(len(self._robot.joint_names))
        whole[self._robot.free] = free
        return whole

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

    def _look(self, jacobian: Array, wanted: Array, found: Filtered, normals: Array) -> None:
        """Keep whether the pairs left little of the end effector's motion for a while, and which one most.

        Args:
            jacobian: (3, k) of the end effector.
            wanted: (k,) as far as the joints may [rad/s]: speeding up is no hindrance.
            found: What is left.
            normals: (p, 3) of the rows.
        """
        asked, left = jacobian @ wanted, jacobian @ found.velocity
        size = float(asked @ asked)
        share = min(max(float(asked @ left) / size, 0.0), 1.0) if size > 0.0 and found.active else 1.0
        self._share += (share - self._share) * min(1.0, self._period_s / MEMORY_S)
        self._blocked = bool(found.active) and self._share < BLOCKED_SHARE
        self._normal = normals[found.active[0]] if found.active else np.zeros(3)

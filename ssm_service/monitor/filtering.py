"""The method ``filter``: the programme of a tick, and what leads round what blocks it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..model import DistanceModel, Robot
from ..motion import Box, Circulation, Filtered, VelocityFilter, softness, task_metric, velocity_box
from ..motion.filter import DAMPING_M_RAD, in_box
from .filter_rows import RowMaker, Rows
from .snapshot import Snapshot

Array = NDArray[np.float64]

BLOCKED_SHARE: Final = 0.3
"""The way counts as blocked where less than this of the end effector's wanted motion is left."""

MEMORY_S: Final = 0.4
"""Time constant of what is left of it: a passing hindrance is none."""


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
        self._lower, self._upper = robot.position_lower[robot.free], robot.position_upper[robot.free]
        self._all_free = len(robot.free) == len(robot.joint_names)
        self.last: Filtered | None = None

    def prepare(self) -> None:
        """Do now what the first tick would have to wait for."""
        self._rows.prepare()

    def reset(self) -> None:
        """Forget the ticks before."""
        self.last = None
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
            distances: Has the snapshot's obstacles.
        """
        free, box = self._robot.free, self._box(snapshot, previous, speed_limit)
        start = np.minimum(np.maximum(wanted[free], box.lower), box.upper)
        found, rows = self._solve(snapshot, wanted[free], start, box, distances)
        self.last = found
        self._look(snapshot.kinematics.jacobian, start, found, rows.normals)
        velocity = np.zeros(len(wanted))
        velocity[free] = found.velocity
        return velocity

    def _solve(
        self, snapshot: Snapshot, wanted: Array, start: Array, box: Box, distances: DistanceModel
    ) -> tuple[Filtered, Rows]:
        """Return the solution of the programme with all rows, and those that it needed.

        Rows that hold at a solution without them do not change it. So it is solved without any first, and
        only the pairs that could object to that are looked at; if one does, or a retreat is asked for, all
        that could object to anything the joints may do are in. Nothing of the ticks before enters.

        Args:
            snapshot: Robot and surroundings.
            wanted: (k,) [rad/s].
            start: (k,) what the box leaves of it.
            box: Of the joints.
            distances: Has the snapshot's obstacles.
        """
        found = self._alone(snapshot, wanted, start, box)
        if found is not None:
            rows = self._rows.at(snapshot, self._whole(found.velocity), distances)
            if not len(rows.bounds) or _admits(rows, self._of_free(rows.gradients) @ found.velocity):
                return found, rows
        fastest = np.maximum(-box.lower, box.upper)
        rows = self._rows.within(snapshot, self._whole(fastest), distances)
        slack = softness(rows.bounds, rows.approach, DAMPING_M_RAD)
        found = self._filter.solve(
            wanted, self._of_free(rows.gradients), rows.bounds, box, _metric(snapshot), rows.ceilings, slack
        )
        return found, rows

    def _alone(self, snapshot: Snapshot, wanted: Array, start: Array, box: Box) -> Filtered | None:
        """Return the solution without pairs; ``None`` where the solver fails."""
        cut = start.tolist() != wanted.tolist()
        return in_box(wanted, box, _metric(snapshot) if cut else None)

    def _of_free(self, gradients: Array) -> Array:
        """Return the free joints' columns of (p, n) gradients."""
        return gradients if self._all_free else gradients[:, self._robot.free]

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
        free, limits = self._robot.free, self._robot.config.file.limits
        return velocity_box(
            snapshot.joints.position[free],
            previous[free],
            self._lower,
            self._upper,
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
        share = 1.0
        if found.active:
            asked, left = jacobian @ wanted, jacobian @ found.velocity
            size = float(asked @ asked)
            if size > 0.0:
                share = min(max(float(asked @ left) / size, 0.0), 1.0)
        self._share += (share - self._share) * min(1.0, self._period_s / MEMORY_S)
        self._blocked = bool(found.active) and self._share < BLOCKED_SHARE
        self._normal = normals[found.active[0]] if found.active else np.zeros(3)


def _metric(snapshot: Snapshot) -> Array | None:
    """Return the weights of the joints; ``None`` for a target of theirs, which weighs all the same."""
    if snapshot.target.kind == "joint_velocity":
        return None
    return task_metric(snapshot.kinematics.jacobian)


def _admits(rows: Rows, closing: Array) -> bool:
    """Tell whether no pair asks for a retreat or closes faster than it may, (p,) [m/s]."""
    allowed = np.minimum(rows.bounds, rows.ceilings)
    return bool(((closing <= allowed) & (rows.bounds >= 0.0)).all())

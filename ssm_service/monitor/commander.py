"""From the target to the command: method, change-over, and then every limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model import DistanceModel, Robot
from ..motion import Changeover
from .command import limited_velocity, separated_velocity
from .filtering import Filtering
from .methods import Methods
from .snapshot import Keeping, Snapshot

Array = NDArray[np.float64]


class Commander:
    """Makes the command of each tick; the same sequence of snapshots gives the same sequence of commands.

    Args:
        robot: The robot.
        period_s: Time from tick to tick [s].
    """

    def __init__(self, robot: Robot, period_s: float) -> None:
        self._robot = robot
        self._period_s = period_s
        self._filtering = Filtering(robot, period_s)
        self._methods = Methods(robot, self._filtering.around)
        self._changeover = Changeover(robot.config.file.limits.acceleration_rad_s2, period_s)
        self.previous = np.zeros(len(robot.joint_names))

    def prepare(self) -> None:
        """Do now what the first tick of a method would have to wait for."""
        self._filtering.prepare()

    def stand(self) -> Array:
        """Return the command to stand still, (n,), and begin anew from there."""
        self.previous = np.zeros(len(self.previous))
        self._changeover.step(None, self.previous, self.previous)
        self._filtering.reset()
        return self.previous

    def step(
        self, snapshot: Snapshot, keeping: Keeping, distances: DistanceModel, *, settled: bool = False
    ) -> Array:
        """Return the command, (n,) [rad/s].

        Args:
            snapshot: Robot, target and surroundings.
            keeping: What it must keep.
            distances: Has the snapshot's obstacles, for ``filter``.
            settled: Whether the wanted velocity counts as reached, so that no acceleration limit binds.
        """
        target = snapshot.target
        controller = self._methods.controller(target)
        wanted = self._methods.wanted(snapshot)
        if settled:
            self.previous = wanted
        wanted = self._changeover.step((controller, target.kind), wanted, self.previous)
        if controller == "filter":
            previous = None if settled else self.previous
            wanted = self._filtering.step(snapshot, wanted, previous, keeping.speed_limit, distances)
        self.previous = limited_velocity(
            self._robot,
            separated_velocity(keeping.separation, keeping.limits, wanted),
            previous=wanted if settled else self.previous,
            position=snapshot.joints.position,
            speed_limit=keeping.speed_limit,
            period_s=self._period_s,
        )
        return self.previous

"""What a method of ``bench.avoidance`` is told, and those of the service that do without a programme."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ssm_service.config import ControllerName
from ssm_service.model import Kinematics, Obstacle, Robot
from ssm_service.monitor import JointSample, Target
from ssm_service.monitor.assess import nearest_by_obstacles
from ssm_service.monitor.decision import Nearest
from ssm_service.monitor.methods import Methods
from ssm_service.monitor.snapshot import Snapshot

from .avoidance_sight import Sight

Array = NDArray[np.float64]

PERIOD_S = 0.008
"""Time from tick to tick [s]."""

PLANNER_CLEARANCE_M = 0.045
"""The planner keeps this distance: a little more than the filter's margin, so that its paths are passable."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """What a method is told at a tick.

    Attributes:
        robot: The arm.
        time_s: Time [s].
        dt: Time to the next command [s].
        joints: Joint state.
        kinematics: Frames and Jacobians.
        goal: (3,) [m].
        obstacles: As last tracked.
        sight: The distances to them; what is asked for beyond the nearest pair counts as solve time.
        ranges: (m,) of the ring [m], or None before its first scan.
        previous: (n,) the last command [rad/s].
        speed_limit: (n,) of the zone [rad/s].
    """

    robot: Robot
    time_s: float
    dt: float
    joints: JointSample
    kinematics: Kinematics
    goal: Array
    obstacles: tuple[Obstacle, ...]
    sight: Sight
    ranges: Array | None
    previous: Array
    speed_limit: Array

    @property
    def end_effector(self) -> Array:
        """Where the end effector is, (3,) [m]."""
        place: Array = self.kinematics.transform_end_effector_to_base[:3, 3]
        return place

    @property
    def nearest(self) -> Nearest | None:
        """The nearest pair of all."""
        return nearest_by_obstacles(self.sight.nearest)


class Method(Protocol):
    """One method; a new one for each scene."""

    def velocity(self, state: State) -> Array:
        """Return the wanted joint velocity, (n,) [rad/s]; all limits of the arm and the zone come after."""
        ...


class Service:
    """A method of the service that asks for a velocity and leaves the rest to the limits."""

    def __init__(self, robot: Robot, controller: ControllerName) -> None:
        self._methods = Methods(robot)
        self._controller = controller

    def velocity(self, state: State) -> Array:
        """Return what the service would want."""
        return self._methods.wanted(snapshot_of(state, self._controller))


def snapshot_of(state: State, controller: ControllerName, velocity: Array | None = None) -> Snapshot:
    """Return what the service's methods look at; with ``velocity``, a target of the joints' velocity."""
    if velocity is None:
        target = Target(kind="position", value=state.goal, controller=controller)
    else:
        target = Target(kind="joint_velocity", value=velocity, controller=controller)
    return Snapshot(
        kinematics=state.kinematics,
        joints=state.joints,
        target=target,
        nearest=state.nearest,
        ranges=state.ranges,
        obstacles=state.obstacles,
    )

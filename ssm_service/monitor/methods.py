"""From a target to the velocity that it wants: one method for each word of ``motion.controller``."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ..config import ControllerName
from ..model import Robot, moved_by, point_jacobians
from ..motion import (
    Critical,
    ObstaclePoint,
    angular_approach,
    avoidance_velocity,
    field_velocity,
    influence_radius,
    linear_approach,
    linear_to_joints,
    rotation_of,
    sensor_steps,
    twist_to_joints,
)
from ..motion.clik import Mode
from .decision import Nearest
from .inputs import Target
from .snapshot import Snapshot

Array = NDArray[np.float64]

FIELDS = ("field", "field3d")
MODES: dict[str, Mode] = dict(zip(("clik-1", "clik-2", "clik-3"), get_args(Mode), strict=True))


class Methods:
    """The wanted velocity of each method, before limits; what ``filter`` then makes of it is not here.

    Kept between ticks is only the orientation at the arrival of a ``position`` target, which ``clik`` holds.

    Args:
        robot: The robot.
        around: What ``filter`` makes of the velocity towards a goal whose way is blocked.
    """

    def __init__(self, robot: Robot, around: Callable[[Snapshot, Array], Array] | None = None) -> None:
        self._robot = robot
        self._around = around
        self._config = robot.config.file.motion
        self._count = len(robot.joint_names)
        self._steps = sensor_steps([ring.count for ring in robot.rings])
        links = {*robot.monitored_links, *(array.link for array in robot.sensor_arrays)}
        self._moved = {link: moved_by(robot, link) for link in links}
        self._held: tuple[Target, Array] | None = None

    def controller(self, target: Target) -> ControllerName:
        """Return the method of a target: its own, else the robot file's."""
        return self._config.controller if target.controller is None else target.controller

    def wanted(self, snapshot: Snapshot) -> Array:
        """Return the joint velocity that the target asks for, (n,) [rad/s]; locked joints stay."""
        target = snapshot.target
        controller = self.controller(target)
        if controller in FIELDS and target.kind in ("position", "pose"):
            return self._by_field(snapshot, controller)
        wanted = self._straight(snapshot, holding=controller in MODES)
        if controller in MODES:
            wanted = self._clik(snapshot, MODES[controller], wanted)
        return wanted

    def _straight(self, snapshot: Snapshot, *, holding: bool) -> Array:
        """Return the velocity without any avoidance: the target's own, or straight to the goal."""
        robot, target, kinematics = self._robot, snapshot.target, snapshot.kinematics
        if target.kind == "joint_velocity":
            wanted = np.zeros(self._count)
            wanted[robot.free] = target.value[robot.free]
            return wanted
        if target.kind == "twist":
            return self._twist(snapshot, target.value)
        T_base_end = kinematics.transform_end_effector_to_base
        linear = linear_approach(T_base_end[:3, 3], target.value[:3], self._config)
        if self._around is not None and self.controller(target) == "filter":
            linear = self._around(snapshot, linear)
        goal = self._orientation(snapshot, holding=holding)
        if goal is None:
            return self._linear(snapshot, linear)
        angular = angular_approach(T_base_end[:3, :3], goal, self._config)
        return self._twist(snapshot, np.concatenate([linear, angular]))

    def _orientation(self, snapshot: Snapshot, *, holding: bool) -> Array | None:
        """Return the orientation to turn to, (3, 3); ``None`` where it is free."""
        target = snapshot.target
        if target.kind == "pose":
            return rotation_of(target.value[3:])
        if not holding or len(self._robot.free) < 6:
            return None
        same = self._held is not None and np.array_equal(self._held[0].value, target.value)
        if self._held is None or not same:
            self._held = target, snapshot.kinematics.transform_end_effector_to_base[:3, :3].copy()
        return self._held[1]

    def _by_field(self, snapshot: Snapshot, controller: str) -> Array:
        nearest, kinematics, target = snapshot.nearest, snapshot.kinematics, snapshot.target
        T_base_end = kinematics.transform_end_effector_to_base
        by_rings = controller == "field3d"
        linear = field_velocity(
            T_base_end[:3, 3],
            target.value[:3],
            self._config,
            controller=controller,
            obstacle=None
            if nearest is None
            else ObstaclePoint(distance=nearest.distance, direction=nearest.normal),
            transforms_sensor_to_base=kinematics.transform_sensors_to_base if by_rings else None,
            ranges=snapshot.ranges,
            steps=self._steps,
        )
        if target.kind == "position":
            return self._linear(snapshot, linear)
        angular = angular_approach(T_base_end[:3, :3], rotation_of(target.value[3:]), self._config)
        return self._twist(snapshot, np.concatenate([linear, angular]))

    def _linear(self, snapshot: Snapshot, velocity: Array) -> Array:
        jacobian = snapshot.kinematics.jacobian
        return linear_to_joints(jacobian, self._robot.free, velocity, self._config, self._count)

    def _twist(self, snapshot: Snapshot, twist: Array) -> Array:
        jacobian = snapshot.kinematics.jacobian_full
        return twist_to_joints(jacobian, self._robot.free, twist, self._config, self._count)

    def _clik(self, snapshot: Snapshot, mode: Mode, wanted: Array) -> Array:
        """Return the velocity with the repulsion of the most critical pair ([Neri2023] (7), (9), (11))."""
        nearest, robot = snapshot.nearest, self._robot
        greatest = self._config.clik.joint_speed_max_rad_s
        if nearest is not None:
            radius = influence_radius(self._speed_of(snapshot, nearest), self._config)
            if nearest.distance < radius:
                critical = self._critical(snapshot, nearest)
                jacobian = snapshot.kinematics.jacobian_full[:, robot.free]
                wanted = wanted.copy()
                wanted[robot.free] += avoidance_velocity(mode, jacobian, critical, radius, self._config)
        return np.clip(wanted, -greatest, greatest)

    def _critical(self, snapshot: Snapshot, nearest: Nearest) -> Critical:
        jacobian = point_jacobians(
            snapshot.kinematics.spatial_jacobian,
            self._moved[nearest.link],
            nearest.point_on_link[np.newaxis],
        )[0]
        return Critical(
            distance=nearest.distance, direction=nearest.normal, jacobian=jacobian[:, self._robot.free]
        )

    @staticmethod
    def _speed_of(snapshot: Snapshot, nearest: Nearest) -> float:
        """Return the speed of what is nearest [m/s]; infinite where nobody knows it."""
        velocities = {obstacle.id: obstacle.velocity for obstacle in snapshot.obstacles}
        velocity = None if nearest.obstacle is None else velocities.get(nearest.obstacle)
        return math.inf if velocity is None else math.hypot(*velocity)

"""From the target to the velocity that it wants, before any limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model import Kinematics, Robot
from ..motion import ObstaclePoint, position_to_joints, twist_to_joints
from .decision import Nearest
from .inputs import Target


def wanted_velocity(
    robot: Robot,
    kinematics: Kinematics,
    target: Target,
    nearest: Nearest | None,
    ranges: NDArray[np.float64] | None,
    steps: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the joint velocity that the target asks for, (n,), [rad/s]; locked joints stay.

    Args:
        robot: The robot.
        kinematics: Its frames and Jacobians now.
        target: The wanted motion.
        nearest: The nearest thing of all sources, which repels in the conventional field.
        ranges: (m,), [m], the fresh readings that the 3-D field is made of; ``None`` without any. The 3-D
            field then gives no motion: without its readings it cannot avoid anything.
        steps: (m,), the sensors' weights in the 3-D field, from ``motion.sensor_steps``.
    """
    config = robot.config.file.motion
    count = len(robot.joint_names)
    if target.kind == "joint_velocity":
        wanted = np.zeros(count)
        wanted[robot.free] = target.value[robot.free]
        return wanted
    if target.kind == "twist":
        return twist_to_joints(kinematics.jacobian_full, robot.free, target.value, config, count)
    obstacle = None
    if nearest is not None:
        obstacle = ObstaclePoint(distance=nearest.distance, direction=nearest.normal)
    return position_to_joints(
        kinematics.transform_end_effector_to_base[:3, 3],
        target.value,
        kinematics.jacobian,
        robot.free,
        config,
        count,
        obstacle=obstacle,
        transforms_sensor_to_base=(
            kinematics.transform_sensors_to_base if config.controller == "field3d" else None
        ),
        ranges=ranges,
        steps=steps,
    )

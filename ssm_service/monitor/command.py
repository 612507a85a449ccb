"""From the target to the velocity that it wants, and from that to what the limits leave of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..model import Kinematics, Robot
from ..motion import ObstaclePoint, limit_velocity, position_to_joints, twist_to_joints
from ..safety import Zone, ZoneProfile
from .decision import Nearest
from .inputs import Target
from .separated import Limit
from .separation import SeparationStep


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


def zone_speed_limit(robot: Robot, profile: ZoneProfile, zone: Zone) -> NDArray[np.float64]:
    """Return each joint's speed limit in a zone, (n,), [rad/s]: never above the joint's own.

    A zone without a joint speed, which the profile's separation or a doubt gives, limits all by their share.
    """
    speed = profile.joint_speed(zone)
    if speed is None:
        return robot.velocity_limit * profile.speed_scaling(zone)
    return np.minimum(robot.velocity_limit, speed)


def limited_velocity(
    robot: Robot,
    wanted: NDArray[np.float64],
    *,
    previous: NDArray[np.float64],
    position: NDArray[np.float64],
    speed_limit: NDArray[np.float64],
    period_s: float,
) -> NDArray[np.float64]:
    """Return the wanted velocity within all of the robot's limits and the zone's, (n,), [rad/s].

    Args:
        robot: The robot, whose position limits, margin and acceleration hold.
        wanted: (n,), [rad/s].
        previous: (n,), [rad/s], the last command.
        position: (n,), [rad].
        speed_limit: (n,), [rad/s], of the zone.
        period_s: Time to the next command [s].
    """
    limits = robot.config.file.limits
    return limit_velocity(
        wanted,
        previous=previous,
        position=position,
        speed_limit=speed_limit,
        lower=robot.position_lower,
        upper=robot.position_upper,
        margin=limits.position_margin_rad,
        acceleration=limits.acceleration_rad_s2,
        dt=period_s,
    )


def separated_velocity(
    step: SeparationStep | None, limits: Sequence[Limit], wanted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the greatest scaling of the wanted velocity that keeps every pair's separation, (n,) [rad/s].

    Args:
        step: Knows the joints; ``None`` where the profile has no separation.
        limits: What limits it.
        wanted: (n,), [rad/s].
    """
    if step is None or not limits:
        return wanted
    share = step.share_of(wanted)
    scaling = min(limit.scaling(wanted, share) for limit in limits)
    return wanted if scaling == 1.0 else wanted * scaling

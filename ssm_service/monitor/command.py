"""From the wanted velocity to what the limits leave of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..model import Robot
from ..motion import limit_velocity
from ..safety import Zone, ZoneProfile
from .separated import Limit
from .separation import SeparationStep


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

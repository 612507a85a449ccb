"""A gentle task that any arm can do: one joint sways back and forth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import Robot
from ..monitor import Target

PERIOD_S = 12.0
"""Time for once there and back [s], two of which make a cycle of the scenarios that come with the package."""

AMPLITUDE_RAD = 0.3
AMPLITUDE_M = 0.05
"""How far a revolute or a prismatic joint sways to each side of its centre, where its limits have room."""

LEAST_AMPLITUDE = 0.005
"""A joint that can sway no further [rad or m] is passed over."""

GAIN = 2.0
"""From the joint's distance to where it should be to its velocity [1/s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sway:
    """A joint that follows ``centre + amplitude·sin(2πt/PERIOD_S)`` under ``joint_velocity`` targets.

    The wanted velocity leads the joint from where it is to where it should be, so that an arm that was
    slowed or stopped for a while neither drifts away nor hurries: its speed never exceeds that of the sine,
    and it never leaves what the sine covers, once there.

    Attributes:
        joint: Name of the joint.
        index: Its place among the robot's joints.
        count: Number of the robot's joints, n.
        centre: [rad or m].
        amplitude: [rad or m].
    """

    joint: str
    index: int
    count: int
    centre: float
    amplitude: float

    @property
    def speed(self) -> float:
        """The greatest speed that it asks for [rad/s or m/s]."""
        return self.amplitude * math.tau / PERIOD_S

    def target_at(self, time_s: float, position: NDArray[np.float64]) -> Target:
        """Return the target for a time since the start [s] and the arm's position then, (n,) [rad or m]."""
        place = self.centre + self.amplitude * math.sin(math.tau * time_s / PERIOD_S)
        wanted = GAIN * (place - float(position[self.index]))
        value = np.zeros(self.count)
        value[self.index] = min(max(wanted, -self.speed), self.speed)
        return Target(kind="joint_velocity", value=value)


def sway_for(robot: Robot) -> Sway | None:
    """Return a sway of the first free joint that has room for one, as near to its rest as its limits allow.

    It keeps away from the joint's limits by at least half its amplitude beyond the robot's own margin, and
    asks for at most half the joint's speed limit. ``None`` where no joint has room.
    """
    margin = robot.config.file.limits.position_margin_rad
    for index in robot.free.tolist():
        low, high = float(robot.position_lower[index]) + margin, float(robot.position_upper[index]) - margin
        fastest = float(robot.velocity_limit[index])
        amplitude = min(_amplitude(robot, index), (high - low) / 4.0, 0.5 * fastest * PERIOD_S / math.tau)
        if amplitude < LEAST_AMPLITUDE:
            continue
        rest, room = float(robot.rest_position[index]), 1.5 * amplitude
        return Sway(
            joint=robot.joint_names[index],
            index=index,
            count=len(robot.joint_names),
            centre=min(max(rest, low + room), high - room),
            amplitude=amplitude,
        )
    return None


def _amplitude(robot: Robot, index: int) -> float:
    kind = robot.model.joints[index + 1].shortname()  # joint 0 is Pinocchio's universe
    return AMPLITUDE_M if kind.startswith("JointModelP") else AMPLITUDE_RAD

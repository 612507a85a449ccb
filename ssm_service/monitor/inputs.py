"""What one tick is given: values, how old they may be, and whether the newest was refused.

The functions here are the only door for numbers from outside: everything that passes them is finite, has
the right length and stands in the robot's own order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..config import ControllerName
from ..errors import InputError, listed
from ..model import Obstacle, Robot

T = TypeVar("T")

TARGET_KINDS = ("joint_velocity", "twist", "position", "pose")
"""The words that ``Target.kind`` may hold on the wire."""

FREE_JOINTS_OF_MODE = {"clik-2": 5, "clik-3": 6}
"""How many free joints a controller needs to keep what it promises to keep."""

QUATERNION_TOLERANCE = 1e-3
"""How far from unit length a quaternion may be; senders round."""

POSITION_SLACK = 0.5
"""How far beyond a joint's limits [rad or m] a measured position may lie before it is refused."""

SPEED_SLACK = 10.0
"""How many times a joint's speed limit a measured speed may be before it is refused."""


class JointSample(Struct, frozen=True, kw_only=True, eq=False):
    """Measured joint state in the robot's joint order.

    Attributes:
        position: (n,), [rad or m].
        velocity: (n,), [rad/s or m/s].
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]


class Target(Struct, frozen=True, kw_only=True, eq=False):
    """The wanted motion.

    Attributes:
        kind: ``joint_velocity`` (n values, rad/s); or of the end effector in the base frame: ``twist`` (6
            values, m/s and rad/s), ``position`` (3 values, m), ``pose`` (7 values: position, m, and unit
            quaternion, x y z w).
        value: The values.
        controller: The method; ``None`` for the robot file's.
    """

    kind: str
    value: NDArray[np.float64]
    controller: ControllerName | None = None


class Received(Struct, Generic[T], frozen=True, kw_only=True, eq=False):
    """The newest accepted value of a source.

    Attributes:
        value: The value; ``None`` while nothing was accepted.
        age_s: Upper bound of its age [s] by the receiver's monotonic clock; ``None`` with no value.
        invalid: Whether something refused has arrived since.
        period_s: The longest time between its last messages, as measured [s]; 0 while nothing is known.
    """

    value: T | None = None
    age_s: float | None = None
    invalid: bool = False
    period_s: float = 0.0


class Inputs(Struct, frozen=True, kw_only=True, eq=False):
    """Everything that one tick may know.

    Attributes:
        joints: Joint state.
        ranges: Readings (m,) [m] of all rings in file order, ``inf`` for no echo.
        obstacles: Tracked obstacles; an empty tuple means 'seen, and nothing there'.
        target: Wanted motion.
        overrun_s: By how much the tick before overran its period [s]; 0 if it did not.
        duplicate: Whether another service was heard under the same name.
        latched: Whether errors of integrity hold the zone at stop until somebody resets it.
        tick_s: From the beginning of a tick to its publication, the longest lately [s].
        transport_s: From publication to a consumer, the longest that an echo showed lately [s].
    """

    joints: Received[JointSample] = Received()
    ranges: Received[NDArray[np.float64]] = Received()
    obstacles: Received[tuple[Obstacle, ...]] = Received()
    target: Received[Target] = Received()
    overrun_s: float = 0.0
    duplicate: bool = False
    latched: bool = False
    tick_s: float = 0.0
    transport_s: float = 0.0


def joint_sample(
    robot: Robot,
    position: Sequence[float],
    velocity: Sequence[float] | None = None,
    name: Sequence[str] | None = None,
) -> JointSample:
    """Check a joint state and bring it into the robot's order.

    Args:
        robot: The robot.
        position: (n,), [rad or m], in the order of ``name``, or of the robot where that is left out.
        velocity: (n,), [rad/s or m/s]; zeros where left out.
        name: The n joint names in any order.

    Raises:
        InputError: ``wrong_length``, ``missing_joint``, ``unknown_joint``, ``repeated_joint``,
            ``not_finite`` or ``out_of_range``.
    """
    count = len(robot.joint_names)
    order = range(count) if name is None else _order(robot, name)
    if velocity is None:
        velocity = (0.0,) * count
    for where, values in (("position", position), ("velocity", velocity)):
        if len(values) != count:
            raise InputError("wrong_length", where, f"{len(values)} values", f"{count} values")
        if not all(map(math.isfinite, values)):
            raise InputError("not_finite", where, values, "finite numbers")
    in_order = np.array([position[i] for i in order], dtype=np.float64)
    speeds = np.array([velocity[i] for i in order], dtype=np.float64)
    _check_within(robot, in_order, speeds)
    return JointSample(position=in_order, velocity=speeds)


def _order(robot: Robot, name: Sequence[str]) -> list[int]:
    place: dict[str, int] = {}
    for index, joint in enumerate(name):
        if place.setdefault(joint, index) != index:
            raise InputError("repeated_joint", "name", joint, "each joint once")
    for joint in name:
        if joint not in robot.joint_names:
            raise InputError("unknown_joint", "name", joint, listed(robot.joint_names))
    for joint in robot.joint_names:
        if joint not in place:
            raise InputError("missing_joint", "name", f"no '{joint}'", f"all of {listed(robot.joint_names)}")
    return [place[joint] for joint in robot.joint_names]


def _check_within(robot: Robot, position: NDArray[np.float64], velocity: NDArray[np.float64]) -> None:
    for index, joint in enumerate(robot.joint_names):
        low = robot.position_lower[index] - POSITION_SLACK
        high = robot.position_upper[index] + POSITION_SLACK
        if not low <= position[index] <= high:
            raise InputError(
                "out_of_range", f"position of {joint}", float(position[index]), f"{low:.3f} to {high:.3f}"
            )
        fastest = SPEED_SLACK * robot.velocity_limit[index]
        if not -fastest <= velocity[index] <= fastest:
            raise InputError(
                "out_of_range", f"velocity of {joint}", float(velocity[index]), f"±{fastest:.3f}"
            )


def range_scan(robot: Robot, ranges: Sequence[float | None]) -> NDArray[np.float64]:
    """Check one scan of all rings.

    Args:
        robot: The robot.
        ranges: (m,), [m], in the order of the file's rings and sensors; ``None`` is no echo.

    Returns:
        (m,), [m], with ``inf`` for no echo.

    Raises:
        InputError: ``wrong_length``, ``not_finite`` or ``out_of_range`` (a driver's −1 is out of range: it
            must be sent as ``null``).
    """
    if len(ranges) != robot.sensor_count:
        raise InputError("wrong_length", "ranges", f"{len(ranges)} values", f"{robot.sensor_count} values")
    scan = np.empty(len(ranges))
    index = 0
    for ring in robot.rings:
        for _ in range(ring.count):
            reading = ranges[index]
            if reading is None:
                scan[index] = math.inf
            elif not math.isfinite(reading):
                raise InputError("not_finite", f"ranges[{index}]", reading, "a finite number or null")
            elif not 0.0 <= reading <= ring.range_max:
                allowed = f"0 to {ring.range_max} m, or null for no echo"
                raise InputError("out_of_range", f"ranges[{index}]", reading, allowed)
            else:
                scan[index] = reading
            index += 1
    return scan


def checked_target(
    robot: Robot, kind: str, value: Sequence[float], controller: ControllerName | None = None
) -> Target:
    """Check a target.

    Args:
        robot: The robot.
        kind: One of ``TARGET_KINDS``.
        value: See ``Target``; a quaternion may be off unit length by 1e-3 and is brought to it.
        controller: The method; ``None`` for the robot file's.

    Raises:
        InputError: ``unsupported_kind``, ``unsupported_controller``, ``wrong_length``, ``not_finite`` or
            ``out_of_range``.
    """
    if kind not in TARGET_KINDS:
        raise InputError("unsupported_kind", "target.kind", kind, listed(TARGET_KINDS))
    length = {"joint_velocity": len(robot.joint_names), "twist": 6, "position": 3, "pose": 7}[kind]
    if len(value) != length:
        raise InputError(
            "wrong_length", "target.value", f"{len(value)} values", f"{length} values for {kind}"
        )
    if not all(map(math.isfinite, value)):
        raise InputError("not_finite", "target.value", value, "finite numbers")
    if any(abs(number) > 1000.0 for number in value):
        raise InputError("out_of_range", "target.value", value, "±1000")
    _check_orientation(robot, kind, value)
    _check_controller(robot, controller)
    numbers = np.array(value, dtype=np.float64)
    if kind == "pose":
        numbers[3:] /= math.hypot(*value[3:])
    return Target(kind=kind, value=numbers, controller=controller)


def _check_orientation(robot: Robot, kind: str, value: Sequence[float]) -> None:
    """Refuse a target that asks for an orientation which the free joints cannot give."""
    free = len(robot.free)
    if kind == "twist" and free < 6 and any(value[3:]):
        allowed = f"zeros: {free} free joints cannot hold an orientation"
        raise InputError("out_of_range", "target.value[3:6]", list(value[3:]), allowed)
    if kind == "pose":
        if free < 6:
            allowed = f"joint_velocity, twist or position: {free} free joints cannot hold an orientation"
            raise InputError("unsupported_kind", "target.kind", kind, allowed)
        if not abs(math.hypot(*value[3:]) - 1.0) <= QUATERNION_TOLERANCE:
            raise InputError("out_of_range", "target.value[3:7]", list(value[3:]), "a unit quaternion")


def _check_controller(robot: Robot, controller: ControllerName | None) -> None:
    """Refuse a method that this robot has not what it takes for."""
    if controller is None:
        return
    needed = FREE_JOINTS_OF_MODE.get(controller, 0)
    if len(robot.free) < needed:
        allowed = f"a method for {len(robot.free)} free joints; this one needs {needed}"
        raise InputError("unsupported_controller", "target.controller", controller, allowed)
    if controller == "field3d" and not robot.rings:
        allowed = "a method that needs no sensor ring; the robot file has none"
        raise InputError("unsupported_controller", "target.controller", controller, allowed)

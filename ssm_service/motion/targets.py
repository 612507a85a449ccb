"""From a target of the end effector to the velocities of all joints."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..config import MotionConfig
from ..errors import InputError
from .differential import damped_pseudo_inverse
from .field3d import field3d
from .fields import ObstaclePoint, conventional_field


def _spread(
    jacobian: NDArray[np.float64],
    free: NDArray[np.intp],
    velocity: NDArray[np.float64],
    config: MotionConfig,
    n: int,
) -> NDArray[np.float64]:
    """Return (n,) joint velocities for a task velocity; joints that are not free stay at exactly 0."""
    inverse = damped_pseudo_inverse(
        jacobian, threshold=config.singular_value_threshold, max_damping=config.max_damping
    )
    joints = np.zeros(n)
    joints[free] = inverse @ velocity
    return joints


def _check_vector(values: NDArray[np.float64], length: int, where: str) -> list[float]:
    """Return the values as a list, if there are ``length`` finite ones."""
    if values.shape != (length,):
        raise InputError("wrong_length", where, values.shape, f"{length} numbers")
    numbers: list[float] = values.tolist()
    if not all(map(math.isfinite, numbers)):
        raise InputError("not_finite", where, numbers, "finite numbers")
    return numbers


def twist_to_joints(
    jacobian_full: NDArray[np.float64],
    free: NDArray[np.intp],
    twist: NDArray[np.float64],
    config: MotionConfig,
    n: int,
) -> NDArray[np.float64]:
    """Return the joint velocities that track a twist of the end effector.

    With six or more free joints all six rows are tracked. With fewer, only the linear ones are, and a twist
    that asks for rotation is refused rather than half obeyed.

    Args:
        jacobian_full: (6, n) [linear; angular] of the end effector, base axes [m/rad; rad/rad].
        free: (k,) indices of the joints that may move.
        twist: (6,) linear velocity [m/s], then angular velocity [rad/s], of the end effector, base frame.
        config: Damping.
        n: Number of joints.

    Returns:
        (n,) [rad/s]; 0 for every joint that is not free.

    Raises:
        InputError: ``unsupported_twist``, ``wrong_length``, ``not_finite``.
    """
    numbers = _check_vector(twist, 6, "twist")
    if len(free) >= 6:
        return _spread(jacobian_full[:, free], free, twist, config, n)
    if any(numbers[3:]):
        raise InputError(
            "unsupported_twist", "twist[3:]", numbers[3:], f"zeros: {len(free)} free joints track no rotation"
        )
    return _spread(jacobian_full[:3, free], free, twist[:3], config, n)


def linear_to_joints(
    jacobian: NDArray[np.float64],
    free: NDArray[np.intp],
    velocity: NDArray[np.float64],
    config: MotionConfig,
    n: int,
) -> NDArray[np.float64]:
    """Return the joint velocities that move the end effector, whatever its orientation does.

    Args:
        jacobian: (3, k) linear rows, columns of the free joints, base axes [m/rad].
        free: (k,) indices of the joints that may move.
        velocity: (3,) [m/s], base frame.
        config: Damping.
        n: Number of joints.

    Returns:
        (n,) [rad/s]; 0 for every joint that is not free.

    Raises:
        InputError: ``wrong_length``, ``not_finite``.
    """
    _check_vector(velocity, 3, "velocity")
    return _spread(jacobian, free, velocity, config, n)


def field_velocity(
    position: NDArray[np.float64],
    goal: NDArray[np.float64],
    config: MotionConfig,
    *,
    controller: str,
    obstacle: ObstaclePoint | None = None,
    transforms_sensor_to_base: NDArray[np.float64] | None = None,
    ranges: NDArray[np.float64] | None = None,
    steps: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return the velocity that takes the end effector to a goal in a potential field.

    Args:
        position: (3,) of the end effector [m], base frame.
        goal: (3,) [m], base frame.
        config: Gains and speeds.
        controller: ``field`` or ``field3d``.
        obstacle: What repels in the conventional field.
        transforms_sensor_to_base: (m, 4, 4) [m], for the 3-D field.
        ranges: (m,) readings [m] for the 3-D field, infinite is no echo. Without transforms or readings that
            field gives no motion: it could avoid nothing.
        steps: (m,) weights of the sensors from ``sensor_steps``; left out, all sensors are one ring's.

    Returns:
        (3,) [m/s], base frame.

    Raises:
        InputError: ``wrong_length``, ``not_finite``, ``out_of_range``; ``unsupported_controller`` for a
            method that is no field.
    """
    _check_vector(position, 3, "position")
    _check_vector(goal, 3, "goal")
    if controller == "field":
        return conventional_field(position, goal, obstacle, config)
    if controller != "field3d":
        raise InputError("unsupported_controller", "controller", controller, "field or field3d")
    if transforms_sensor_to_base is None or ranges is None:
        return np.zeros(3)
    return field3d(position, goal, transforms_sensor_to_base, ranges, config, steps)

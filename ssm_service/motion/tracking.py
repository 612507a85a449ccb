"""From a target of the end effector to its twist: straight to the goal, and no faster than configured."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..config import MotionConfig
from .fields import free_speed, goal_distance


def linear_approach(
    position: NDArray[np.float64], goal: NDArray[np.float64], config: MotionConfig
) -> NDArray[np.float64]:
    """Return the velocity that takes a point straight to its goal.

    Its size is ``min(speed_m_s, approach_gain · distance)``, and 0 within ``arrival_tolerance_m``.

    Args:
        position: (3,) [m], base frame.
        goal: (3,) [m], base frame.
        config: Speeds.

    Returns:
        (3,) [m/s], base frame.

    Raises:
        InputError: ``not_finite``.
    """
    distance = goal_distance(position, goal)
    speed = free_speed(distance, config)
    return (goal - position) * (speed / distance) if speed > 0.0 else np.zeros(3)


def angular_approach(
    rotation: NDArray[np.float64], goal: NDArray[np.float64], config: MotionConfig
) -> NDArray[np.float64]:
    """Return the angular velocity that turns a frame the shorter way to its goal.

    Its size is ``min(rotation_speed_rad_s, approach_gain · angle)``. Unlike ``½ (i×i_d + j×j_d + k×k_d)``
    ([Neri2023] (8)), which is the sine of the angle along the same axis, it does not vanish half a turn away.

    Args:
        rotation: (3, 3) of the frame, base frame.
        goal: (3, 3), base frame.
        config: Speeds.

    Returns:
        (3,) [rad/s], base frame.
    """
    turn: NDArray[np.float64] = pin.log3(goal @ rotation.T)  # scipy's takes a hundred times as long
    angle = math.hypot(*turn.tolist())
    if angle <= LEAST_ANGLE_RAD:
        return np.zeros(3)
    speed = min(config.rotation_speed_rad_s, config.approach_gain * angle)
    velocity: NDArray[np.float64] = turn * (speed / angle)
    return velocity


LEAST_ANGLE_RAD = 1e-6


def rotation_of(quaternion_xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of a unit quaternion (4,), x y z w, as a matrix (3, 3)."""
    matrix: NDArray[np.float64] = Rotation.from_quat(quaternion_xyzw).as_matrix()
    return matrix

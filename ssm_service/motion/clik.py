"""Closed-loop inverse kinematics with a repulsive velocity: the three modes of [Neri2023].

    q̇ = J⁺ (ẋ + K e) + J_mode⁺ [a_v v_rep d̂; 0]                                       (7), (9), (11)

The first term tracks the planned pose, the second moves ``P_r``, the point of the arm that is nearest to an
obstacle, away from it. What else the second term holds still is the mode's choice:

    mode  rows of J_mode             the avoidance may change
    1     J_0p                       position and orientation
    2     J_0p, J_r4, J_r5 (10)      position, and rotation about the vertical
    3     J_0p, J_r (12)             position only

Every inverse is ``differential.damped_pseudo_inverse``, with the configuration's threshold and damping.

What the paper leaves open, and what is done here:

* **The sign of the error.** Of (8) the text has lost the signs; here ``+K e`` drives P to P_d.
* **The activation a_v** is not printed. Here it rises in a straight line from 0 at r to 1 at ``2r/3``:
  continuous, so that no command jumps at the radius, and with the gain ``3 v_rep/r`` that a loop with latency
  must bear, 20 s⁻¹ for 1 m/s at 0.15 m.
* **The vertical** is the z axis of the base frame: rows 4 and 5 of J are turning about its x and y axes.
* **The distance** is the caller's. The paper's is that from a link's axis to an obstacle's centre (module
  ``segments``), which has to leave room for both their radii; that between surfaces is as good.
* **Fewer than six joints.** A pose cannot be tracked then. With five, mode 2 still tracks and keeps the axis;
  otherwise only the linear rows are tracked, orientation is not held, and a mode that promises it is refused.

Known weaknesses: only the most critical pair counts, so the command jumps where another takes its place, and
nothing keeps away from the others; an obstacle straight ahead on the way to P_d stops the arm, or is driven
through where ``k_ep |e|`` exceeds ``v_rep``. The saturation of single joints bends the path and breaks what a
mode promises for as long as it lasts; the error term makes that good afterwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..config import MotionConfig
from ..errors import InputError
from .differential import damped_pseudo_inverse

Array = NDArray[np.float64]
Mode = Literal[1, 2, 3]

FULL_ACTIVATION: Final = 2.0 / 3.0
"""Share of the radius at which ``a_v`` reaches 1."""

_HELD: Final = {1: [], 2: [3, 4], 3: [3, 4, 5]}
"""Angular rows of the Jacobian that the avoidance holds at 0, by mode."""

_JOINTS_NEEDED: Final = {1: 1, 2: 5, 3: 6}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Critical:
    """The most critical pair of link and obstacle.

    Attributes:
        distance: d_o [m], as the caller measures it; negative in penetration, ``-inf`` where it is unknown.
        direction: (3,) d̂, unit, away from the obstacle, base frame, read-only.
        jacobian: (3, k) J_0p [m/rad] of P_r, columns of the free joints, base axes, read-only.

    Raises:
        InputError: ``not_finite``, ``wrong_length``, ``out_of_range`` if the direction has not unit length.
    """

    distance: float
    direction: Array
    jacobian: Array

    def __post_init__(self) -> None:
        for name in ("direction", "jacobian"):
            copy = np.array(getattr(self, name), dtype=np.float64)
            copy.setflags(write=False)
            object.__setattr__(self, name, copy)
        if math.isnan(self.distance):
            raise InputError("not_finite", "critical.distance", self.distance, "a number")
        if self.direction.shape != (3,) or self.jacobian.ndim != 2 or self.jacobian.shape[0] != 3:
            found = [self.direction.shape, self.jacobian.shape]
            raise InputError("wrong_length", "critical", found, "a direction (3,) and a Jacobian (3, k)")
        length = math.hypot(*self.direction.tolist())
        if not abs(length - 1.0) <= 1e-6:
            cause = "out_of_range" if math.isfinite(length) else "not_finite"
            raise InputError(cause, "critical.direction", self.direction.tolist(), "a unit vector")


def pose_error(position: Array, rotation: Array, position_desired: Array, rotation_desired: Array) -> Array:
    """Return ``e = [P_d − P; ½ (i×i_d + j×j_d + k×k_d)]`` ([Neri2023] (8)).

    ``+K e`` as a twist drives the pose to the desired one. The angular part is ``n sin θ``, with θ and n the
    angle and the axis (base frame) of the rotation from the present to the desired orientation: it grows up
    to 90°, and at 180° it is 0 though the pose is wrong, an equilibrium that every disturbance ends.

    Args:
        position: (3,) P [m], base frame.
        rotation: (3, 3), columns i, j, k of the end effector, base frame.
        position_desired: (3,) P_d [m].
        rotation_desired: (3, 3).

    Returns:
        (6,) [m; rad for small angles], base frame.
    """
    error = np.empty(6)
    error[:3] = position_desired - position
    # ½ Σ a×a_d is the vector of the antisymmetric part of R_d Rᵀ.
    turn = rotation_desired @ rotation.T
    error[3] = 0.5 * (turn[2, 1] - turn[1, 2])
    error[4] = 0.5 * (turn[0, 2] - turn[2, 0])
    error[5] = 0.5 * (turn[1, 0] - turn[0, 1])
    return error


def influence_radius(speed: float, config: MotionConfig) -> float:
    """Return r [m] for an obstacle's speed: linear from (v_inf, r_inf) to (v_sup, r_sup), constant outside.

    Args:
        speed: Magnitude of the obstacle's velocity [m/s]; infinite gives r_sup.
        config: ``clik`` holds the four numbers.

    Raises:
        InputError: ``not_finite`` for NaN, ``out_of_range`` for a negative speed.
    """
    if not speed >= 0.0:
        cause = "not_finite" if math.isnan(speed) else "out_of_range"
        raise InputError(cause, "speed", speed, "a speed ≥ 0")
    clik = config.clik
    share = (speed - clik.speed_min_m_s) / (clik.speed_max_m_s - clik.speed_min_m_s)
    share = min(max(share, 0.0), 1.0)
    return clik.radius_min_m + share * (clik.radius_max_m - clik.radius_min_m)


def activation(distance: float, radius: float) -> float:
    """Return a_v: 0 from the radius on, 1 at ``FULL_ACTIVATION`` of it and nearer by, linear between.

    Args:
        distance: d_o [m].
        radius: r [m].

    Raises:
        InputError: ``not_finite`` for NaN, ``out_of_range`` for a radius that is not above 0.
    """
    if math.isnan(distance):
        raise InputError("not_finite", "distance", distance, "a number")
    if not 0.0 < radius < math.inf:
        cause = "out_of_range" if radius <= 0.0 else "not_finite"
        raise InputError(cause, "radius", radius, "a radius above 0, finite")
    return min(max((radius - distance) / ((1.0 - FULL_ACTIVATION) * radius), 0.0), 1.0)


def clik_velocity(
    mode: Mode,
    jacobian: Array,
    twist_desired: Array,
    error: Array,
    critical: Critical | None,
    radius: float,
    config: MotionConfig,
) -> Array:
    """Return the joint velocities of one mode ([Neri2023] (7), (9), (11); see the module).

    Args:
        mode: 1, 2 or 3.
        jacobian: (6, k) of the end effector, linear rows [m/rad] over angular rows, columns of the free
            joints, base axes.
        twist_desired: (6,) ẋ, linear [m/s] then angular [rad/s] velocity, base frame.
        error: (6,) from ``pose_error``.
        critical: The most critical pair; None where there is no obstacle.
        radius: r [m] of its obstacle, from ``influence_radius``.
        config: Gains, speeds and damping.

    Returns:
        (k,) [rad/s], each joint cut at ``clik.joint_speed_max_rad_s``.

    Raises:
        InputError: ``unsupported_mode`` for another number, or for a mode that holds more than k joints can;
            ``wrong_length``; ``not_finite``.
    """
    rows = _tracked_rows(mode, jacobian, critical)
    clik = config.clik
    gains = np.repeat((clik.position_gain, clik.orientation_gain), 3)
    task = _six(twist_desired, "twist_desired") + gains * _six(error, "error")
    velocity = _inverse(jacobian[rows], config) @ task[rows]
    if critical is not None:
        velocity += avoidance_velocity(mode, jacobian, critical, radius, config)
    greatest = clik.joint_speed_max_rad_s
    limited: Array = np.clip(velocity, -greatest, greatest)
    return limited


def avoidance_velocity(
    mode: Mode, jacobian: Array, critical: Critical, radius: float, config: MotionConfig
) -> Array:
    """Return the second term alone, ``J_mode⁺ [a_v v_rep d̂; 0]``: for motions that are no pose's.

    Args:
        mode: 1, 2 or 3.
        jacobian: (6, k) of the end effector, as in ``clik_velocity``.
        critical: The most critical pair.
        radius: r [m] of its obstacle.
        config: Speeds and damping.

    Returns:
        (k,) [rad/s], not yet cut at ``clik.joint_speed_max_rad_s``; 0 beyond the radius.

    Raises:
        InputError: ``unsupported_mode``, ``wrong_length``, ``not_finite``, ``out_of_range``.
    """
    _tracked_rows(mode, jacobian, critical)
    strength = activation(critical.distance, radius)
    if strength == 0.0:
        return np.zeros(jacobian.shape[1])
    held = _HELD[mode]
    avoiding = np.vstack((critical.jacobian, jacobian[held]))
    away = np.zeros(3 + len(held))
    away[:3] = (strength * config.clik.repulsive_speed_m_s) * critical.direction
    return np.asarray(_inverse(avoiding, config) @ away)


def _tracked_rows(mode: int, jacobian: Array, critical: Critical | None) -> list[int]:
    """Return the rows of the task that the first term tracks; refuse what does not fit together."""
    if mode not in _HELD:
        raise InputError("unsupported_mode", "mode", mode, "1, 2 or 3")
    if jacobian.ndim != 2 or len(jacobian) != 6:
        raise InputError("wrong_length", "jacobian", jacobian.shape, "6 rows")
    joints = jacobian.shape[1]
    if joints < _JOINTS_NEEDED[mode]:
        allowed = (
            f"at least {_JOINTS_NEEDED[mode]} free joints for what mode {mode} holds; mode 1 needs fewer"
        )
        raise InputError("unsupported_mode", "mode", f"{mode} with {joints} free joints", allowed)
    if critical is not None and critical.jacobian.shape[1] != joints:
        raise InputError("wrong_length", "critical.jacobian", critical.jacobian.shape, f"{joints} columns")
    if joints >= 6:
        return [0, 1, 2, 3, 4, 5]
    return [0, 1, 2, *_HELD[mode]]


def _inverse(jacobian: Array, config: MotionConfig) -> Array:
    return damped_pseudo_inverse(
        jacobian, threshold=config.singular_value_threshold, max_damping=config.max_damping
    )


def _six(values: Array, where: str) -> Array:
    if values.shape != (6,):
        raise InputError("wrong_length", where, values.shape, "6 numbers")
    # Finite sum: cheaper than six tests, and NaN or infinity in any of them spoils it.
    if not math.isfinite(float(values.sum())):
        raise InputError("not_finite", where, values.tolist(), "finite numbers")
    return values

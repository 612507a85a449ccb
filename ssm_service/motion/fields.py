"""Potential fields: from a goal and the obstacle's distance to a velocity of the end effector.

[Kang2022] (11)–(16): the goal attracts like a spring, an obstacle repels within its distance of influence.
The force gives the direction; the speed is that of the configuration. With ``e`` the distance to the goal
and ``c = min(speed_m_s, approach_gain·e)``,

    v = F · c / max(|F_att|, |F|)

so without an obstacle ``|v| = c``, with one ``|v| ≤ c`` always, and v is continuous: it vanishes where the
forces balance instead of changing sign from tick to tick. Sampled with a period ``dt`` the approach to the
goal is free of overshoot while ``approach_gain · dt < 1``.

Known weaknesses of every such field, named by [Kang2022] as future work: **local minima**. An obstacle on
the straight line to the goal stops the end effector where attraction and repulsion balance, and it stays
there; and a goal within the influence of an obstacle is not reached, but a place beside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import MotionConfig
from ..errors import InputError

LEAST_DISTANCE_M = 1e-3
"""Distances below this, contact and penetration too, repel as this one does: (16) has a pole at 0."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObstaclePoint:
    """The nearest point of the nearest obstacle, as the conventional field sees it.

    Attributes:
        distance: ρ [m]; negative in penetration.
        direction: (3,) unit vector away from the obstacle, base frame, read-only.

    Raises:
        InputError: ``not_finite``, or ``out_of_range`` if the direction is not of unit length.
    """

    distance: float
    direction: NDArray[np.float64]

    def __post_init__(self) -> None:
        direction = np.array(self.direction, dtype=np.float64)
        direction.setflags(write=False)
        object.__setattr__(self, "direction", direction)
        if math.isnan(self.distance):
            raise InputError("not_finite", "obstacle.distance", self.distance, "a number")
        length = math.hypot(*direction.tolist())
        if not abs(length - 1.0) <= 1e-6:
            cause = "out_of_range" if math.isfinite(length) else "not_finite"
            raise InputError(cause, "obstacle.direction", direction.tolist(), "a unit vector")


def attractive_force(
    position: NDArray[np.float64], goal: NDArray[np.float64], gain: float
) -> NDArray[np.float64]:
    """Return ``F_att = −ξ (q − q_goal)``, the negative gradient of ``½ ξ ρ_goal²`` ([Kang2022] (13), (14)).

    Args:
        position: (d,) q [m].
        goal: (d,) q_goal [m], in the same frame.
        gain: ξ [1/s²].

    Returns:
        (d,) [m/s²].
    """
    return gain * (goal - position)


def repulsive_magnitude(distance: float, gain: float, influence: float) -> float:
    """Return ``|F_rep| = η (1/ρ − 1/ρ0) / ρ²`` for ``ρ ≤ ρ0``, else 0 ([Kang2022] (16)).

    It is the negative derivative of ``½ η (1/ρ − 1/ρ0)²`` (15), continuous at ρ0, and constant below
    ``LEAST_DISTANCE_M``.

    Args:
        distance: ρ [m]; infinite is no obstacle.
        gain: η [m⁴/s²].
        influence: ρ0 [m].

    Returns:
        [m/s²], never negative.

    Raises:
        InputError: ``not_finite`` if the distance is NaN.
    """
    if math.isnan(distance):
        raise InputError("not_finite", "distance", distance, "a number, or infinity for no obstacle")
    near = max(distance, LEAST_DISTANCE_M)
    if near >= influence:
        return 0.0
    return gain * (1.0 / near - 1.0 / influence) / (near * near)


def repulsive_force(
    distance: float, direction: NDArray[np.float64], gain: float, influence: float
) -> NDArray[np.float64]:
    """Return ``F_rep`` ([Kang2022] (16)): ``repulsive_magnitude`` along ``(q − q_obs)/ρ``.

    Args:
        distance: ρ [m].
        direction: (d,) unit vector away from the obstacle.
        gain: η [m⁴/s²].
        influence: ρ0 [m].

    Returns:
        (d,) [m/s²].
    """
    return repulsive_magnitude(distance, gain, influence) * direction


def free_speed(distance: float, config: MotionConfig) -> float:
    """Return the speed [m/s] at a distance [m] from the goal where no obstacle is; 0 on arrival."""
    if distance <= config.arrival_tolerance_m:
        return 0.0
    return min(config.speed_m_s, config.approach_gain * distance)


def goal_distance(position: NDArray[np.float64], goal: NDArray[np.float64]) -> float:
    """Return the distance [m] to the goal.

    Raises:
        InputError: ``not_finite`` if it is not a number, or infinite.
    """
    distance = math.dist(position.tolist(), goal.tolist())
    if not math.isfinite(distance):
        found = {"position": position.tolist(), "goal": goal.tolist()}
        raise InputError("not_finite", "position, goal", found, "finite numbers")
    return distance


def with_speed(force: NDArray[np.float64], reference: float, speed: float) -> NDArray[np.float64]:
    """Return ``force · speed / max(reference, |force|)``: along the force, never faster than ``speed``."""
    return force * (speed / max(reference, math.hypot(*force.tolist())))


def conventional_field(
    position: NDArray[np.float64],
    goal: NDArray[np.float64],
    obstacle: ObstaclePoint | None,
    config: MotionConfig,
) -> NDArray[np.float64]:
    """Return the velocity of the end effector in the conventional field: one distance, one direction.

    [Kang2022] (11)–(16) in three dimensions. See the module for speed and local minima.

    Args:
        position: (3,) of the end effector [m], base frame.
        goal: (3,) [m], base frame.
        obstacle: The nearest point of an obstacle, or none.
        config: Gains and speeds.

    Returns:
        (3,) velocity of the end effector [m/s], base frame; zero within ``arrival_tolerance_m``.

    Raises:
        InputError: ``not_finite``.
    """
    distance = goal_distance(position, goal)
    speed = free_speed(distance, config)
    if speed == 0.0:
        return np.zeros(3)
    gain = config.attractive_gain
    force = attractive_force(position, goal, gain)
    if obstacle is not None:
        force += repulsive_force(
            obstacle.distance, obstacle.direction, config.repulsive_gain, config.influence_distance_m
        )
    return with_speed(force, gain * distance, speed)

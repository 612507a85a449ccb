"""The 3-D potential field of a sensor ring ([Kang2022] Algorithm 1).

Sensor ``i`` looks along the x axis of its frame; z lies along the ring's axis. In its x–z plane it makes a
2-D field: the goal attracts with the projection of ``g``, the offset to the goal in the sensor's frame, and
an echo at ``d`` repels from ``(d, 0)``, along −x ([Kang2022] (14), (16)):

    F_i = ξ (g_x, g_z) − (η (1/d − 1/ρ0)/d², 0)

The fields are turned into the base frame and summed, with a step: ``Σ T_base_sensor(i) δ_i(x,z) F_i/|F_i|``.
The paper prints neither the value of ``δ_i(x,z)`` nor how it depends on the sensor ``i`` and the axes
``(x,z)``. That choice decides what the algorithm does:

* **One constant step**, the plain reading (``field3d_as_printed``). In free space it always comes nearer to
  the goal, but not straight: for eight sensors it is off by up to 26°, 19° on average over all directions. In
  the ring's plane it takes only directions at multiples of 22.5° and jumps from one to the next. (The paper's
  own arm 'moves along the shortest path' without an obstacle.) And each sensor has one vote whatever its
  distance: an echo straight ahead turns round one of eight unit vectors, and the sum still points at the
  obstacle with 59 % of its free length, right up to contact.
* **A step in proportion to the 2-D force**, ``δ_i(x,z) = |F_i| · diag(2, 1)/k`` for a ring of k sensors
  (``field3d``, for use). For k ≥ 3 the attractions then add up to exactly ``ξ (goal − position)``, so

      F = ξ (goal − position) − (2/k) Σ_i η (1/d_i − 1/ρ0)/d_i² · x_i

  It heads straight for the goal when nothing echoes, is continuous in everything, and lets the nearest echo
  count most. One echo repels with 2/k of the conventional field's force at the same η; several add up.

Both have the bounds of the module ``fields``, and its known weakness: local minima. Besides, what no sensor
sees does not repel, and eight cones of 20° leave most of the directions unseen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..config import MotionConfig
from ..errors import InputError
from .fields import free_speed, goal_distance, repulsive_magnitude, with_speed


def sensor_steps(counts: Iterable[int]) -> NDArray[np.float64]:
    """Return the weight ``2/k`` (at most 1) of each sensor's repulsion, for rings of ``counts`` sensors.

    Args:
        counts: Number of sensors of each ring, in the order of the readings.

    Returns:
        (m,), m the number of all sensors.
    """
    weights = [min(1.0, 2.0 / count) for count in counts for _ in range(count)]
    return np.array(weights, dtype=np.float64)


def sensor_repulsions(ranges: NDArray[np.float64], config: MotionConfig) -> list[float]:
    """Return ``|F_rep|`` [m/s²] of each sensor ([Kang2022] (16)).

    Args:
        ranges: (m,) readings [m]; infinite is no echo.
        config: Gains.

    Returns:
        m numbers, 0 for a sensor without an echo within ρ0.

    Raises:
        InputError: ``not_finite`` for NaN, ``out_of_range`` for a negative reading (−1 is never a distance).
    """
    gain, influence = config.repulsive_gain, config.influence_distance_m
    result = []
    for index, reading in enumerate(ranges.tolist()):
        if not reading >= 0.0:
            cause = "not_finite" if math.isnan(reading) else "out_of_range"
            raise InputError(cause, f"ranges[{index}]", reading, "a distance ≥ 0, infinite for no echo")
        result.append(0.0 if reading >= influence else repulsive_magnitude(reading, gain, influence))
    return result


def _check_count(transforms: NDArray[np.float64], ranges: NDArray[np.float64]) -> None:
    if len(transforms) != len(ranges):
        raise InputError("wrong_length", "ranges", len(ranges), f"{len(transforms)} readings")


def field3d(
    position: NDArray[np.float64],
    goal: NDArray[np.float64],
    transforms_sensor_to_base: NDArray[np.float64],
    ranges: NDArray[np.float64],
    config: MotionConfig,
    steps: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return the velocity of the end effector in the 3-D field ([Kang2022] Algorithm 1, see the module).

    Args:
        position: (3,) of the end effector [m], base frame.
        goal: (3,) [m], base frame.
        transforms_sensor_to_base: (m, 4, 4) [m], x the sensing direction.
        ranges: (m,) readings [m]; infinite is no echo.
        config: Gains and speeds.
        steps: (m,) weights of the sensors from ``sensor_steps``; left out, all sensors are one ring's.

    Returns:
        (3,) velocity of the end effector [m/s], base frame; zero within ``arrival_tolerance_m``.

    Raises:
        InputError: ``not_finite``, ``out_of_range``, ``wrong_length``.
    """
    _check_count(transforms_sensor_to_base, ranges)
    distance = goal_distance(position, goal)
    repulsions = sensor_repulsions(ranges, config)
    speed = free_speed(distance, config)
    if speed == 0.0:
        return np.zeros(3)
    gain = config.attractive_gain
    force = gain * (goal - position)
    if any(repulsions):
        weights = min(1.0, 2.0 / len(repulsions)) if steps is None else steps
        force -= (repulsions * np.asarray(weights)) @ transforms_sensor_to_base[:, :3, 0]
    return with_speed(force, gain * distance, speed)


def printed_sum(
    offset: NDArray[np.float64],
    transforms_sensor_to_base: NDArray[np.float64],
    repulsions: NDArray[np.float64],
    gain: float,
) -> NDArray[np.float64]:
    """Return ``Σ T_base_sensor(i) F_i/|F_i|``, the sum of Algorithm 1 with a constant step of 1.

    Args:
        offset: (3,) goal − position [m], base frame.
        transforms_sensor_to_base: (m, 4, 4) [m].
        repulsions: (m,) |F_rep| of each sensor [m/s²].
        gain: ξ [1/s²].

    Returns:
        (3,), base frame. A sensor whose 2-D force is 0 adds nothing.
    """
    x = transforms_sensor_to_base[:, :3, 0]
    z = transforms_sensor_to_base[:, :3, 2]
    force_x = gain * (x @ offset) - repulsions
    force_z = gain * (z @ offset)
    norm = np.hypot(force_x, force_z)
    norm[norm == 0.0] = 1.0
    total: NDArray[np.float64] = (force_x / norm) @ x + (force_z / norm) @ z
    return total


def field3d_as_printed(
    position: NDArray[np.float64],
    goal: NDArray[np.float64],
    transforms_sensor_to_base: NDArray[np.float64],
    ranges: NDArray[np.float64],
    config: MotionConfig,
) -> NDArray[np.float64]:
    """Return the velocity with one constant step. For comparison only: it does not keep clear of obstacles.

    See the module. The step is chosen so that the speed without an echo is that of ``field3d``. Arguments,
    result and errors are those of ``field3d``.
    """
    _check_count(transforms_sensor_to_base, ranges)
    distance = goal_distance(position, goal)
    repulsions = np.array(sensor_repulsions(ranges, config))
    speed = free_speed(distance, config)
    if speed == 0.0:
        return np.zeros(3)
    offset, gain = goal - position, config.attractive_gain
    total = printed_sum(offset, transforms_sensor_to_base, repulsions, gain)
    if not repulsions.any():
        return with_speed(total, 0.0, speed)
    free = printed_sum(offset, transforms_sensor_to_base, np.zeros(len(ranges)), gain)
    return with_speed(total, math.hypot(*free.tolist()), speed)

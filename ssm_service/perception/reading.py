"""The model of one reading: the least distance from a sensor to an obstacle point inside its cone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model.shapes import Obstacle
from .cone_program import least_distance
from .seen_shapes import SeenShape


def cone_reading(
    obstacle: Obstacle,
    transform_sensor_to_base: NDArray[np.float64],
    half_angle: float,
    range_max: float,
    range_min: float = 0.0,
) -> float:
    """Return what one ideal sensor reads of one obstacle [m], ``inf`` for no echo.

    The reading is exact to 1e-6 m. Where a shape only just grazes the edge of the cone the reading jumps;
    there it may be that of an obstacle larger by 1e-7 m (1e-5 m at the very most): never silence for an echo.

    Args:
        obstacle: The obstacle, in the base frame.
        transform_sensor_to_base: (4, 4) [m]; the sensor looks along its own +x.
        half_angle: Half of the sensor's field of view [rad], in (0, π/2).
        range_max: Greatest distance that the sensor reports [m]; beyond it there is no echo.
        range_min: Least distance that the sensor resolves [m]; an echo from nearer is read as this,
            never as silence.

    Raises:
        InputError: ``wrong_length``, ``not_finite`` or ``out_of_range`` arguments.
        SsmError: The solver failed (see ``cone_program.least_distance``).
    """
    transforms = np.asarray(transform_sensor_to_base, dtype=np.float64)[np.newaxis]
    return float(scan([obstacle], transforms, half_angle, range_max, range_min)[0])


def scan(
    obstacles: Sequence[Obstacle],
    transforms_sensor_to_base: NDArray[np.float64],
    half_angle: float,
    range_max: float,
    range_min: float = 0.0,
) -> NDArray[np.float64]:
    """Return what each sensor reads of all obstacles: the least of ``cone_reading``, (m,) [m].

    Args:
        obstacles: The obstacles, in the base frame; none gives no echo.
        transforms_sensor_to_base: (m, 4, 4) [m].
        half_angle: As for ``cone_reading``; likewise the two ranges.
        range_max: As above.
        range_min: As above.

    Raises:
        InputError: ``wrong_length``, ``not_finite`` or ``out_of_range`` arguments.
        SsmError: The solver failed (see ``cone_program.least_distance``).
    """
    transforms = _checked(transforms_sensor_to_base, half_angle, range_max, range_min)
    if not obstacles or not len(transforms):
        return np.full(len(transforms), math.inf)
    spheres = np.array([obstacle.shape == "sphere" for obstacle in obstacles])
    bounds = _ball_readings(obstacles, transforms, half_angle)
    readings = np.min(bounds, axis=1, initial=math.inf, where=spheres)
    bounds[:, spheres] = math.inf
    for sensor, row in enumerate(bounds):
        best = min(float(readings[sensor]), range_max)
        for index in np.argsort(row, kind="stable"):
            if row[index] > best or row[index] == math.inf:
                break
            reading = _convex_reading(obstacles[index], transforms[sensor], half_angle, best)
            if reading <= best:
                readings[sensor] = best = reading
    readings[readings > range_max] = math.inf
    raised: NDArray[np.float64] = np.maximum(readings, range_min)
    return raised


def sphere_readings(
    centres: NDArray[np.float64], radii: NDArray[np.float64] | float, half_angle: float
) -> NDArray[np.float64]:
    """Return the readings of balls in closed form, whatever their range.

    With c the centre's distance, ψ its angle off the sensing axis and δ = ψ − α: 0 where the apex is inside,
    c − R where the centre is in the cone, c·cos δ − √(R² − (c·sin δ)²) where the ball reaches over the edge,
    else ``inf``.

    Args:
        centres: (..., 3) [m], sensor frame.
        radii: (...) [m].
        half_angle: α [rad], in (0, π/2).

    Returns:
        (...) [m].
    """
    x, off_axis = centres[..., 0], np.hypot(centres[..., 1], centres[..., 2])
    cos, sin = math.cos(half_angle), math.sin(half_angle)
    along = x * cos + off_axis * sin  # c·cos δ
    beside = off_axis * cos - x * sin  # c·sin δ; not positive inside the cone
    gap = np.hypot(x, off_axis) - radii
    root = np.sqrt(np.maximum(radii * radii - beside * beside, 0.0))
    # c·cos δ − root, written without the cancellation: (c² − R²) / (c·cos δ + root)
    with np.errstate(divide="ignore", invalid="ignore"):
        over_edge = gap * (gap + 2.0 * radii) / (along + root)
    missed = (beside > radii) | (along <= 0.0)
    reading = np.where(beside <= 0.0, gap, np.where(missed, math.inf, over_edge))
    return np.where(gap <= 0.0, 0.0, reading)


def _ball_readings(
    obstacles: Sequence[Obstacle], transforms: NDArray[np.float64], half_angle: float
) -> NDArray[np.float64]:
    """Return the readings of the balls round the obstacles, (m, k): exact for spheres, else lower bounds."""
    positions = np.array([obstacle.position for obstacle in obstacles])
    radii = np.array([_ball_radius(obstacle) for obstacle in obstacles])
    from_sensors = positions[np.newaxis] - transforms[:, np.newaxis, :3, 3]
    return sphere_readings(from_sensors @ transforms[:, :3, :3], radii, half_angle)


def _ball_radius(obstacle: Obstacle) -> float:
    """Return the radius [m] of the ball round the obstacle: a sphere's own, of others a hair too much."""
    if obstacle.shape == "sphere":
        return obstacle.size[0]
    if obstacle.shape == "capsule":
        radius = obstacle.size[0] + 0.5 * obstacle.size[1]
    elif obstacle.shape == "cylinder":
        radius = math.hypot(obstacle.size[0], 0.5 * obstacle.size[1])
    else:
        radius = 0.5 * math.hypot(*obstacle.size)
    return radius * (1.0 + 1e-9)


def _convex_reading(
    obstacle: Obstacle, transform_sensor_to_base: NDArray[np.float64], half_angle: float, limit: float
) -> float:
    """Return the reading of an obstacle that is no sphere; ``inf`` where above ``limit`` or none."""
    seen = SeenShape.of(obstacle, transform_sensor_to_base)
    nearest = seen.nearest()
    x, y, z = nearest.tolist()
    distance = math.hypot(x, y, z)
    if distance > limit:
        return math.inf
    # In the cone, the apex included; 1e-12 m of rounding counts as touching.
    if math.cos(half_angle) * math.hypot(y, z) - math.sin(half_angle) * x <= 1e-12:
        return distance if distance > 1e-12 else 0.0
    if seen.is_parted(nearest, half_angle) or seen.is_parted(seen.centre, half_angle):
        return math.inf
    reading = max(distance, least_distance(seen, half_angle))
    return reading if reading <= limit else math.inf


def _checked(
    transforms: NDArray[np.float64], half_angle: float, range_max: float, range_min: float
) -> NDArray[np.float64]:
    transforms = np.asarray(transforms, dtype=np.float64)
    if transforms.ndim != 3 or transforms.shape[1:] != (4, 4):
        raise InputError(
            "wrong_length", "transform_sensor_to_base", transforms.shape, "4 × 4 for each sensor"
        )
    if not np.isfinite(transforms).all():
        raise InputError("not_finite", "transform_sensor_to_base", transforms.tolist(), "finite numbers")
    if not 0.0 < half_angle < math.pi / 2.0:
        raise InputError("out_of_range", "half_angle", half_angle, "above 0 and below π/2 rad")
    if not 0.0 <= range_min < range_max < math.inf:
        raise InputError("out_of_range", "range_max", (range_min, range_max), "0 <= range_min < range_max")
    return transforms

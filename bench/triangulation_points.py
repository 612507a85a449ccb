"""Points inside two cones of a widened ring: `corrected` is exact there and `as_printed` short."""

from __future__ import annotations

import math

import coal
import msgspec
import numpy as np

from ssm_service.model import Ring, Robot
from ssm_service.perception import sphere_readings
from ssm_service.perception.estimators_batch import estimate_many

from .common import Row
from .triangulation_scenes import GAP_M, Floats

FIELD_OF_VIEW_DEG = 100.0
_LENGTH_M = 4.0


def widened_ring(robot: Robot) -> Ring:
    """Return the robot's first ring with cones so wide that neighbours overlap."""
    config = msgspec.structs.replace(robot.config.file.rings[0], field_of_view_deg=FIELD_OF_VIEW_DEG)
    return Ring.from_config(config)


def point_errors(robot: Robot, seed: int, count: int) -> tuple[Ring, dict[str, Floats], Floats]:
    """Return the ring, each estimator's errors (NaN: no answer) and Coal's distances, (count,) [m].

    Points are drawn in the ring's plane; Coal measures them from a cylinder of the ring's radius.
    """
    ring = widened_ring(robot)
    rng = np.random.default_rng([seed, count])
    gap, bearing = rng.uniform(*GAP_M, count), rng.uniform(-math.pi, math.pi, count)
    rho = ring.radius + gap
    points = np.stack([rho * np.cos(bearing), rho * np.sin(bearing), np.zeros(count)], axis=1)
    T = ring.transform_sensors_to_ring
    seen = np.einsum("nsi,sij->nsj", points[:, np.newaxis] - T[:, :3, 3], T[:, :3, :3])
    readings = sphere_readings(seen, 0.0, ring.half_angle)
    readings = np.where(np.isfinite(readings).sum(axis=1, keepdims=True) >= 2, readings, np.inf)
    truth = np.array([_cylinder_distance(ring.radius, point) for point in points])
    many = estimate_many(ring, readings, np.eye(4))
    return ring, {name: found.distances - truth for name, found in many.items()}, truth


def point_rows(robot: Robot, seed: int, count: int) -> list[Row]:
    """Return a row for each estimator, errors in m."""
    ring, errors, _ = point_errors(robot, seed, count)
    rows = []
    for name, error in errors.items():
        error = error[~np.isnan(error)]
        if not len(error):
            continue
        rows.append(
            {
                "estimator": name,
                "points": count,
                "answered": len(error),
                "median": float(np.median(error)),
                "worst_over": float(error.max()),
                "worst_under": float(error.min()),
                "median_in_radii": float(np.median(error)) / ring.radius,
            }
        )
    return rows


def _cylinder_distance(radius: float, point: Floats) -> float:
    result = coal.DistanceResult()
    here, there = coal.Transform3s(), coal.Transform3s(point)
    solid, target = coal.Cylinder(radius, _LENGTH_M), coal.Sphere(0.0)
    return float(coal.distance(solid, here, target, there, coal.DistanceRequest(), result))

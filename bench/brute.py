"""An oracle of its own for ``lower_bound``: a random search over balls, and where Coal says they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ssm_service.config.schema import AssumptionsConfig
from ssm_service.model import Robot, SensorArray
from ssm_service.model.hulls import triangles
from ssm_service.perception import sphere_readings

SAMPLES = 120_000
NEAR, STARTS, KEPT, TRIES, ROUNDS = 1_000, 10_000, 12, 40, 220
PENALTY = 50.0  # [m] of distance for each metre by which a ball fails to explain the readings

Array = NDArray[np.float64]


class MeshTruth:
    """Distances of points from a link's mesh: exactly by Coal, and fast to some µm from dense samples.

    Args:
        robot: The robot.
        link: A link with one mesh, in whose frame the points are.
    """

    def __init__(self, robot: Robot, link: str) -> None:
        (index,) = robot.geometry_of_link[link]
        source = robot.collision.geometryObjects[index]
        self._mesh = source.geometry
        self._placement = coal.Transform3s(source.placement.rotation, source.placement.translation)
        vertices, faces = triangles(self._mesh)
        vertices = vertices @ source.placement.rotation.T + source.placement.translation
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        rng = np.random.default_rng(0)
        chosen = rng.choice(len(faces), SAMPLES, p=areas / areas.sum())
        u, v = np.sqrt(rng.random((SAMPLES, 1))), rng.random((SAMPLES, 1))
        inner = (1.0 - u) * a[chosen] + u * (1.0 - v) * b[chosen] + u * v * c[chosen]
        self._tree = cKDTree(np.concatenate([vertices, inner]), leafsize=32)
        self.lower, self.upper = vertices.min(axis=0), vertices.max(axis=0)

    def exact(self, points: Array) -> Array:
        """Return Coal's distances of points, (n, 3), from the triangles, (n,) [m]."""
        probe, request, result = coal.Sphere(1e-9), coal.DistanceRequest(), coal.DistanceResult()
        here, distances = coal.Transform3s(), np.empty(len(points))
        for i, point in enumerate(points):
            here.setTranslation(point)
            result.clear()
            distances[i] = coal.distance(self._mesh, self._placement, probe, here, request, result) + 1e-9
        return distances

    def fast(self, points: Array) -> Array:
        """Return distances from the samples: too large by some µm, (n,) [m]."""
        found: Array = self._tree.query(points)[0]
        return found


def predicted(array: SensorArray, centres: Array, radii: Array) -> Array:
    """Return the ideal readings of balls, (n, k) [m], whatever their range."""
    result = np.empty((len(centres), len(array.half_angles)))
    for i, T_link_sensor in enumerate(array.transforms_sensor_to_link):
        local = (centres - T_link_sensor[:3, 3]) @ T_link_sensor[:3, :3]
        result[:, i] = sphere_readings(local, radii, float(array.half_angles[i]))
    return result


def disagreement(array: SensorArray, ideal: Array, readings: Array, error: float) -> Array:
    """Return by how much ideal readings, (n, k), fail to agree with ``readings``, (k,): (n,) [m]."""
    seen = np.where(np.isinf(ideal), 9.0, np.maximum(ideal, array.ranges_min))
    echo = np.isfinite(readings)
    off = np.abs(seen - np.where(echo, readings, 0.0)) - error
    near = np.where(seen < array.ranges_max - error, array.ranges_max - error - seen, 0.0)
    worst: Array = np.maximum(np.where(echo, off, near), 0.0).max(axis=1)
    return worst


@dataclass(frozen=True, kw_only=True, eq=False)
class Least:
    """The nearest ball found: its distance from the link by Coal [m] (inf: none), centre and radius."""

    distance: float
    centre: Array
    radius: float


def least_ball(
    truth: MeshTruth,
    array: SensorArray,
    assumptions: AssumptionsConfig,
    readings: Array,
    rng: np.random.Generator,
    hints: tuple[Array, Array],
) -> Least:
    """Search for the nearest ball to the link that explains one scan with an echo, of ``one`` obstacle.

    Many starts within reach of the nearest echo and the hints; the best and some others walk by random steps
    whose size adapts, at a price for each disagreement. What is returned agrees to 1e-9 m.

    Args:
        truth: Of the array's link.
        array: The sensors.
        assumptions: What balls are admissible.
        readings: (k,) [m].
        rng: Source of randomness.
        hints: Centres, (n, 3) [m], and radii, (n,) [m], of balls to start from too.
    """
    least, most, error = assumptions.radius_min_m, assumptions.radius_max_m, assumptions.reading_error_m
    sensor = int(np.argmin(readings))
    T_link_sensor = array.transforms_sensor_to_link[sensor]
    far = readings[sensor] + error
    width = far * math.tan(array.half_angles[sensor]) + most
    turn, off = rng.uniform(0.0, 2.0 * math.pi, STARTS), width * np.sqrt(rng.random(STARTS))
    local = [rng.uniform(-0.5 * most, far + most, STARTS), off * np.cos(turn), off * np.sin(turn)]
    centres = np.column_stack(local) @ T_link_sensor[:3, :3].T + T_link_sensor[:3, 3]
    # Hints may only just miss the edge of a cone: balls round them, ever nearer, do not.
    scale = 10.0 ** -rng.uniform(2.0, 6.0, (NEAR, len(hints[0]), 1))
    near = (hints[0] + scale * rng.normal(size=(NEAR, *hints[0].shape))).reshape(-1, 3)
    sizes = (hints[1] + scale[..., 0] * rng.normal(size=(NEAR, len(hints[1])))).ravel()
    centres = np.concatenate([hints[0], near, centres])
    radii = np.concatenate([hints[1], sizes, rng.uniform(least, most, STARTS)])
    radii = np.clip(radii, least, most)

    def price(where: Array, size: Array) -> tuple[Array, Array, Array]:
        distance = truth.fast(where)
        wrong = disagreement(array, predicted(array, where, size), readings, error)
        wrong = wrong + np.maximum(size - distance, 0.0)
        gap = np.maximum(distance - size, 0.0)
        return gap + PENALTY * wrong, gap, wrong

    cost = price(centres, radii)[0]
    order = np.argsort(cost)
    few = len(hints[0])
    chosen = np.concatenate([np.arange(few), order[: KEPT // 2], rng.choice(order[:3000], KEPT // 2)])
    centres, radii, cost = centres[chosen], radii[chosen], cost[chosen]
    rows, step = np.arange(len(chosen)), np.full(len(chosen), 0.02)
    best = (math.inf, np.full(3, np.nan), math.nan)
    for _ in range(ROUNDS):
        moves = rng.normal(size=(len(rows), TRIES, 4)) * step[:, None, None]
        tried = (centres[:, None] + moves[..., :3]).reshape(-1, 3)
        sizes = np.clip((radii[:, None] + 0.5 * moves[..., 3]).ravel(), least, most)
        prices, gaps, wrongs = price(tried, sizes)
        gaps = np.where(wrongs <= 1e-9, gaps, np.inf)
        if gaps.min() < best[0]:
            i = int(gaps.argmin())
            best = (float(gaps[i]), tried[i].copy(), float(sizes[i]))
        table = prices.reshape(len(rows), TRIES)
        pick = table.argmin(axis=1)
        better = table[rows, pick] < cost
        place = (rows * TRIES + pick)[better]
        centres[better], radii[better], cost[better] = tried[place], sizes[place], prices[place]
        step = np.clip(np.where(better, 1.3 * step, 0.6 * step), 1e-6, 0.03)
    if best[0] == math.inf:
        return Least(distance=math.inf, centre=best[1], radius=best[2])
    distance = max(0.0, float(truth.exact(best[1][np.newaxis])[0]) - best[2])
    return Least(distance=distance, centre=best[1], radius=best[2])

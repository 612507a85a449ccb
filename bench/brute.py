"""An oracle of its own for ``lower_bound``: a random search over balls, and where Coal says they are.

It shares nothing with the package's search but the closed form of a reading: other distances from the link
(Coal's, and samples of its mesh), other code for the cones, no bounds, no boxes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ssm_service.config import AssumptionsConfig
from ssm_service.model import Robot, SensorArray
from ssm_service.model.hulls import triangles
from ssm_service.perception import sphere_readings

SAMPLES = 60_000
STARTS, NEAR, ASKED = 30_000, 300, 5_000
WALKERS, TRIES, ROUNDS, AGAIN = 32, 12, 30, 3
PENALTY = 20.0  # [m] of distance for each metre by which a ball fails to explain the readings
ROOM = 2e-9  # [m]; so that rounding does not decide whether a ball grazes a cone

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
        return np.asarray(self._tree.query(points)[0])


def predicted(array: SensorArray, centres: Array, radii: Array) -> Array:
    """Return the ideal readings of balls, (n, k) [m], whatever their range."""
    result = np.empty((len(centres), len(array.half_angles)))
    for i, T_link_sensor in enumerate(array.transforms_sensor_to_link):
        local = (centres - T_link_sensor[:3, 3]) @ T_link_sensor[:3, :3]
        result[:, i] = sphere_readings(local, radii, float(array.half_angles[i]))
    return result


def disagreement(
    array: SensorArray, ideal: Array, readings: Array, error: float, many: bool = False
) -> Array:
    """Return by how much ideal readings, (n, k), fail to agree with ``readings``, (k,): (n,) [m].

    With ``many`` balls each echo may be another's, who must only not have been heard before this one.
    """
    seen = np.where(np.isinf(ideal), 9.0, np.maximum(ideal, array.ranges_min))
    echo = np.isfinite(readings)
    late = np.where(echo, readings, 0.0) - seen
    off = (late if many else np.abs(late)) - error
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
    """Search for the nearest ball that explains one scan; with ``many``, that stands unseen beside others.

    For each centre the greatest radius that the cones and the link leave is the best. Centres are drawn
    densely round the hints and within reach of the nearest echo (with ``many``, no farther from the link than
    a hint). The best of them, and others at random, walk by random steps whose size adapts, at a price for
    each disagreement; all start again from the best few. What is returned agrees with the readings by their
    closed form, to 1e-9 m.

    Args:
        truth: Of the array's link.
        array: The sensors.
        assumptions: What balls are admissible.
        readings: (k,) [m]; with ``one`` obstacle, some echo.
        rng: Source of randomness.
        hints: Centres, (n, 3) [m], and radii, (n,) [m], of balls that may be near.
    """
    look = _Balls(truth, array, assumptions, readings)
    near = hints[0] + 10.0 ** -rng.uniform(1.5, 6.0, (NEAR, len(hints[0]), 1)) * rng.normal(
        size=(NEAR, *hints[0].shape)
    )
    few = np.concatenate([hints[0], near.reshape(-1, 3)])
    if assumptions.obstacles == "many":
        reach = float(truth.exact(hints[0]).min()) + assumptions.radius_max_m
        starts = rng.uniform(truth.lower - reach, truth.upper + reach, (STARTS, 3))
    else:
        starts = _starts(array, assumptions, readings, rng)
    starts = np.concatenate([few, starts])
    wrong = look.cones(starts)[1]
    likely = np.argsort(wrong, kind="stable")
    admissible = int((wrong <= 0.0).sum())
    if admissible > ASKED:
        likely = np.concatenate([np.arange(len(few)), rng.choice(likely[:admissible], ASKED, replace=False)])
    asked = starts[likely[:ASKED]]
    cost = look.costs(asked)
    order = np.argsort(cost)
    chosen = np.concatenate([order[: WALKERS // 2], rng.choice(order[: ASKED // 2], WALKERS // 2)])
    centres, cost = asked[chosen], cost[chosen]
    for turn in range(AGAIN):
        step = np.full(len(centres), 0.02 * 0.2**turn)
        for _ in range(ROUNDS):
            moves = rng.normal(size=(len(centres), TRIES, 3)) * step[:, None, None]
            tried = centres[:, None] + moves
            costs = look.costs(tried.reshape(-1, 3)).reshape(len(centres), TRIES)
            pick = costs.argmin(axis=1)
            rows = np.arange(len(centres))
            better = costs[rows, pick] < cost
            centres = np.where(better[:, None], tried[rows, pick], centres)
            cost = np.where(better, costs[rows, pick], cost)
            step = np.clip(np.where(better, 1.4 * step, 0.6 * step), 1e-6, 0.03)
        best = np.argsort(cost)[: WALKERS // 4].repeat(2)
        centres, cost = centres[best], cost[best]
    return look.best


class _Balls:
    """The balls that explain one scan, and the nearest of all that were looked at."""

    def __init__(
        self, truth: MeshTruth, array: SensorArray, assumptions: AssumptionsConfig, readings: Array
    ) -> None:
        self._truth, self._array, self._readings = truth, array, readings
        self._least, self._most = assumptions.radius_min_m, assumptions.radius_max_m
        self._error = assumptions.reading_error_m
        self._many = assumptions.obstacles == "many"
        echo = np.isfinite(readings)
        low = np.where(echo, readings, array.ranges_max) - self._error
        self._low = np.where(low <= array.ranges_min, -1.0, low)
        self._high = np.where(
            echo & (not self._many), np.maximum(readings + self._error, array.ranges_min), math.inf
        )
        self.best = Least(distance=math.inf, centre=np.full(3, math.nan), radius=math.nan)

    def cones(self, centres: Array) -> tuple[Array, Array]:
        """Return the greatest radius that the cones leave, (n,) [m], and how much is amiss with it, (n,) [m].

        A ball's reading is at most L where it meets the part of the cone within L of the apex.
        """
        most, least = np.full(len(centres), self._most), np.full(len(centres), self._least)
        for i, T_link_sensor in enumerate(self._array.transforms_sensor_to_link):
            local = (centres - T_link_sensor[:3, 3]) @ T_link_sensor[:3, :3]
            plane = local[:, 0], np.hypot(local[:, 1], local[:, 2])
            angle = float(self._array.half_angles[i])
            if self._low[i] > 0.0:
                most = np.minimum(most, _from_cone(*plane, angle, self._low[i]) - ROOM)
            if self._high[i] < math.inf:
                least = np.maximum(least, _from_cone(*plane, angle, self._high[i]) + ROOM)
        return most, np.maximum(least - most, 0.0)

    def costs(self, centres: Array) -> Array:
        """Return distances of the best balls round ``centres`` from the link, and a price for what is amiss.

        The nearest one that is right, by Coal and the closed form, is kept as ``best``.
        """
        most, wrong = self.cones(centres)
        distance = self._truth.fast(centres)
        needed = most + wrong
        radius = np.minimum(most, distance)
        wrong = np.maximum(needed - radius, 0.0)
        gaps = distance - radius
        costs: Array = gaps + PENALTY * wrong
        right = np.where(wrong <= 0.0, gaps, math.inf)
        i = int(right.argmin())
        if right[i] < self.best.distance - 1e-7:
            self._keep(centres[i], float(most[i]))
        return costs

    def _keep(self, centre: Array, radius: float) -> None:
        distance = float(self._truth.exact(centre[np.newaxis])[0])
        radius = min(radius, distance)
        ideal = predicted(self._array, centre[np.newaxis], np.array([radius]))
        wrong = disagreement(self._array, ideal, self._readings, self._error, self._many)[0]
        if radius < self._least or wrong > 1e-9:
            return
        if distance - radius < self.best.distance:
            self.best = Least(distance=distance - radius, centre=centre.copy(), radius=radius)


def _from_cone(along: Array, off: Array, angle: float, length: float) -> Array:
    """Return distances, (n,) [m], from the part of a cone within ``length`` of its apex."""
    cos, sin = math.cos(angle), math.sin(angle)
    on_edge = np.clip(along * cos + off * sin, 0.0, length)
    beside = np.hypot(along - on_edge * cos, off - on_edge * sin)
    inside = off * cos <= along * sin
    return np.where(inside, np.maximum(np.hypot(along, off) - length, 0.0), beside)


def _starts(
    array: SensorArray, assumptions: AssumptionsConfig, readings: Array, rng: np.random.Generator
) -> Array:
    """Return centres, (n, 3) [m], all over the places from which a ball can give the nearest echo."""
    most = assumptions.radius_max_m
    sensor = int(np.argmin(readings))
    T_link_sensor = array.transforms_sensor_to_link[sensor]
    far = max(float(readings[sensor]) + assumptions.reading_error_m, float(array.ranges_min[sensor]))
    width = far * math.tan(array.half_angles[sensor]) + most
    turn, off = rng.uniform(0.0, 2.0 * math.pi, STARTS), width * np.sqrt(rng.random(STARTS))
    local = [rng.uniform(-most, far + most, STARTS), off * np.cos(turn), off * np.sin(turn)]
    centres: Array = np.column_stack(local) @ T_link_sensor[:3, :3].T + T_link_sensor[:3, 3]
    return centres

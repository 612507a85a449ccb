"""A mesh's triangles against a convex solid whose distance has a closed form: exact, and in few steps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import coal
import numpy as np
from numpy.typing import NDArray

from .hulls import triangles
from .scene import Slot

_CLUSTER: Final = 32  # triangles; fewer make tighter bounds, and more of them
_LONGEST: Final = 0.25  # of the mesh's size; longer triangles are cut, or their bounds say little
_FIRST: Final = 8  # clusters looked into at first; four times as many in each further round
_TIGHT_M: Final = 5e-7  # [m]; what could be nearer by less than this is not looked for
_TOUCH_M: Final = 1e-9  # [m]; what may be nearer than this is always looked at: it may touch
_GJK_TOLERANCE: Final = 1e-8  # [m]; its default lets single triangles be off by 1.8 µm
_WRONG_M: Final = 1e-6  # [m]; a distance this far outside its bounds is a solver's failure
_TINY: Final = 1e-30

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Separation:
    """Where a mesh and a solid are nearest to each other.

    Attributes:
        distance: [m]; 0 where they touch, and where a solver failed.
        mesh_point: (3,) base frame [m].
        solid_point: (3,) base frame [m].
    """

    distance: float
    mesh_point: Array
    solid_point: Array


_TOUCHING: Final = Separation(distance=0.0, mesh_point=np.zeros(3), solid_point=np.zeros(3))


class Surface:
    """The triangles of a mesh in clusters of near ones, all in the mesh's frame [m].

    Coordinates come first in each array: numpy is slow where the last axis is short.

    Attributes:
        middles: (3, k) centres of the boxes round the clusters.
        halves: (3, k) half edges of these boxes, along the axes of the mesh's frame.
        centroids: (3, k, w) of the triangles; a short cluster repeats some.
        offsets: (3, 3, k, w) from the centroid, the first axis for the three corners.
    """

    def __init__(self, mesh: Any) -> None:
        vertices, faces = triangles(mesh)
        corners = _short(vertices[faces], _LONGEST * float(np.ptp(vertices, axis=0).max()))
        index = _clusters(corners.mean(axis=1))
        corners = corners[index]
        lower, upper = corners.min(axis=(1, 2)), corners.max(axis=(1, 2))
        centroids = corners.mean(axis=2)
        offsets = corners - centroids[:, :, np.newaxis]
        self.middles = np.ascontiguousarray((lower + upper).T / 2.0)
        self.halves = np.ascontiguousarray((upper - lower).T / 2.0)
        self.centroids = np.ascontiguousarray(centroids.transpose(2, 0, 1))
        self.offsets = np.ascontiguousarray(offsets.transpose(2, 3, 0, 1))
        for array in (self.middles, self.halves, self.centroids, self.offsets):
            array.flags.writeable = False


class SurfaceDistance:
    """Distance of surfaces to a box or a cylinder.

    The distance d of a point to a convex solid is convex, with a unit gradient g outside the solid. So on a
    triangle, as in a box, ``d(x) + min over the corners v of g(x)·(v - x)`` is a lower bound for any x. At
    the centroid it is off by the second order of the triangle's size only. All clusters are bounded at once,
    then the triangles of the nearest ones, and what the best distance leaves is measured by GJK, one triangle
    after the other in rising order. Each better distance also has a plane between triangle and solid: what
    lies behind it, mostly all the rest, is not nearer.
    """

    def __init__(self) -> None:
        corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        corners.extend(list(np.eye(3)))
        faces.extend([coal.Triangle(0, 1, 2), coal.Triangle(0, 2, 1)])
        self._triangle = coal.Convex(corners, faces)
        self._corners = self._triangle.points()  # not a copy: writing here moves the triangle
        self._identity = coal.Transform3s()
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._request.gjk_tolerance = _GJK_TOLERANCE

    def measure(
        self, surface: Surface, transform_mesh: Any, slot: Slot, limit: float = math.inf
    ) -> Separation | None:
        """Measure a surface against a slot's box or cylinder.

        Args:
            surface: The mesh.
            transform_mesh: Coal's pose, mesh to base.
            slot: The obstacle.
            limit: Only distances below this are of interest [m], above 0.

        Returns:
            The separation, exact to 1 µm, or None where it is not below ``limit``. Touching has no points.
        """
        R_base_solid, t_base_solid = slot.transform_core.getRotation(), slot.transform_core.getTranslation()
        R = R_base_solid.T @ transform_mesh.getRotation()
        t = (R_base_solid.T @ (transform_mesh.getTranslation() - t_base_solid))[:, np.newaxis]
        solid = Solid(slot.shape, slot.size)
        distances, slopes = solid.slope(R @ surface.middles + t)
        bounds = distances - np.einsum("ij,ij->j", np.abs(R.T @ slopes), surface.halves)
        if not math.isfinite(bounds.sum()):
            return _TOUCHING
        best = _Best(limit)
        rest = bounds.argsort()
        size = _FIRST if bounds[rest[0]] > 0.0 else 1  # where they touch, one cluster is likely to tell
        rest = rest[: bounds[rest].searchsorted(best.threshold)]
        while len(rest):
            if not self._look_into(surface, rest[:size], R, t, slot.solid, solid, best):
                return _TOUCHING
            rest = rest[size:]
            rest = rest[bounds[rest] < best.threshold]
            if best.point is not None and len(rest):
                normal = R.T @ best.normal
                apart = normal @ surface.middles[:, rest] - np.abs(normal) @ surface.halves[:, rest]
                rest = rest[~(apart + (best.normal @ t - best.support) >= best.threshold)]
            size *= 4
        if best.point is None:
            return None
        on_solid = solid.nearest(best.point[:, np.newaxis])[:, 0]
        distance = math.dist(best.point, on_solid)
        if not 0.0 < distance <= best.distance + _WRONG_M:  # GJK claimed less than its own point says
            return _TOUCHING
        return Separation(
            distance=distance,
            mesh_point=R_base_solid @ best.point + t_base_solid,
            solid_point=R_base_solid @ on_solid + t_base_solid,
        )

    def _look_into(
        self,
        surface: Surface,
        clusters: NDArray[np.intp],
        R: Array,
        t: Array,
        shape: Any,
        solid: Solid,
        best: _Best,
    ) -> bool:
        """Better ``best``, in the solid's frame, by some clusters; False where a triangle touches."""
        centroids = surface.centroids[:, clusters].reshape(3, -1)
        offsets = surface.offsets[:, :, clusters].reshape(3, 3, -1)
        distances, slopes = solid.slope(R @ centroids + t)
        bounds = distances + np.einsum("kij,ij->kj", offsets, R.T @ slopes).min(axis=0)
        near = np.flatnonzero(bounds < best.threshold)
        near = near[bounds[near].argsort()]
        corners = (R @ (centroids[:, near] + offsets[:, :, near]) + t).transpose(2, 0, 1)
        lower, upper = bounds[near], distances[near]
        k = 0
        while k < len(lower) and lower[k] < best.threshold:
            distance = self._triangle_distance(corners[k], shape)
            if not 0.0 < distance <= upper[k] + _WRONG_M:
                return False  # touching, or a failure, which is never far
            k += 1
            if distance < best.distance:
                best.set(distance, self._result.getNearestPoint1(), self._result.getNearestPoint2(), solid)
                apart = (corners[k:] @ best.normal).min(axis=1) - best.support
                kept = ~(apart >= best.threshold)  # also where GJK left no points
                corners, lower, upper, k = corners[k:][kept], lower[k:][kept], upper[k:][kept], 0
        return True

    def _triangle_distance(self, corners: Array, shape: Any) -> float:
        self._corners[:] = corners
        self._result.clear()
        return float(
            coal.distance(self._triangle, self._identity, shape, self._identity, self._request, self._result)
        )


class _Best:
    """The best distance so far, in the solid's frame, and a plane before which all that is nearer must lie.

    Attributes:
        distance: [m]; what is to be beaten.
        threshold: [m]; from this bound on nothing is of interest any more.
        point: (3,) on the mesh [m]; None where the limit has not been beaten yet.
        normal: (3,) unit, from the solid to the point.
        support: The most that ``normal @ x`` is for a point x of the solid [m].
    """

    __slots__ = ("distance", "normal", "point", "support", "threshold")

    def __init__(self, limit: float) -> None:
        self.distance = self.threshold = limit
        self.point: Array | None = None
        self.normal = np.zeros(3)
        self.support = 0.0

    def set(self, distance: float, point: Array, on_solid: Array, solid: Solid) -> None:
        """Take a better distance."""
        self.distance = distance
        self.threshold = max(distance - _TIGHT_M, _TOUCH_M)
        self.point = point
        delta = point - on_solid
        self.normal = delta / max(math.sqrt(delta @ delta), _TINY)
        self.support = solid.support(self.normal)


class Solid:
    """The closed form of the distance to a box or a cylinder in its own frame."""

    def __init__(self, shape: str, size: tuple[float, ...]) -> None:
        """Take shape and size as ``Obstacle`` has them."""
        self._half: Array | None = None
        if shape == "box":
            self._half = 0.5 * np.array(size)[:, np.newaxis]
            self._minus_half = -self._half
        else:
            self._radius, self._half_length = size[0], 0.5 * size[1]

    def nearest(self, points: Array) -> Array:
        """Return the points of the solid, (3, n) [m], nearest to ``points``, (3, n) [m]."""
        if self._half is not None:
            return np.minimum(np.maximum(points, self._minus_half), self._half)
        x, y, z = points
        nearest = np.empty_like(points)
        scale = self._radius / np.maximum(np.sqrt(x * x + y * y), self._radius)
        np.multiply(points[:2], scale, out=nearest[:2])
        np.minimum(np.maximum(z, -self._half_length), self._half_length, out=nearest[2])
        return nearest

    def slope(self, points: Array) -> tuple[Array, Array]:
        """Return distances, (n,) [m], and their gradients, (3, n), 0 inside, at ``points``, (3, n) [m]."""
        apart = points - self.nearest(points)
        distances = np.sqrt(np.einsum("ij,ij->j", apart, apart))
        apart /= np.maximum(distances, _TINY)
        return distances, apart

    def support(self, direction: Array) -> float:
        """Return the most that ``direction @ x``, (3,), is for a point x of the solid [m]."""
        if self._half is not None:
            return float(np.abs(direction) @ self._half[:, 0])
        x, y, z = direction.tolist()
        return float(self._radius * math.hypot(x, y) + self._half_length * abs(z))


def _short(corners: Array, longest: float) -> Array:
    """Halve triangles, (n, 3, 3) [m], across their longest edge until none is longer than ``longest`` [m]."""
    done = []
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        long = edges.max(axis=1) > longest
        done.append(corners[~long])
        corners, first = corners[long], edges[long].argmax(axis=1)
        row = np.arange(len(corners))
        a, b, c = (corners[row, (first + k) % 3] for k in range(3))
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def _clusters(points: Array) -> NDArray[np.intp]:
    """Halve points, (n, 3), across their longest side until clusters are small; return indices, (k, w)."""
    groups = [np.arange(len(points))]
    while max(map(len, groups)) > _CLUSTER:
        halves = []
        for group in groups:
            axis = int(np.argmax(np.ptp(points[group], axis=0)))
            halves += np.array_split(group[points[group, axis].argsort(kind="stable")], 2)
        groups = halves
    width = max(map(len, groups))
    return np.array([np.resize(group, width) for group in groups])

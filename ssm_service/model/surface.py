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
    """Distance of surfaces to a box, a cylinder or the segment of a capsule.

    The distance d of a point to a convex solid is convex, with a unit gradient g outside the solid. So on a
    triangle, as in a box, ``d(x) + min over the corners v of g(x)·(v - x)`` is a lower bound for any x. At
    the centroid it is off by the second order of the triangle's size only. All clusters are bounded at once,
    then the triangles of the nearest ones, and the few that the best distance leaves are measured by GJK.
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
        """Measure a surface against a slot's core, a box, a cylinder or a segment.

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
        solid = _Solid(slot)
        distances, slopes = solid.slope(R @ surface.middles + t)
        bounds = distances - np.einsum("ij,ij->j", np.abs(R.T @ slopes), surface.halves)
        if not math.isfinite(bounds.sum()):
            return _TOUCHING
        order = bounds.argsort()
        bounds = bounds[order]
        best, point, start, size = limit, None, 0, _FIRST
        while (stop := min(start + size, int(bounds.searchsorted(_threshold(best, limit))))) > start:
            distance, nearest = self._nearest(surface, order[start:stop], R, t, slot, solid, best, limit)
            if not distance > 0.0:
                return _TOUCHING
            if nearest is not None:
                best, point = distance, nearest
            start, size = stop, size * 4
        if point is None:
            return None
        on_solid = solid.nearest(point[:, np.newaxis])[:, 0]
        distance = math.dist(point, on_solid)
        if not 0.0 < distance <= best + _WRONG_M:
            return _TOUCHING
        return Separation(
            distance=distance,
            mesh_point=R_base_solid @ point + t_base_solid,
            solid_point=R_base_solid @ on_solid + t_base_solid,
        )

    def _nearest(
        self,
        surface: Surface,
        clusters: NDArray[np.intp],
        R: Array,
        t: Array,
        slot: Slot,
        solid: _Solid,
        best: float,
        limit: float,
    ) -> tuple[float, Array | None]:
        """Return the least distance in some clusters and its point on the mesh, in the solid's frame.

        ``best`` and None where that is not beaten; 0 at the first triangle that touches.
        """
        centroids = surface.centroids[:, clusters].reshape(3, -1)
        offsets = surface.offsets[:, :, clusters].reshape(3, 3, -1)
        distances, slopes = solid.slope(R @ centroids + t)
        bounds = distances + np.einsum("kij,ij->kj", offsets, R.T @ slopes).min(axis=0)
        near = np.flatnonzero(bounds < _threshold(best, limit))
        near = near[bounds[near].argsort()]
        corners = (R @ (centroids[:, near] + offsets[:, :, near]) + t).transpose(2, 0, 1)
        point: Array | None = None
        for k, (index, bound) in enumerate(zip(near.tolist(), bounds[near].tolist(), strict=True)):
            if bound >= _threshold(best, limit):
                break
            distance = self._triangle_distance(corners[k], slot)
            if not bound - _WRONG_M <= distance <= distances[index] + _WRONG_M:
                return 0.0, None  # touching, or a failure, which is never far
            if not distance > 0.0:
                return 0.0, None
            if distance < best:
                best, point = distance, self._result.getNearestPoint1()
        return best, point

    def _triangle_distance(self, corners: Array, slot: Slot) -> float:
        self._corners[:] = corners
        self._result.clear()
        return float(
            coal.distance(
                self._triangle, self._identity, slot.core, self._identity, self._request, self._result
            )
        )


class _Solid:
    """The closed form of the distance to a slot's core, in the core's own frame."""

    def __init__(self, slot: Slot) -> None:
        self._half: Array | None = None
        if slot.shape == "box":
            self._half = 0.5 * np.array(slot.size)[:, np.newaxis]
            self._minus_half = -self._half
        else:
            self._radius = slot.size[0] if slot.shape == "cylinder" else 0.0
            self._half_length = 0.5 * slot.size[1]

    def nearest(self, points: Array) -> Array:
        """Return the points of the solid, (3, n) [m], nearest to ``points``, (3, n) [m]."""
        if self._half is not None:
            return np.minimum(np.maximum(points, self._minus_half), self._half)
        x, y, z = points
        nearest = np.empty_like(points)
        scale = self._radius / np.maximum(np.sqrt(x * x + y * y), max(self._radius, _TINY))
        np.multiply(points[:2], scale, out=nearest[:2])
        np.minimum(np.maximum(z, -self._half_length), self._half_length, out=nearest[2])
        return nearest

    def slope(self, points: Array) -> tuple[Array, Array]:
        """Return distances, (n,) [m], and their gradients, (3, n), 0 inside, at ``points``, (3, n) [m]."""
        apart = points - self.nearest(points)
        distances = np.sqrt(np.einsum("ij,ij->j", apart, apart))
        apart /= np.maximum(distances, _TINY)
        return distances, apart


def _threshold(best: float, limit: float) -> float:
    """Return the bound [m] from which on nothing is of interest any more."""
    return max(best - _TIGHT_M, _TOUCH_M) if best < limit else limit


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

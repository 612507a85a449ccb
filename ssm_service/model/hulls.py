"""Convex pieces round the links' geometry: fast, properly signed, and never farther than the mesh itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import coal
import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from .robot import Robot

_FLAT: Final = 1e-5  # [m]; thinner point sets have no proper hull and are thickened by this


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """One collision geometry of a monitored link.

    Attributes:
        link: The link's name.
        link_index: Its index in ``Robot.monitored_links``.
        source: Pinocchio's geometry object: shape, placement and parent.
        is_mesh: Whether the exact distance needs the triangles; else ``pieces`` is the exact shape.
        pieces: Convex shapes in the frame of the geometry, whose union holds it.
        first: Index of the first piece among the pieces of all parts.
    """

    link: str
    link_index: int
    source: Any
    is_mesh: bool
    pieces: tuple[Any, ...]
    first: int

    @property
    def last(self) -> int:
        """Index behind the last piece among the pieces of all parts."""
        return self.first + len(self.pieces)


@lru_cache(maxsize=8)
def build_parts(robot: Robot) -> tuple[Part, ...]:
    """Return the parts of all monitored links, in their order; they are built once for each robot.

    Raises:
        ConfigError: A mesh has no usable convex hull.
    """
    parts: list[Part] = []
    first = 0
    for link_index, link in enumerate(robot.monitored_links):
        count = robot.config.file.hull_pieces.get(link, 1)
        for index in robot.geometry_of_link[link]:
            source = robot.collision.geometryObjects[index]
            is_mesh = isinstance(source.geometry, coal.BVHModelBase)
            try:
                pieces = _pieces(source.geometry, count) if is_mesh else (source.geometry,)
            except (RuntimeError, ValueError) as error:
                found = f"{source.meshPath}: {error}"
                raise ConfigError(
                    robot.config.path, f"hull_pieces.{link}", found, "a mesh of finite size"
                ) from error
            for piece in pieces:
                piece.computeLocalAABB()
            parts.append(
                Part(
                    link=link,
                    link_index=link_index,
                    source=source,
                    is_mesh=is_mesh,
                    pieces=pieces,
                    first=first,
                )
            )
            first += len(pieces)
    return tuple(parts)


def triangles(mesh: Any) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return a Coal mesh as vertices, (n, 3) [m] in the mesh's frame, and vertex indices, (m, 3)."""
    vertices = np.array(mesh.vertices(), dtype=np.float64)
    faces = [mesh.tri_indices(i) for i in range(mesh.num_tris)]
    return vertices, np.array([(face[0], face[1], face[2]) for face in faces], dtype=np.intp)


def slab_points(
    vertices: NDArray[np.float64], faces: NDArray[np.intp], count: int
) -> list[NDArray[np.float64]]:
    """Cut a mesh into slabs of equal width across its longest axis.

    A point of the mesh lies in the slab's convex hull, as the corners of each clipped triangle are among
    the slab's points: its vertices in the slab, and where its edges cross the two planes.

    Returns:
        For each slab that is not empty, its points, (k, 3) [m].
    """
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    axis = int(np.argmax(upper - lower))
    planes = np.linspace(lower[axis], upper[axis], count + 1)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    crossings = [_crossings(vertices, edges, axis, plane) for plane in planes]
    used = vertices[np.unique(faces)]
    slabs = []
    for i in range(count):
        inside = (used[:, axis] >= planes[i]) & (used[:, axis] <= planes[i + 1])
        points = np.concatenate([used[inside], crossings[i], crossings[i + 1]])
        if len(points):
            slabs.append(points)
    return slabs


def convex_hull(points: NDArray[np.float64]) -> Any:
    """Return Coal's convex hull of ``points``, (n, 3) [m]; flat sets are thickened by 10 µm.

    Raises:
        ValueError: A point is not finite.
        RuntimeError: Qhull found no hull.
    """
    if not np.isfinite(points).all():
        raise ValueError("a vertex is not finite")
    centred = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=len(points) < 3)
    for axis in axes:
        if np.ptp(centred @ axis) < _FLAT:  # Qhull inside Coal would crash on it
            points = np.concatenate([points - _FLAT * axis, points + _FLAT * axis])
    corners = coal.StdVec_Vec3s()
    corners.extend(list(points))
    return coal.Convex.convexHull(corners, True, "Qt")


def _pieces(mesh: Any, count: int) -> tuple[Any, ...]:
    vertices, faces = triangles(mesh)
    if not np.isfinite(vertices).all():
        raise ValueError("a vertex is not finite")
    return tuple(convex_hull(points) for points in slab_points(vertices, faces, count))


def _crossings(
    vertices: NDArray[np.float64], edges: NDArray[np.intp], axis: int, plane: float
) -> NDArray[np.float64]:
    a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
    crossing = (a[:, axis] - plane) * (b[:, axis] - plane) < 0.0
    a, b = a[crossing], b[crossing]
    t = (plane - a[:, axis]) / (b[:, axis] - a[:, axis])
    return np.asarray(a + t[:, None] * (b - a))

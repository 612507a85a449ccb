"""Squared distances of points from one link's collision geometry, from below: what tables are made of."""

from __future__ import annotations

import hashlib
import math
from typing import Any, Final

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..errors import ConfigError
from .hulls import triangles
from .robot import Robot

_LEAF: Final = 32  # samples; the default of 10 takes half as long again
_TINY: Final = 1e-30

Array = NDArray[np.float64]


class LinkGeometry:
    """The collision geometry of one link in the link's frame: meshes and URDF's primitive shapes.

    Meshes are sampled. Their triangles are cut until no edge is longer than √3·ϱ, and all corners are taken.
    Let p be the mesh's nearest point to c, at distance D, in the piece T. Inside T or inside one of its
    edges, c − p is square to the face or the edge that p lies in, so a corner v of that face or edge has
    |c − v|² = D² + |p − v|², and one of them has |p − v| ≤ ϱ: no point of a triangle is farther than
    1/√3 of the longest edge from all corners. Hence the distance D_s from the samples satisfies
    D_s² − ϱ² ≤ D² ≤ D_s²: the error is of second order in ϱ.

    Attributes:
        lower: (3,) least corner of the box round the geometry [m], link frame.
        upper: (3,) greatest corner [m].
    """

    def __init__(self, robot: Robot, link: str) -> None:
        """Gather the geometry.

        Raises:
            ConfigError: A shape is none that URDF knows, or a mesh is not finite.
        """
        self._meshes: list[Array] = []
        self._primitives: list[tuple[Any, Array]] = []
        self._kept: tuple[float, list[tuple[Array, Any]]] | None = None
        corners = []
        to_joint = robot.model.frames[robot.model.getFrameId(link, pin.FrameType.BODY)].placement
        for index in robot.geometry_of_link[link]:
            source = robot.collision.geometryObjects[index]
            T_link_shape = (to_joint.inverse() * source.placement).homogeneous
            if isinstance(source.geometry, coal.BVHModelBase):
                vertices, faces = triangles(source.geometry)
                if not len(faces) or not np.isfinite(vertices).all():
                    raise ConfigError(robot.config.path, "urdf", source.meshPath, "a mesh of finite size")
                points = vertices[faces] @ T_link_shape[:3, :3].T + T_link_shape[:3, 3]
                self._meshes.append(points)
                corners.append(points.reshape(-1, 3))
            elif isinstance(source.geometry, coal.Box | coal.Sphere | coal.Cylinder | coal.Capsule):
                self._primitives.append((source.geometry, T_link_shape))
                corners.append(_box_corners(source.geometry, T_link_shape))
            else:
                found = f"{link} with {type(source.geometry).__name__}"
                raise ConfigError(robot.config.path, "urdf", found, "meshes, boxes, spheres, cylinders")
        every = np.concatenate(corners)
        self.lower: Array = every.min(axis=0)
        self.upper: Array = every.max(axis=0)

    def fingerprint(self) -> bytes:
        """Return a digest of all that distances depend on: links with the same one have the same shape."""
        digest = hashlib.sha256()
        for mesh in self._meshes:
            digest.update(np.ascontiguousarray(mesh).tobytes())
        for shape, T_link_shape in self._primitives:
            digest.update(f"{type(shape).__name__} {_sizes(shape)}".encode())
            digest.update(np.ascontiguousarray(T_link_shape).tobytes())
        return digest.digest()

    def nearest(self, points: Array, covering: float) -> tuple[Array, Array]:
        """Return points of the geometry near ``points``, and the squared distances from below.

        Args:
            points: (n, 3) [m], link frame.
            covering: ϱ [m].

        Returns:
            (n, 3) [m], link frame, and (n,) [m²]: at most D² and at least D² − ϱ²; 0 in primitive shapes.
        """
        near, best = np.empty_like(points), np.full(len(points), np.inf)
        for samples, tree in self._sampled(covering):
            distances, index = tree.query(points, workers=-1)
            squared = distances * distances - covering * covering
            better = squared < best
            near[better], best[better] = samples[index[better]], squared[better]
        for shape, T_link_shape in self._primitives:
            inside = _nearest_in_primitive(shape, (points - T_link_shape[:3, 3]) @ T_link_shape[:3, :3])
            placed = inside @ T_link_shape[:3, :3].T + T_link_shape[:3, 3]
            squared = np.einsum("ij,ij->i", placed - points, placed - points)
            better = squared < best
            near[better], best[better] = placed[better], squared[better]
        return near, np.maximum(best, 0.0)

    def _sampled(self, covering: float) -> list[tuple[Array, Any]]:
        """Return each mesh's samples with a tree of them; those of the last spacing asked for are kept."""
        from scipy.spatial import cKDTree  # a tenth of a second to import

        if self._kept is None or self._kept[0] != covering:
            samples = [_samples(mesh, covering) for mesh in self._meshes]
            self._kept = covering, [(some, cKDTree(some, leafsize=_LEAF)) for some in samples]
        return self._kept[1]


def _sizes(shape: Any) -> list[float]:
    if isinstance(shape, coal.Box):
        return [float(half) for half in np.asarray(shape.halfSide).ravel()]
    return [float(shape.radius), float(getattr(shape, "halfLength", 0.0))]


def _samples(corners: Array, covering: float) -> Array:
    """Return the corners of the triangles, (m, 3, 3), cut until no edge is longer than √3·covering."""
    longest = math.sqrt(3.0) * covering
    done = []
    while len(corners):
        lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        side = lengths.argmax(axis=1)
        short = lengths.max(axis=1) <= longest
        done.append(corners[short].reshape(-1, 3))
        corners, side = corners[~short], side[~short]
        rows = np.arange(len(corners))
        a, b, c = (corners[rows, (side + step) % 3] for step in range(3))
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.unique(np.concatenate(done), axis=0)


def _nearest_in_primitive(shape: Any, points: Array) -> Array:
    """Return the solid shape's nearest points in its own frame, (n, 3) [m]; inside, the points themselves."""
    if isinstance(shape, coal.Box):
        half = np.asarray(shape.halfSide).ravel()
        return np.clip(points, -half, half)
    if isinstance(shape, coal.Cylinder):
        off_axis = np.hypot(points[:, 0], points[:, 1])
        shrink = np.minimum(1.0, shape.radius / np.maximum(off_axis, _TINY))
        z = np.clip(points[:, 2], -shape.halfLength, shape.halfLength)
        return np.column_stack([points[:, 0] * shrink, points[:, 1] * shrink, z])
    core = np.zeros_like(points)
    if isinstance(shape, coal.Capsule):
        core[:, 2] = np.clip(points[:, 2], -shape.halfLength, shape.halfLength)
    length = np.linalg.norm(points - core, axis=1)
    shrink = np.minimum(1.0, shape.radius / np.maximum(length, _TINY))
    return np.asarray(core + shrink[:, np.newaxis] * (points - core))


def _box_corners(shape: Any, transform: Array) -> Array:
    if isinstance(shape, coal.Box):
        half = np.asarray(shape.halfSide).ravel()
    elif isinstance(shape, coal.Sphere):
        half = np.full(3, shape.radius)
    else:
        cap = shape.radius if isinstance(shape, coal.Capsule) else 0.0
        half = np.array([shape.radius, shape.radius, shape.halfLength + cap])
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    return np.asarray(signs * half @ transform[:3, :3].T + transform[:3, 3])

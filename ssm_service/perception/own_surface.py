"""The arm's own collision geometry, as a sensor sees it: triangles in trees of balls, and capsules."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ..errors import SsmError
from ..model import Robot
from ..model.hulls import triangles

_LEAF: Final = 32  # triangles
_SIDES: Final = 256  # of the prism round a cylinder: 7.5e-5 of its radius too wide at most


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OwnSurface:
    """All collision geometry of a robot, each geometry in the frame of the joint that moves it.

    Attributes:
        bodies: (b,) Pinocchio's index of the joint that moves each geometry; 0 is the base.
        roots: (b,) the top node of a geometry's tree, −1 where it is a capsule (or a ball).
        capsules: (b, 7) both ends and the radius of the capsules [m], else nan.
        balls: (n, 4) centre and radius of the nodes' balls [m].
        nodes: (n, 2) children; or, of a leaf, −1 − first triangle and the one behind the last.
        corners: (t, 9) three corners each [m], the outer side's normal along (b − a) × (c − a).
    """

    bodies: NDArray[np.intp]
    roots: NDArray[np.intp]
    capsules: NDArray[np.float64]
    balls: NDArray[np.float64]
    nodes: NDArray[np.intp]
    corners: NDArray[np.float64]

    @classmethod
    def of_robot(cls, robot: Robot) -> OwnSurface:
        """Take all links' geometry, whether their distance is monitored or not."""
        bodies, roots, capsules = [], [], []
        tree = _Tree()
        for source in robot.collision.geometryObjects:
            placement = source.placement.homogeneous
            capsule = _capsule(source.geometry, placement)
            bodies.append(source.parentJoint)
            capsules.append(np.full(7, np.nan) if capsule is None else capsule)
            roots.append(tree.add(_corners(source.geometry, placement)) if capsule is None else -1)
        made = cls(
            bodies=np.array(bodies, dtype=np.intp),
            roots=np.array(roots, dtype=np.intp),
            capsules=np.array(capsules, dtype=np.float64).reshape(-1, 7),
            balls=np.array(tree.balls, dtype=np.float64).reshape(-1, 4),
            nodes=np.array(tree.nodes, dtype=np.intp).reshape(-1, 2),
            corners=np.concatenate([np.empty((0, 3, 3)), *tree.leaves]).reshape(-1, 9),
        )
        for array in (made.bodies, made.roots, made.capsules, made.balls, made.nodes, made.corners):
            array.flags.writeable = False
        return made


class _Tree:
    """Binary trees of balls over triangles, halved along the longest side of their box."""

    def __init__(self) -> None:
        self.balls: list[NDArray[np.float64]] = []
        self.nodes: list[tuple[int, int]] = []
        self.leaves: list[NDArray[np.float64]] = []
        self._count = 0

    def add(self, corners: NDArray[np.float64]) -> int:
        """Add the tree of triangles (t, 3, 3) [m] and return its top node."""
        points = corners.reshape(-1, 3)
        lower, upper = points.min(axis=0), points.max(axis=0)
        centre = 0.5 * (lower + upper)
        radius = float(np.linalg.norm(points - centre, axis=1).max()) * (1.0 + 1e-9) + 1e-12
        index = len(self.nodes)
        self.balls.append(np.append(centre, radius))
        self.nodes.append((0, 0))
        if len(corners) <= _LEAF:
            first, self._count = self._count, self._count + len(corners)
            self.leaves.append(corners)
            self.nodes[index] = (-1 - first, self._count)
            return index
        order = np.argsort(corners.mean(axis=1)[:, int(np.argmax(upper - lower))], kind="stable")
        half = len(order) // 2
        self.nodes[index] = (self.add(corners[order[:half]]), self.add(corners[order[half:]]))
        return index


def _capsule(shape: Any, placement: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the two ends and the radius of a ball or a capsule, (7,) [m]; ``None`` of anything else."""
    if not isinstance(shape, coal.Sphere | coal.Capsule):
        return None
    half = shape.halfLength if isinstance(shape, coal.Capsule) else 0.0
    centre, axis = placement[:3, 3], placement[:3, 2]
    return np.concatenate((centre - half * axis, centre + half * axis, [shape.radius]))


def _corners(shape: Any, placement: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a shape's surface as triangles, (t, 3, 3) [m]; of a cylinder, that of a prism round it."""
    if isinstance(shape, coal.BVHModelBase):
        vertices, faces = triangles(shape)
        corners = vertices[faces]
        # A mesh that is inside out encloses a negative volume.
        if float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) < 0.0:
            corners = corners[:, ::-1]
    else:
        corners = _hull_corners(_points(shape))
    return np.asarray(corners @ placement[:3, :3].T + placement[:3, 3])


def _points(shape: Any) -> NDArray[np.float64]:
    if isinstance(shape, coal.Box):
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
        return np.asarray(signs * shape.halfSide)
    if isinstance(shape, coal.Cylinder):
        angles = 2.0 * math.pi / _SIDES * np.arange(_SIDES)
        radius = shape.radius / math.cos(math.pi / _SIDES)
        circle = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=1)
        ends = [np.column_stack((circle, np.full(_SIDES, z))) for z in (-shape.halfLength, shape.halfLength)]
        return np.concatenate(ends)
    if isinstance(shape, coal.Convex):
        return np.array(shape.points(), dtype=np.float64).reshape(-1, 3)
    raise SsmError(f"a sensor cannot see a collision geometry of type {type(shape).__name__}")


def _hull_corners(points: NDArray[np.float64]) -> NDArray[np.float64]:
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    corners[inward] = corners[inward][:, ::-1]
    return np.asarray(corners)

"""The arm's own collision geometry, as a sensor sees it: triangles in trees of balls, and capsules."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ..errors import SsmError
from ..model import Robot
from ..model.compiled import compiled
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
    @lru_cache(maxsize=8)
    def of_robot(cls, robot: Robot) -> OwnSurface:
        """Take all links' geometry, whether their distance is monitored or not; once for each robot."""
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
            balls=np.concatenate(tree.balls),
            nodes=np.concatenate(tree.nodes),
            corners=np.concatenate(tree.leaves),
        )
        for array in (made.bodies, made.roots, made.capsules, made.balls, made.nodes, made.corners):
            array.flags.writeable = False
        return made


class _Tree:
    """Binary trees of balls over triangles, halved along the longest side of their box."""

    def __init__(self) -> None:
        self.balls = [np.empty((0, 4))]
        self.nodes = [np.empty((0, 2), dtype=np.intp)]
        self.leaves = [np.empty((0, 9))]
        self._nodes = self._triangles = 0

    def add(self, corners: NDArray[np.float64]) -> int:
        """Add the tree of triangles (t, 9) [m] and return its top node."""
        root = self._nodes
        order = np.arange(len(corners))
        balls, nodes = np.empty((2 * len(corners), 4)), np.empty((2 * len(corners), 2), dtype=np.intp)
        count = _grow(np.ascontiguousarray(corners), order, balls, nodes)
        inner = nodes[:count, 0] >= 0
        nodes[:count][inner] += root
        nodes[:count][~inner] += [-self._triangles, self._triangles]
        self.balls.append(balls[:count])
        self.nodes.append(nodes[:count])
        self.leaves.append(corners[order])
        self._nodes += count
        self._triangles += len(corners)
        return root


@compiled
def _grow(
    corners: NDArray[np.float64],
    order: NDArray[np.intp],
    balls: NDArray[np.float64],
    nodes: NDArray[np.intp],
) -> int:
    """Sort ``order`` (t,) so that each node is a part of it; fill balls and nodes and return their number."""
    parts = np.empty((len(nodes), 2), dtype=np.intp)  # of each node, where its triangles begin and end
    parts[0, 0], parts[0, 1] = 0, len(order)
    count, node = 1, 0
    while node < count:
        first, last = parts[node]
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for i in order[first:last]:
            for k in range(9):
                low[k % 3], high[k % 3] = min(low[k % 3], corners[i, k]), max(high[k % 3], corners[i, k])
        balls[node, :3] = 0.5 * (low + high)
        farthest = 0.0
        for i in order[first:last]:
            for k in range(0, 9, 3):
                away = corners[i, k : k + 3] - balls[node, :3]
                farthest = max(farthest, away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
        balls[node, 3] = math.sqrt(farthest) * (1.0 + 1e-9) + 1e-12
        if last - first <= _LEAF:
            nodes[node, 0], nodes[node, 1] = -1 - first, last
        else:
            axis = np.argmax(high - low)
            part = order[first:last].copy()
            middles = corners[part, axis] + corners[part, axis + 3] + corners[part, axis + 6]
            order[first:last] = part[np.argsort(middles)]
            half = (first + last) // 2
            nodes[node, 0], nodes[node, 1] = count, count + 1
            parts[count, 0], parts[count, 1] = first, half
            parts[count + 1, 0], parts[count + 1, 1] = half, last
            count += 2
        node += 1
    return count


def _capsule(shape: Any, placement: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the two ends and the radius of a ball or a capsule, (7,) [m]; ``None`` of anything else."""
    if not isinstance(shape, coal.Sphere | coal.Capsule):
        return None
    half = shape.halfLength if isinstance(shape, coal.Capsule) else 0.0
    centre, axis = placement[:3, 3], placement[:3, 2]
    return np.concatenate((centre - half * axis, centre + half * axis, [shape.radius]))


def _corners(shape: Any, placement: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a shape's surface as triangles, (t, 9) [m]; of a cylinder, that of a prism round it."""
    if isinstance(shape, coal.BVHModelBase):
        vertices, faces = triangles(shape)
        corners = vertices[faces]
        # A mesh that is inside out encloses a negative volume.
        if float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) < 0.0:
            corners = corners[:, ::-1]
    else:
        corners = _hull_corners(_points(shape))
    return np.asarray(corners @ placement[:3, :3].T + placement[:3, 3]).reshape(-1, 9)


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

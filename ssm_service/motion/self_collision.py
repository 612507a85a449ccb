"""Whether the arm touches itself, and how near it is to that, by the hulls of its links."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..model import Robot, moved_by
from ..model.closing import cross
from ..model.hulls import build_parts

Array = NDArray[np.float64]

SAMPLES: Final = 60
"""Joint positions that tell which hulls overlap always."""

ALWAYS: Final = 0.95
"""Share of them at which a pair that touches is one of hulls that are too large."""

_left_out: WeakKeyDictionary[Robot, list[int]] = WeakKeyDictionary()  # of each robot without a start

_FAILED: Final = 1e300  # Coal's word for a distance that it could not tell is 1.8e308


class SelfCollision:
    """The links' hull pieces against each other, without those that a joint joins.

    Hulls are larger than the links, so what does not touch here does not touch. Where the arm at the start
    seems to touch itself, those pairs are left out: the hulls are too large there, and nothing else could be
    planned. Without a start, those are left out that touch at nearly all of some random joint positions. Not
    for use by several threads at once.

    Args:
        robot: The robot; its monitored links count.
        start: (n,) joint position that is known to be free [rad or m].

    Raises:
        ConfigError: A mesh has no usable convex hull.
    """

    def __init__(self, robot: Robot, start: Array | None = None) -> None:
        self._robot = robot
        self._model: Any = pin.GeometryModel()
        joints: list[int] = []
        moved: list[NDArray[np.bool_]] = []
        found: list[Array] = []
        for part in build_parts(robot):
            for index, piece in enumerate(part.pieces):
                source = part.source
                name = f"{part.link}.{source.name}.{index}"
                self._model.addGeometryObject(
                    pin.GeometryObject(name, source.parentJoint, source.placement, piece)
                )
                joints.append(source.parentJoint)
                moved.append(moved_by(robot, part.link))
                found.append(levers(robot.model, source, piece))
        self._moved = np.array(moved)
        self._pairs: list[tuple[int, int]] = []
        parents = list(robot.model.parents)
        for a, b in itertools.combinations(range(len(joints)), 2):
            one, other = joints[a], joints[b]
            if one != other and parents[one] != other and parents[other] != one:
                self._model.addCollisionPair(pin.CollisionPair(a, b))
                self._pairs.append((a, b))
        self._data: Any = robot.model.createData()
        self._geometry: Any = self._model.createData()
        left_out = _left_out.get(robot) if start is None else None
        if left_out is None:
            left_out = self._touching(np.array([start]) if start is not None else _anywhere(robot), ALWAYS)
        if start is None:
            _left_out[robot] = left_out
        for index in left_out:
            self._geometry.deactivateCollisionPair(index)
        first, second = np.array(self._pairs, dtype=np.intp).reshape(-1, 2).T
        lever = np.array(found)
        # Joints that move both do not change how far apart they are.
        apart = self._moved[first] ^ self._moved[second]
        self._signs = self._moved[second].astype(np.float64) - self._moved[first]
        self._levers = np.where(apart, np.where(self._moved[first], lever[first], lever[second]), 0.0)
        self._results = list(self._geometry.distanceResults)
        self._at = np.zeros_like(self._levers)
        active = np.array(self._geometry.activeCollisionPairs, dtype=np.bool_)
        self._distance = np.where(active, -math.inf, math.inf)

    def touches(self, position: NDArray[np.float64]) -> bool:
        """Return whether two links touch at a joint position, (n,) [rad or m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        found = pin.computeCollisions(self._robot.model, self._data, self._model, self._geometry, q, True)
        return bool(found)

    def rows(
        self, position: Array, spatial: Array, speeds: Array, margin: float, gain: float
    ) -> tuple[Array, Array]:
        """Return the distances that can matter to a barrier now, and how they close.

        A barrier ``g·q̇ ≤ gain (d − margin)`` cannot bind where ``d`` is too great for all speeds that the
        joints may have. A joint that turns by δ brings two links nearer by at most its lever times δ, so most
        pairs need not be measured again for long, and nothing is ever missed: which pairs are returned hangs
        on what was measured before, the solution of the programme does not.

        Args:
            position: (n,) [rad or m].
            spatial: (6, n), ``Kinematics.spatial_jacobian`` at this position.
            speeds: (n,) greatest size of each joint's velocity now [rad/s].
            margin: The least distance [m].
            gain: Of the barrier [1/s].

        Returns:
            (p,) distances [m], negative in penetration, −inf where Coal failed, and (p, n) g.

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        needed = margin + self._levers @ speeds / gain
        least = self._distance - np.einsum("ij,ij->i", self._levers, np.abs(position - self._at))
        due = (~(least >= needed)).nonzero()[0]
        if not len(due):
            return np.empty(0), np.empty((0, len(position)))
        q = self._robot.pinocchio_configuration(position)
        pin.updateGeometryPlacements(self._robot.model, self._data, self._model, self._geometry, q)
        for index in due.tolist():
            pin.computeDistance(self._model, self._geometry, index)
            distance = self._results[index].min_distance
            self._distance[index] = distance if abs(distance) < _FAILED else -math.inf
        self._at[due] = position
        found = due[self._distance[due] < needed[due]]
        if not len(found):
            return np.empty(0), np.empty((0, len(position)))
        return self._distance[found], self._gradients(found.tolist(), spatial)

    def _gradients(self, pairs: list[int], spatial: Array) -> Array:
        """Return g of some pairs as last measured, (p, n)."""
        results = [self._results[index] for index in pairs]
        points = np.array([result.getNearestPoint1() for result in results])
        # Coal's normal points from the first to the second, in penetration as well.
        normals = np.array([result.normal for result in results])
        if not math.isfinite(float(points.sum() + normals.sum())):
            for row in (~np.isfinite(points + normals).all(axis=1)).nonzero()[0].tolist():
                points[row], other = (self._geometry.oMg[i].translation for i in self._pairs[pairs[row]])
                between = other - points[row]
                normals[row] = between / max(float(np.linalg.norm(between)), 1e-9)
        # g of the first point less that of the second; both lie on the normal, so either one will do:
        # n·(v + ω × p) = n·v + ω·(p × n)
        along = normals @ spatial[:3] + cross(points, normals) @ spatial[3:]
        gradients: Array = along * -self._signs[pairs]
        return gradients

    def _touching(self, positions: Array, share: float) -> list[int]:
        """Return the pairs that touch at this share of the joint positions, (s, n)."""
        touching = np.zeros(len(self._pairs))
        for position in positions:
            q = self._robot.pinocchio_configuration(position)
            pin.computeCollisions(self._robot.model, self._data, self._model, self._geometry, q, False)
            touching += [result.isCollision() for result in self._geometry.collisionResults]
        found: list[int] = (touching >= share * len(positions)).nonzero()[0].tolist()
        return found


def _anywhere(robot: Robot) -> Array:
    """Return random joint positions, the same for the same robot, (s, n)."""
    lower = np.maximum(robot.position_lower, -math.pi)
    upper = np.minimum(robot.position_upper, math.pi)
    return np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(lower)))


def levers(model: Any, source: Any, piece: Any) -> Array:
    """Return by how much each joint moves a piece's farthest point at most, (n,) [m/rad]; 0 beyond the piece.

    The straight way from the joint along the chain to the point is never shorter than the lever.
    """
    points = np.array(piece.points()) if hasattr(piece, "points") else _corners(piece)
    placed = points @ source.placement.rotation.T + source.placement.translation
    way = float(np.linalg.norm(placed, axis=1).max())
    found = np.zeros(model.njoints - 1)
    joint = source.parentJoint
    while joint > 0:
        kind = model.joints[joint].shortname()
        straight = "P" in kind.removeprefix("JointModel")
        found[joint - 1] = 1.0 if straight else way
        way += float(np.linalg.norm(model.jointPlacements[joint].translation))
        if straight:
            index = model.joints[joint].idx_q
            way += float(max(abs(model.lowerPositionLimit[index]), abs(model.upperPositionLimit[index])))
        joint = model.parents[joint]
    return found


@lru_cache(maxsize=8)
def link_levers(robot: Robot) -> Array:
    """Return by how much each joint moves any point of each monitored link at most, (links, n), read-only."""
    found = np.zeros((len(robot.monitored_links), len(robot.joint_names)))
    for part in build_parts(robot):
        for piece in part.pieces:
            row = found[part.link_index]
            np.maximum(row, levers(robot.model, part.source, piece), out=row)
    found.flags.writeable = False
    return found


def _corners(piece: Any) -> Array:
    """Return the corners of the box round a shape, (8, 3) [m]."""
    box = piece.aabb_local
    ends = np.array([box.min_, box.max_])
    return np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i, j, k in itertools.product((0, 1), repeat=3)])

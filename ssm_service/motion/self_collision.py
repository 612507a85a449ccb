"""Whether the arm touches itself, and how near it is to that, by the hulls of its links."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..model import Robot, closing_gradients, moved_by
from ..model.hulls import build_parts


class SelfCollision:
    """The links' hull pieces against each other, without those that a joint joins.

    Hulls are larger than the links, so what does not touch here does not touch. Where the arm at the start
    seems to touch itself, those pairs are left out: the hulls are too large there, and nothing else could be
    planned. Not for use by several threads at once.

    Args:
        robot: The robot; its monitored links count.
        start: (n,) joint position that is known to be free [rad or m].

    Raises:
        ConfigError: A mesh has no usable convex hull.
    """

    def __init__(self, robot: Robot, start: NDArray[np.float64]) -> None:
        self._robot = robot
        self._model: Any = pin.GeometryModel()
        joints: list[int] = []
        moved: list[NDArray[np.bool_]] = []
        for part in build_parts(robot):
            for index, piece in enumerate(part.pieces):
                source = part.source
                name = f"{part.link}.{source.name}.{index}"
                self._model.addGeometryObject(
                    pin.GeometryObject(name, source.parentJoint, source.placement, piece)
                )
                joints.append(source.parentJoint)
                moved.append(moved_by(robot, part.link))
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
        self._leave_out(start)

    def touches(self, position: NDArray[np.float64]) -> bool:
        """Return whether two links touch at a joint position, (n,) [rad or m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        found = pin.computeCollisions(self._robot.model, self._data, self._model, self._geometry, q, True)
        return bool(found)

    def near(
        self, position: NDArray[np.float64], spatial: NDArray[np.float64], within: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the distances of the links to each other and how they close, for use as pairs of a filter.

        Args:
            position: (n,) [rad or m].
            spatial: (6, n), ``Kinematics.spatial_jacobian`` at this position.
            within: Pairs of pieces farther apart are left out [m].

        Returns:
            (p,) distances [m], negative in penetration, and (p, n) g: at q̇ a pair closes at ``g·q̇`` [m/s].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        pin.computeDistances(self._robot.model, self._data, self._model, self._geometry, q)
        found = [
            (result, *pair)
            for result, pair, active in zip(
                self._geometry.distanceResults, self._pairs, self._geometry.activeCollisionPairs, strict=True
            )
            if active and result.min_distance <= within
        ]
        if not found:
            return np.empty(0), np.empty((0, len(position)))
        distance = np.array([result.min_distance for result, _, _ in found])
        on_one = np.array([result.getNearestPoint1() for result, _, _ in found])
        on_other = np.array([result.getNearestPoint2() for result, _, _ in found])
        # Coal's normal points from the first to the second, in penetration as well.
        normals = -np.array([result.normal for result, _, _ in found])
        one, other = self._moved[[a for _, a, _ in found]], self._moved[[b for _, _, b in found]]
        gradients = closing_gradients(spatial, one, on_one, normals)
        gradients += closing_gradients(spatial, other, on_other, -normals)
        return distance, gradients

    def _leave_out(self, start: NDArray[np.float64]) -> None:
        q = self._robot.pinocchio_configuration(start)
        pin.computeCollisions(self._robot.model, self._data, self._model, self._geometry, q, False)
        for index, result in enumerate(self._geometry.collisionResults):
            if result.isCollision():
                self._geometry.deactivateCollisionPair(index)

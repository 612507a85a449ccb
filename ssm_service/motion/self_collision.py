"""Whether the arm touches itself, by the hulls of its links."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..model import Robot
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
        for part in build_parts(robot):
            for index, piece in enumerate(part.pieces):
                source = part.source
                name = f"{part.link}.{source.name}.{index}"
                self._model.addGeometryObject(
                    pin.GeometryObject(name, source.parentJoint, source.placement, piece)
                )
                joints.append(source.parentJoint)
        parents = list(robot.model.parents)
        for a, b in itertools.combinations(range(len(joints)), 2):
            one, other = joints[a], joints[b]
            if one != other and parents[one] != other and parents[other] != one:
                self._model.addCollisionPair(pin.CollisionPair(a, b))
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

    def _leave_out(self, start: NDArray[np.float64]) -> None:
        q = self._robot.pinocchio_configuration(start)
        pin.computeCollisions(self._robot.model, self._data, self._model, self._geometry, q, False)
        for index, result in enumerate(self._geometry.collisionResults):
            if result.isCollision():
                self._geometry.deactivateCollisionPair(index)

"""Which joint positions and which straight ways between them keep clear of obstacles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model import DistanceModel, Obstacle, Robot
from .self_collision import SelfCollision

FINE_RAD = 0.02
"""A straight way is checked at places not farther apart than this [rad]. A point at 1 m from a joint moves by
2 cm meanwhile, so between two places the distance is at most 1 cm below that at the nearer one."""

LEAVING_RAD = 0.3
"""Within this of a start that is too near, it is enough not to be nearer than the start [rad]."""

_NEARER_M = 1e-4


class FreeSpace:
    """The joint positions that are free of contact.

    Attributes:
        robot: The robot.
        start: (n,) [rad or m].
        lower, upper: (n,) the joints' limits, at most half a turn from the start.
        checked: How many positions were looked at.

    Args:
        robot: The robot.
        start: (n,) where the arm is.
        obstacles: What stands there.
        clearance_m: Least distance by the hulls.

    Raises:
        InputError: ``out_of_range``: the start is beyond the joints' limits.
    """

    def __init__(
        self,
        robot: Robot,
        start: NDArray[np.float64],
        obstacles: Sequence[Obstacle],
        clearance_m: float,
    ) -> None:
        margin = robot.config.file.limits.position_margin_rad
        # An arm may stand within its margin already.
        self.lower = np.minimum(np.maximum(robot.position_lower + margin, start - math.pi), start)
        self.upper = np.maximum(np.minimum(robot.position_upper - margin, start + math.pi), start)
        if not bool(np.all((robot.position_lower <= start) & (start <= robot.position_upper))):
            raise InputError("out_of_range", "start", start.tolist(), "within the joints' limits")
        self.robot = robot
        self.start = start
        self.checked = 0
        self._distance = DistanceModel(robot)
        self._distance.set_obstacles(obstacles)
        self._itself = SelfCollision(robot, start)
        self._clearance = clearance_m
        self._near = min(clearance_m, float(self._distance.bounds(start).min(initial=math.inf)) - _NEARER_M)

    def free(self, position: NDArray[np.float64]) -> bool:
        """Return whether a joint position, (n,), is within the limits, clear of everything and of itself."""
        self.checked += 1
        if not bool(np.all((self.lower <= position) & (position <= self.upper))):
            return False
        return self._clear(position) and not self._itself.touches(position)

    def edge_free(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        """Return whether the straight way between two joint positions, (n,) each, is free, both included."""
        count = max(1, math.ceil(float(np.linalg.norm(end - start)) / FINE_RAD))
        # The middle first, then ever finer: what is not free shows early.
        shares = sorted(np.linspace(0.0, 1.0, count + 1).tolist(), key=_coarseness)
        return all(self.free((1.0 - share) * start + share * end) for share in shares)

    def whole(self, free: Sequence[float]) -> NDArray[np.float64]:
        """Return all joints' positions, (n,), for those of the free joints, (k,)."""
        position = self.start.copy()
        position[self.robot.free] = free
        return position

    def _clear(self, position: NDArray[np.float64]) -> bool:
        """Return whether nothing is too near; less than the clearance will do near a start that is nearer."""
        if self._distance.keeps(position, self._clearance):
            return True
        leaving = float(np.linalg.norm(position - self.start)) <= LEAVING_RAD
        return leaving and self._near < self._clearance and self._distance.keeps(position, self._near)


def _coarseness(share: float) -> int:
    """Return how often a unit interval is halved until the share is met, roughly."""
    for halvings in range(1, 12):
        scaled = share * 2**halvings
        if abs(scaled - round(scaled)) < 0.05:
            return halvings
    return 12

"""Following a path: from where the arm is to a joint velocity along it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .path import Path

LOOKAHEAD_RAD = 0.12
"""How far ahead of the nearest place the arm steers. Corners are cut by less than this; the planner's
clearance and the filter behind it see to that."""

LEAVE_RAD = 0.4
"""Farther from the path than this, the path no longer holds."""

APPROACH_GAIN = 2.0
"""The arm slows to this times what is left of the path [1/s]."""


class PathGuide:
    """Pure pursuit along a path in joint space.

    The place on the path that the arm has come to never goes back, so that a path that crosses or doubles
    itself is followed in order, and an arm that is pushed back does not begin anew. It moves on by at most
    ``LOOKAHEAD_RAD`` beyond what was steered for, so no stretch is skipped. What the guide wants is a wish
    like any other: obstacles are for the filter behind it.

    Args:
        path: To follow.
        leave: The distance from the path at which it no longer holds [rad].
    """

    def __init__(self, path: Path, *, leave: float = LEAVE_RAD) -> None:
        self.path = path
        self._leave = leave
        self._arc = 0.0
        self._valid = True

    @property
    def valid(self) -> bool:
        """Whether the arm is still near the path."""
        return self._valid

    @property
    def arc(self) -> float:
        """How far along the path the arm has come [rad]; it never falls."""
        return self._arc

    @property
    def remaining(self) -> float:
        """What is left of the path [rad]."""
        return self.path.length - self._arc

    def leads_to(self, goal: NDArray[np.float64], tolerance: float = 1e-3) -> bool:
        """Return whether the path ends at a position of the end effector.

        Args:
            goal: (3,) [m], base frame.
            tolerance: How far apart the two may be [m].
        """
        return self.path.goal is not None and float(np.linalg.norm(self.path.goal - goal)) <= tolerance

    def wanted(self, position: NDArray[np.float64], speed: float) -> NDArray[np.float64]:
        """Return the joint velocity along the path, (n,) [rad/s]; 0 once the path no longer holds.

        Args:
            position: (n,) where the arm is [rad or m].
            speed: Greatest norm of the result [rad/s].
        """
        self._arc, away = self.path.nearest(position, self._arc, self._arc + 2.0 * LOOKAHEAD_RAD)
        # NaN is not near either
        self._valid = self._valid and away <= self._leave
        if not self._valid:
            return np.zeros(len(position))
        towards = self.path.at(self._arc + LOOKAHEAD_RAD) - position
        distance = float(np.linalg.norm(towards))
        if distance == 0.0:
            return np.zeros(len(position))
        limit = min(speed, APPROACH_GAIN * max(self.remaining, distance))
        wanted: NDArray[np.float64] = towards * (limit / distance)
        return wanted

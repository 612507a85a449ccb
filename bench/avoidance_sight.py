"""The distances of arm and obstacles at one instant, for methods and judge of ``bench.avoidance``."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ssm_service.model import ClosestPair, DistanceModel, Obstacle, Pairs, Robot

Array = NDArray[np.float64]


class Sight:
    """The distances at one instant, measured when they are asked for.

    Attributes:
        distances: What measures them.
        obstacles: What is there.
        position: (n,) where the arm is [rad].
    """

    def __init__(self, arm: Robot) -> None:
        self.distances = DistanceModel(arm)
        self.obstacles: tuple[Obstacle, ...] = ()
        self.position = arm.rest_position
        self._nearest: ClosestPair | None = None
        self._measured = False

    def at(self, obstacles: tuple[Obstacle, ...], position: Array) -> Sight:
        """Go on to another instant, and return itself."""
        if obstacles is not self.obstacles:
            self.distances.set_obstacles(obstacles)
            self.obstacles = obstacles
        self.position, self._measured = position, False
        return self

    @property
    def nearest(self) -> ClosestPair | None:
        """The nearest pair of all, exactly, as the service measures it; None without obstacles."""
        if not self._measured:
            self._nearest, self._measured = self.distances.nearest(self.position), True
        return self._nearest

    @property
    def least_m(self) -> float:
        """The exact distance of the nearest pair [m]; infinite without obstacles."""
        return math.inf if self.nearest is None else self.nearest.distance

    def pairs(self) -> Pairs:
        """Return all pairs, by the hulls."""
        return self.distances.pairs(self.position)

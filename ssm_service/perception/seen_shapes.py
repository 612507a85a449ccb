"""Convex obstacles in a sensor's own frame: their nearest point and the planes that part them from a cone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.shapes import Obstacle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenShape:
    """A capsule, cylinder or box in a sensor's frame (apex at the origin, sensing along +x).

    Attributes:
        shape: ``capsule``, ``cylinder`` or ``box``.
        half: (3,) half edges of a box; of the others ``(radius, radius, length / 2)`` [m].
        centre: (3,) [m], sensor frame.
        axes: (3, 3), shape frame to sensor frame.
    """

    shape: str
    half: NDArray[np.float64]
    centre: NDArray[np.float64]
    axes: NDArray[np.float64]

    @classmethod
    def of(cls, obstacle: Obstacle, transform_sensor_to_base: NDArray[np.float64]) -> SeenShape:
        """Return ``obstacle``, which is no sphere, as the sensor with this (4, 4) pose sees it."""
        R_sensor_base = transform_sensor_to_base[:3, :3].T
        size = obstacle.size
        full = size if obstacle.shape == "box" else (2.0 * size[0], 2.0 * size[0], size[1])
        return cls(
            shape=obstacle.shape,
            half=0.5 * np.array(full),
            centre=R_sensor_base @ (np.array(obstacle.position) - transform_sensor_to_base[:3, 3]),
            axes=R_sensor_base @ obstacle.rotation(),
        )

    def nearest(self) -> NDArray[np.float64]:
        """Return the shape's point nearest to the apex, (3,) [m]; the apex itself when it is inside."""
        apex = -(self.centre @ self.axes)
        if self.shape == "box":
            return np.asarray(self.centre + self.axes @ np.clip(apex, -self.half, self.half))
        x, y, z = apex.tolist()
        radius, half_length = float(self.half[0]), float(self.half[2])
        core = min(max(z, -half_length), half_length)
        if self.shape == "capsule":
            gap = math.hypot(x, y, z - core)
            share = min(1.0, radius / gap) if gap > 0.0 else 1.0
            local = np.array([share * x, share * y, core + share * (z - core)])
        else:
            gap = math.hypot(x, y)
            share = min(1.0, radius / gap) if gap > 0.0 else 1.0
            local = np.array([share * x, share * y, core])
        nearest: NDArray[np.float64] = self.centre + self.axes @ local
        return nearest

    def extent(self, direction: NDArray[np.float64]) -> float:
        """Return how far the shape reaches from its centre along the unit vector ``direction`` (3,), [m]."""
        x, y, z = (direction @ self.axes).tolist()
        a, b, c = self.half.tolist()
        if self.shape == "box":
            return float(abs(x) * a + abs(y) * b + abs(z) * c)
        across = a if self.shape == "capsule" else a * math.hypot(x, y)
        return float(across + abs(z) * c)

    def is_parted(self, aim: NDArray[np.float64], half_angle: float) -> bool:
        """Return whether one plane shows that the shape misses the cone.

        The plane passes through the apex and touches the cone on the side of ``aim`` (3,). ``False`` says
        nothing.
        """
        x, y, z = aim.tolist()
        off_axis = math.hypot(y, z)
        if off_axis == 0.0:
            return False
        cos, sin = math.cos(half_angle), math.sin(half_angle)
        if (
            x * cos + off_axis * sin <= 0.0
        ):  # more than 90° from every ray of the cone: a plane across the aim
            normal = aim / math.hypot(x, off_axis)
        else:
            normal = np.array([-sin, cos * y / off_axis, cos * z / off_axis])
        height = float(normal @ self.centre)
        return height - self.extent(normal) > 1e-12 * (1.0 + abs(height))

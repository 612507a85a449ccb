"""A link that is a ball: everything about it has a closed form."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssm_service.perception.coverage import SensedLink
from ssm_service.perception.coverage_cones import Cones

Array = NDArray[np.float64]


class BallBody:
    """A ball about the origin, as solid and as surface."""

    def __init__(self, radius: float) -> None:
        self.radius = radius

    @property
    def box(self) -> Array:
        return np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]) * self.radius

    @property
    def near_points(self) -> NDArray[np.float32]:
        angles = np.linspace(0.0, 2.0 * np.pi, 60)
        ring = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
        return (self.radius * np.concatenate([ring, ring[:, [2, 0, 1]]])).astype(np.float32)

    def lower(self, points: ArrayLike) -> Array:
        away: Array = np.linalg.norm(np.asarray(points), axis=1) - self.radius
        return np.maximum(away, 0.0)

    def nearest(self, points: Array, covering: float) -> tuple[Array, Array]:
        away = np.linalg.norm(points, axis=1)
        on = self.radius * points / np.maximum(away, 1e-12)[:, np.newaxis]
        distances = np.abs(away - self.radius)
        return on, np.maximum(0.0, distances * distances - covering * covering)


def sensed_ball(radius: float, cones: Cones) -> SensedLink:
    """Return the ball with sensors."""
    body = BallBody(radius)
    return SensedLink.of("ball", body, body, cones)


def cones_round(
    count: int, radius: float, half_angle_deg: float, reach: float, tilt_deg: float = 0.0
) -> Cones:
    """Return a ring about z."""
    angles = 2.0 * np.pi / count * np.arange(count)
    out = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    tilt = math.radians(tilt_deg)
    return Cones(
        apexes=radius * out,
        axes=math.cos(tilt) * out + np.array([0.0, 0.0, math.sin(tilt)]),
        half_angles=np.full(count, math.radians(half_angle_deg)),
        reaches=np.full(count, reach),
    )

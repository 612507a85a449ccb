"""Obstacles as surfaces in a 3-D figure."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..model import Obstacle
from ..wire.messages import ObstacleEntry

AROUND: Final = np.linspace(0.0, 2.0 * np.pi, 25)


def draw_shape(axes: Any, entry: ObstacleEntry, colour: str) -> None:
    """Draw one obstacle as a translucent surface."""
    x, y, z = surface(entry)
    axes.plot_surface(x, y, z, color=colour, alpha=0.35, linewidth=0, shade=True, zorder=4)


def surface(entry: ObstacleEntry) -> NDArray[np.float64]:
    """Return an obstacle's surface as a grid of points, (3, a, b) [m], base frame."""
    obstacle = Obstacle(
        id=entry.id,
        shape=entry.shape,
        size=tuple(entry.size),
        position=entry.position,
        quaternion_xyzw=entry.quaternion_xyzw,
    )
    local = _box(*obstacle.size) if obstacle.shape == "box" else _turned(*_profile(obstacle))
    turned: NDArray[np.float64] = np.einsum("ij,jab->iab", obstacle.rotation(), local)
    turned += np.reshape(obstacle.position, (3, 1, 1))
    return turned


def _profile(obstacle: Obstacle) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return radius and height of a round shape's outline, from its lower to its upper end [m]."""
    radius, half = obstacle.size[0], 0.5 * obstacle.size[1] if len(obstacle.size) > 1 else 0.0
    if obstacle.shape == "cylinder":
        return np.array([0.0, radius, radius, 0.0]), np.array([-half, -half, half, half])
    lower, upper = np.linspace(-np.pi / 2, 0.0, 9), np.linspace(0.0, np.pi / 2, 9)
    angles = np.concatenate([lower, upper])
    shift = np.repeat([-half, half], 9)
    return radius * np.cos(angles), radius * np.sin(angles) + shift


def _turned(radius: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array(
        [
            np.outer(radius, np.cos(AROUND)),
            np.outer(radius, np.sin(AROUND)),
            np.outer(height, np.ones_like(AROUND)),
        ]
    )


def _box(x: float, y: float, z: float) -> NDArray[np.float64]:
    """Return a box as a square 'turned' round z, with lids."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]], dtype=np.float64) * 0.5
    scale, height = np.array([0.0, 1.0, 1.0, 0.0]), np.array([-0.5, -0.5, 0.5, 0.5]) * z
    return np.array(
        [np.outer(scale, corners[:, 0] * x), np.outer(scale, corners[:, 1] * y), np.outer(height, np.ones(5))]
    )

"""Distance of points from spherical sectors: what a reading, or a silence, says about a ball.

A ball of radius R about c reads l or less, by a sensor with a half angle below 90°, exactly where it meets
the sector K^l: the points of the cone that are no farther than l from its apex. K^l is convex, so the
distance of c from it is convex and 1-Lipschitz in c. Compiled: import this module lazily.
"""

from __future__ import annotations

import math
from typing import Any

from ..model.compiled import compiled


@compiled
def cone_coordinates(sensor: Any, x: float, y: float, z: float) -> Any:
    """Return (t, b) of a point: its distance from K^l is that of (t, b) from the segment t = 0..l, b = 0.

    Outside the cone that is the component along the nearest edge ray and the one square to it; inside,
    the distance from the apex, and 0.

    Args:
        sensor: (8,) apex, axis, cosine and sine of the half angle.
        x: [m], in the frame of the sensor's coordinates, like y and z.
        y: See x.
        z: See x.
    """
    dx, dy, dz = x - sensor[0], y - sensor[1], z - sensor[2]
    along = dx * sensor[3] + dy * sensor[4] + dz * sensor[5]
    squared = dx * dx + dy * dy + dz * dz
    off = math.sqrt(max(0.0, squared - along * along))
    beside = off * sensor[6] - along * sensor[7]
    if beside <= 0.0:
        return math.sqrt(squared), 0.0
    return along * sensor[6] + off * sensor[7], beside


@compiled
def sector_distance(t: float, b: float, length: float) -> Any:
    """Return the distance [m] of the point (t, b) from the sector of that length."""
    beyond = t - min(max(t, 0.0), length)
    return math.sqrt(beyond * beyond + b * b)


@compiled
def sector_gradient(sensor: Any, length: float, x: float, y: float, z: float) -> Any:
    """Return the distance [m] of a point from the sector, and its gradient (0 in the sector)."""
    dx, dy, dz = x - sensor[0], y - sensor[1], z - sensor[2]
    along = dx * sensor[3] + dy * sensor[4] + dz * sensor[5]
    squared = dx * dx + dy * dy + dz * dz
    off = math.sqrt(max(0.0, squared - along * along))
    beside = off * sensor[6] - along * sensor[7]
    if beside <= 0.0:
        size = math.sqrt(squared)
        if size <= length:
            return 0.0, 0.0, 0.0, 0.0
        return size - length, dx / size, dy / size, dz / size
    t = along * sensor[6] + off * sensor[7]
    beyond = t - min(max(t, 0.0), length)
    distance = math.sqrt(beyond * beyond + beside * beside)
    # Unit vectors along the edge ray and square to it, of axis u and the direction w off the axis.
    in_ray, in_normal = beyond / distance, beside / distance
    of_axis = in_ray * sensor[6] - in_normal * sensor[7]
    of_side = (in_ray * sensor[7] + in_normal * sensor[6]) / max(off, 1e-12)
    wx, wy, wz = dx - along * sensor[3], dy - along * sensor[4], dz - along * sensor[5]
    return (
        distance,
        of_axis * sensor[3] + of_side * wx,
        of_axis * sensor[4] + of_side * wy,
        of_axis * sensor[5] + of_side * wz,
    )


@compiled
def ray_gradient(sensor: Any, x: float, y: float, z: float) -> Any:
    """Return t of ``cone_coordinates``, convex as the greatest component along a ray, and its gradient."""
    dx, dy, dz = x - sensor[0], y - sensor[1], z - sensor[2]
    along = dx * sensor[3] + dy * sensor[4] + dz * sensor[5]
    squared = dx * dx + dy * dy + dz * dz
    off = math.sqrt(max(0.0, squared - along * along))
    if off * sensor[6] - along * sensor[7] <= 0.0:
        size = max(math.sqrt(squared), 1e-12)
        return math.sqrt(squared), dx / size, dy / size, dz / size
    side = sensor[7] / max(off, 1e-12)
    axial = sensor[6] - along * side
    return (
        along * sensor[6] + off * sensor[7],
        axial * sensor[3] + side * dx,
        axial * sensor[4] + side * dy,
        axial * sensor[5] + side * dz,
    )

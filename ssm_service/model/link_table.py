"""Look-up in a link's distance table, compiled. Import this module lazily: numba takes half a second."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled


@compiled
def squared_minus(levels: Any, values: Any, box: Any, x: float, y: float, z: float) -> Any:
    """Return a lower bound of D² − |c|² [m²] at c = (x, y, z).

    Args:
        levels: (n, 8), the finest first: origin (3), spacing, counts (3), index of the first value.
        values: Node values of D² − |c|², rounded down.
        box: (6,) least and greatest corner round the link.
        x: [m], link frame, like y and z.
        y: See x.
        z: See x.
    """
    for n in range(levels.shape[0]):
        step = 1.0 / levels[n, 3]
        u, v, w = (x - levels[n, 0]) * step, (y - levels[n, 1]) * step, (z - levels[n, 2]) * step
        if (
            u >= 0.0
            and v >= 0.0
            and w >= 0.0
            and u < levels[n, 4] - 1.0
            and v < levels[n, 5] - 1.0
            and w < levels[n, 6] - 1.0
        ):
            i, j, k = int(u), int(v), int(w)
            u -= i
            v -= j
            w -= k
            down = int(levels[n, 6])
            across = int(levels[n, 5]) * down
            a = int(levels[n, 7]) + i * across + j * down + k
            b = a + across
            near = (values[a] * (1.0 - w) + values[a + 1] * w) * (1.0 - v) + (
                values[a + down] * (1.0 - w) + values[a + down + 1] * w
            ) * v
            far = (values[b] * (1.0 - w) + values[b + 1] * w) * (1.0 - v) + (
                values[b + down] * (1.0 - w) + values[b + down + 1] * w
            ) * v
            return near * (1.0 - u) + far * u
    dx = max(box[0] - x, 0.0, x - box[3])
    dy = max(box[1] - y, 0.0, y - box[4])
    dz = max(box[2] - z, 0.0, z - box[5])
    return dx * dx + dy * dy + dz * dz - (x * x + y * y + z * z)


@compiled
def upper(levels: Any, values: Any, box: Any, points: Any, x: float, y: float, z: float) -> Any:
    """Return an upper bound of D [m], for points outside the link that a ball of 9 mm can get to.

    Args:
        levels: As for ``squared_minus``, like ``values`` and ``box``.
        values: See levels.
        box: See levels.
        points: (m, 3) a point of the link near each node of the first levels.
        x: [m], link frame, like y and z.
        y: See x.
        z: See x.
    """
    low = math.sqrt(max(0.0, squared_minus(levels, values, box, x, y, z) + (x * x + y * y + z * z)))
    for n in range(levels.shape[0]):
        h = levels[n, 3]
        u, v, w = (x - levels[n, 0]) / h, (y - levels[n, 1]) / h, (z - levels[n, 2]) / h
        if (
            u >= 0.0
            and v >= 0.0
            and w >= 0.0
            and u < levels[n, 4] - 1.0
            and v < levels[n, 5] - 1.0
            and w < levels[n, 6] - 1.0
        ):
            down = int(levels[n, 6])
            across = int(levels[n, 5]) * down
            first = int(levels[n, 7]) + int(u) * across + int(v) * down + int(w)
            if first + across + down + 1 >= len(points):
                return low + 3.5 * h  # see LinkDistance.tolerance
            best = math.inf
            for corner in range(8):
                a = first + (corner & 1) + down * ((corner >> 1) & 1) + across * (corner >> 2)
                dx, dy, dz = x - points[a, 0], y - points[a, 1], z - points[a, 2]
                best = min(best, dx * dx + dy * dy + dz * dz)
            near = math.sqrt(best) + 1e-6
            # With a node inside the link at a corner, a point outside is nearer than the cell's diagonal.
            return max(near, 1.74 * h) if low < 1.74 * h else near
    return low + math.sqrt((box[3] - box[0]) ** 2 + (box[4] - box[1]) ** 2 + (box[5] - box[2]) ** 2)


@compiled
def look_up(levels: Any, values: Any, box: Any, points: Any, result: Any) -> None:
    """Write the lower bounds of the distances [m] of ``points``, (n, 3), into ``result``, (n,)."""
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        squared = squared_minus(levels, values, box, x, y, z) + (x * x + y * y + z * z)
        result[n] = math.sqrt(max(0.0, squared))


def distances(
    levels: NDArray[np.float64],
    values: NDArray[np.float32],
    box: NDArray[np.float64],
    points: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the lower bounds of the distances, (n,) [m]."""
    result = np.empty(len(points))
    look_up(levels, values, box, np.ascontiguousarray(points), result)
    return result

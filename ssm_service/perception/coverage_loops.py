"""The loops over centres and sensors, as machine code."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import compiled

Array = NDArray[np.float64]


@compiled
def sector_distance(centre: Array, apex: Array, axis: Array, cos: float, sin: float, reach: float) -> float:
    """Return the distance of a point from one spherical sector [m]."""
    dx, dy, dz = centre[0] - apex[0], centre[1] - apex[1], centre[2] - apex[2]
    x = dx * axis[0] + dy * axis[1] + dz * axis[2]
    square = dx * dx + dy * dy + dz * dz
    off_axis = math.sqrt(max(0.0, square - x * x))
    beside = off_axis * cos - x * sin
    if beside <= 0.0:  # in the cone
        return max(0.0, math.sqrt(square) - reach)
    along = x * cos + off_axis * sin  # of the nearest edge ray
    past = along - min(max(along, 0.0), reach)
    return math.sqrt(past * past + beside * beside)


@compiled
def least(centres: Array, apexes: Array, axes: Array, cos: Array, sin: Array, reaches: Array) -> Array:
    """Return the distance of each centre, (n, 3), from the nearest of the sectors, (n,) [m]."""
    result = np.empty(len(centres))
    for n in range(len(centres)):
        best = np.inf
        for k in range(len(apexes)):
            best = min(best, sector_distance(centres[n], apexes[k], axes[k], cos[k], sin[k], reaches[k]))
        result[n] = best
    return result


@compiled
def counts(
    centres: Array, radii: Array, apexes: Array, axes: Array, cos: Array, sin: Array, reaches: Array
) -> NDArray[np.int64]:
    """Return how many sectors lie within each radius, (r,) [m], of each centre, (n, 3), (r, n)."""
    result = np.zeros((len(radii), len(centres)), dtype=np.int64)
    for n in range(len(centres)):
        for k in range(len(apexes)):
            distance = sector_distance(centres[n], apexes[k], axes[k], cos[k], sin[k], reaches[k])
            for r in range(len(radii)):
                if distance <= radii[r]:
                    result[r, n] += 1
    return result

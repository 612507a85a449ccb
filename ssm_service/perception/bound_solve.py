"""One search for the ball that comes nearest, given what to avoid and what to meet. Compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.compiled import compiled
from .bound_search import MOST, search
from .sectors import cone_coordinates, sector_distance

TOLERANCE = 3e-4  # [m]; of a search
SMALLEST = 5e-5  # [m]; half diagonal of its boxes
SMALLEST_SINGLE = 3e-4  # [m]; the same with one echo, where nothing is nearly contradictory


@compiled
def limits(sensor: Any, reading: float, error: float) -> Any:
    """Return (low, high): the sectors that a ball of this reading must not meet, and must meet [m].

    The ideal reading is p, but no less than range_min; the reading is within ε of it. So p ≥ d − ε, which
    says nothing up to range_min, and p ≤ max(d + ε, range_min). Silence is a reading of range_max or more.

    Args:
        sensor: (10,) apex, axis, cosine and sine of the half angle, range_min, range_max.
        reading: d [m], inf for silence.
        error: ε [m].
    """
    silent = reading == math.inf
    low = (sensor[9] if silent else reading) - error
    if low <= sensor[8] + 1e-9:  # d = range_min + ε may come out a rounding above it
        low = 0.0
    return low, math.inf if silent else max(reading + error, sensor[8])


@compiled
def solve(
    link: Any, sensors: Any, lows: Any, highs: Any, radii: Any, limit: float, tolerance: float, found: Any
) -> Any:
    """Return the bound for given sectors [m], ``limit`` where no ball is admissible that comes nearer.

    Args:
        link: Distance table: levels, values, box, near points.
        sensors: (k, 10).
        lows: (k,) [m].
        highs: (k,) [m].
        radii: (2,) least and greatest [m].
        limit: What need not be passed [m]; inf for none.
        tolerance: Of the search [m]; inf where any ball will do.
        found: (5,) gap, centre and radius of the ball found; written. The gap is ``limit`` without one.
    """
    found[0] = limit
    levels, values, box, points = link
    least, most = radii[0], radii[0]  # unseen, the least ball comes nearest, as it fits into any other
    roots = np.empty((1, 6))
    root = roots[0]
    lower, upper = np.full(3, -math.inf), np.full(3, math.inf)
    for i in range(len(lows)):
        if highs[i] < math.inf:
            most = radii[1]
    for i in range(len(lows)):
        if highs[i] < math.inf:
            _meet(sensors[i], highs[i], most + 1e-5, lower, upper)
    if lower[0] == -math.inf:
        # Beyond all sectors a ball is always admissible, and no farther than this from the link.
        reach = 0.0
        for i in range(len(lows)):
            spread = 0.0
            for a in range(3):
                far = max(abs(sensors[i, a] - box[a]), abs(sensors[i, a] - box[a + 3]))
                spread += far * far
            reach = max(reach, max(0.0, lows[i]) + 2.0 * math.sqrt(spread))
        for a in range(3):
            lower[a] = box[a] - reach - 3.0 * least
            upper[a] = box[a + 3] + reach + 3.0 * least
    for a in range(3):
        if lower[a] >= upper[a]:
            return limit
        root[a], root[a + 3] = 0.5 * (lower[a] + upper[a]), 0.5 * (upper[a] - lower[a])
    # Echoes first, as they exclude most; sensors that the root box has nothing to do with are left out.
    reach = math.sqrt(root[3] * root[3] + root[4] * root[4] + root[5] * root[5])
    kept_sensors, kept_lows, kept_highs = np.empty_like(sensors), np.empty_like(lows), np.empty_like(lows)
    kept, echoes = 0, 0
    for silent in range(2):
        for i in range(len(lows)):
            if (highs[i] == math.inf) != (silent == 1) or (silent == 1 and lows[i] <= 0.0):
                continue
            if silent == 1:
                t, b = cone_coordinates(sensors[i], root[0], root[1], root[2])
                if sector_distance(t, b, lows[i]) > most + reach + 1e-5:
                    continue
            kept_sensors[kept], kept_lows[kept], kept_highs[kept] = sensors[i], lows[i], highs[i]
            kept += 1
            echoes += 1 - silent
    chosen = kept_sensors[:kept], kept_lows[:kept], kept_highs[:kept]
    task = (levels, values, box, points, chosen[0], chosen[1], chosen[2], least, most)
    smallest = SMALLEST_SINGLE if echoes == 1 else SMALLEST
    bound, _ = search(task, roots, np.zeros(1), np.zeros(1, np.int64), tolerance, smallest, MOST, found)
    return min(bound, limit)


@compiled
def _meet(sensor: Any, length: float, margin: float, lower: Any, upper: Any) -> None:
    """Cut a box down to what lies within ``margin`` of a sector."""
    for a in range(3):
        for sign in (-1.0, 1.0):
            # The cone's farthest direction along the axis is off it by their angle less the half one.
            cos = sign * sensor[3 + a]
            reach = 1.0
            if cos < sensor[6]:
                reach = cos * sensor[6] + math.sqrt(max(0.0, 1.0 - cos * cos)) * sensor[7]
            end = sensor[a] + sign * (length * max(0.0, reach) + margin)
            if sign < 0.0:
                lower[a] = max(lower[a], end)
            else:
                upper[a] = min(upper[a], end)

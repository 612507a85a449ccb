"""From readings to a bound, with a memory for the commonest patterns. Compiled: import lazily."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.link_table import compiled
from .bound_search import MOST, search

STEP = 2.5e-4  # [m]; single echoes are rounded to this, to the safe side
TOLERANCE = 3e-4  # [m]; of a search


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
    if low <= sensor[8]:
        low = 0.0
    return low, math.inf if silent else max(reading + error, sensor[8])


@compiled
def solve(link: Any, sensors: Any, lows: Any, highs: Any, radii: Any, found: Any) -> Any:
    """Return the bound for given sectors [m], inf where no ball is admissible.

    Args:
        link: Distance table: levels, values, box, near points.
        sensors: (k, 10).
        lows: (k,) [m].
        highs: (k,) [m].
        radii: (2,) least and greatest [m].
        found: (5,) gap, centre and radius of the ball found; written.
    """
    levels, values, box, points = link
    least, most = radii[0], radii[0]  # unseen, the least ball comes nearest, as it fits into any other
    root = np.empty(6)
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
            return math.inf
        root[a], root[a + 3] = 0.5 * (lower[a] + upper[a]), 0.5 * (upper[a] - lower[a])
    found[0] = math.inf
    task = (levels, values, box, points, sensors, lows, highs, least, most)
    bound, _ = search(task, root, TOLERANCE, MOST, found)
    return bound


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


@compiled
def bound_of(
    link: Any, sensors: Any, radii: Any, rules: Any, memory: Any, readings: Any, own: Any, found: Any
) -> Any:
    """Return the bound of one scan [m], inf where no ball is admissible.

    Args:
        link: As for ``solve``.
        sensors: (k, 10).
        radii: (2,) [m].
        rules: (3,) ε [m]; 1.0 for ``many`` obstacles, else 0; the silent bound, nan where not known yet [m].
        memory: (k, bins, 6) what was found for single echoes: bound (nan: not yet), and ``found``.
        readings: (k,) [m], inf for silence.
        own: (k,) which echoes are known to be the arm's.
        found: (5,) written: gap, centre, radius of the ball that attains it, to the search's tolerance.
    """
    error, many = rules[0], rules[1] != 0.0
    count, echoes, which = len(readings), 0, -1
    for i in range(count):
        if readings[i] < math.inf:
            echoes += 1
            which = i
    lows, highs = np.empty(count), np.empty(count)
    for i in range(count):
        lows[i], highs[i] = limits(sensors[i], readings[i], error)
        if many or own[i]:
            highs[i] = math.inf
    if echoes != 1 or own[which]:
        return solve(link, sensors, lows, highs, radii, found)
    place = int(readings[which] / STEP)
    if place >= memory.shape[1]:
        return solve(link, sensors, lows, highs, radii, found)
    kept = memory[which, place]
    if math.isnan(kept[0]):
        lows[which] = limits(sensors[which], place * STEP, error)[0]
        if not many:
            highs[which] = limits(sensors[which], (place + 1) * STEP, error)[1]
        bound = solve(link, sensors, lows, highs, radii, found)
        kept[1:] = found
        kept[0] = bound  # last: another thread may be reading
        return bound
    found[:] = kept[1:]
    return kept[0]


@compiled
def bounds_of(
    link: Any, sensors: Any, radii: Any, rules: Any, memory: Any, readings: Any, result: Any
) -> None:
    """Write the bounds of many scans, (n, k), into ``result``, (n,); nan where no ball is admissible."""
    found, own = np.empty(5), np.zeros(readings.shape[1], np.bool_)
    for n in range(len(readings)):
        silent = True
        for i in range(readings.shape[1]):
            silent = silent and readings[n, i] == math.inf
        if silent or (rules[1] != 0.0 and rules[2] == 0.0):
            result[n] = rules[2]
            continue
        bound = bound_of(link, sensors, radii, rules, memory, readings[n], own, found)
        result[n] = bound if bound < math.inf else math.nan

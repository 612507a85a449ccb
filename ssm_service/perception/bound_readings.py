"""From readings to a bound, with a memory for the commonest patterns. Compiled: import lazily."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.compiled import compiled
from ..model.link_table import squared_minus
from .bound_box import ROOM, look
from .bound_leaves import leaves_of, opened
from .bound_search import MOST, search
from .sectors import cone_coordinates, sector_distance

STEP = 2.5e-4  # [m]; single echoes are rounded to this, to the safe side
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
    if low <= sensor[8]:
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


@compiled
def explained(link: Any, sensors: Any, lows: Any, highs: Any, radii: Any, which: int, found: Any) -> Any:
    """Return whether an echo may be that of some ball: of one of a few likely ones, else of any.

    Args:
        link: As for ``solve``.
        sensors: (k, 10).
        lows: (k,) [m].
        highs: (k,) [m].
        radii: (2,) [m].
        which: The sensor.
        found: (5,) gap, centre and radius of the nearest ball so far; replaced by one that is nearer.
    """
    levels, values, box, points = link
    radius, s = radii[0], sensors[which]
    silent = np.full(len(lows), math.inf)
    silent[which] = highs[which]
    length = lows[which] + 2e-6 if lows[which] > 0.0 else highs[which]
    fits = False
    task = (levels, values, box, points, sensors, lows, silent, radius, radius)
    # Two directions square to the axis; the axis' least component gives a vector that is not along it.
    least = 3
    if abs(s[4]) < abs(s[least]):
        least = 4
    if abs(s[5]) < abs(s[least]):
        least = 5
    u, v = np.empty(3), np.empty(3)
    for a in range(3):
        u[a] = (1.0 if a + 3 == least else 0.0) - s[least] * s[3 + a]
    u /= math.sqrt(1.0 - s[least] * s[least])
    v[0] = s[4] * u[2] - s[5] * u[1]
    v[1] = s[5] * u[0] - s[3] * u[2]
    v[2] = s[3] * u[1] - s[4] * u[0]
    half = math.atan2(s[7], s[6])
    for n in range(17):
        # On the axis, then half way to the edge, then outside, where the ball touches the edge ray's end.
        off, far = 0.0, length - 1e-6 + radius
        if n > 8:
            far = math.hypot(length - 1e-6, radius - 1e-6)
            off = half + math.atan2(radius - 1e-6, length - 1e-6)
        elif n > 0:
            off = 0.5 * half
        turn = 0.25 * math.pi * n
        along, across = far * math.cos(off), far * math.sin(off)
        p, q = across * math.cos(turn), across * math.sin(turn)
        x = s[0] + along * s[3] + p * u[0] + q * v[0]
        y = s[1] + along * s[4] + p * u[1] + q * v[1]
        z = s[2] + along * s[5] + p * u[2] + q * v[2]
        g, h, e, _ = look(task, x, y, z, 0.0)
        if g >= radius and h <= radius + ROOM and e >= -ROOM:
            squared = squared_minus(levels, values, box, x, y, z) + (x * x + y * y + z * z)
            if squared >= radius * radius:
                fits = True
                gap = math.sqrt(squared) - radius
                if gap < found[0]:
                    found[0], found[1], found[2], found[3], found[4] = gap, x, y, z, radius
    return fits or solve(link, sensors, lows, silent, radii, math.inf, math.inf, np.empty(5)) < math.inf


@compiled
def hidden(
    link: Any, leaves: Any, sensors: Any, lows: Any, highs: Any, radii: Any, silent: float, found: Any
) -> Any:
    """Return the bound where another ball than those of the echoes may hide; inf where one is not explained.

    The least ball comes nearest, and it meets no sector up to the reading. Where it is nearer than the silent
    bound, some silence would have excluded it: only boxes are left where that of no silent sensor does. And
    each echo must be that of some ball.

    Args:
        link: As for ``solve``.
        leaves: What ``leaves_of`` returned, and ``free``.
        sensors: (k, 10).
        lows: (k,) [m].
        highs: (k,) of echoes to be explained, else inf [m].
        radii: (2,) [m].
        silent: The silent bound [m].
        found: (5,) written; the gap inf where the silent bound stands.
    """
    boxes, keys, masks, free = leaves
    levels, values, box, points = link
    found[:] = math.inf
    found[0] = silent
    for i in range(len(lows)):
        if highs[i] < math.inf and not explained(link, sensors, lows, highs, radii, i, found):
            return math.inf
    order = opened(masks, keys, lows, free, found[0])
    # Echoes first: what opened a box is what may exclude it yet.
    echoes = np.argsort(lows - free)
    none = np.full(len(lows), math.inf)
    task = (levels, values, box, points, sensors[echoes], lows[echoes], none, radii[0], radii[0])
    bound, _ = search(task, boxes, keys, order, TOLERANCE, SMALLEST, MOST, found)
    if found[1] == math.inf:
        found[0] = math.inf
    return min(bound, silent)


@compiled
def bound_of(
    link: Any,
    leaves: Any,
    sensors: Any,
    radii: Any,
    rules: Any,
    memory: Any,
    readings: Any,
    own: Any,
    found: Any,
) -> Any:
    """Return the bound of one scan [m], inf where no ball is admissible.

    Args:
        link: As for ``solve``.
        leaves: As for ``hidden``.
        sensors: (k, 10).
        radii: (2,) [m].
        rules: (3,) ε [m]; 1.0 for ``many`` obstacles, else 0; the silent bound, nan where not known yet [m].
        memory: (k, bins, 6) what was found for single echoes: bound (nan: not yet), and ``found``.
        readings: (k,) [m], inf for silence.
        own: (k,) which echoes are known to be the arm's.
        found: (5,) written: gap, centre, radius of the ball that attains it, to the search's tolerance.
    """
    error, silent = rules[0], rules[2]
    count, echoes, which, place = len(readings), 0, -1, -1
    for i in range(count):
        if readings[i] < math.inf:
            echoes += 1
            which = i
    if echoes == 1 and not own[which] and readings[which] < STEP * memory.shape[1]:
        place = int(readings[which] / STEP)
        kept = memory[which, place]
        if not math.isnan(kept[0]):
            found[:] = kept[1:]
            return kept[0]
    lows, highs, any_high = np.empty(count), np.empty(count), False
    for i in range(count):
        lows[i], highs[i] = limits(sensors[i], readings[i], error)
        if own[i]:
            highs[i] = math.inf
    if place >= 0:
        lows[which] = limits(sensors[which], place * STEP, error)[0]
        highs[which] = limits(sensors[which], (place + 1) * STEP, error)[1]
    for i in range(count):
        any_high = any_high or highs[i] < math.inf
    if not math.isnan(silent) and (rules[1] != 0.0 or not any_high):
        bound = hidden(link, leaves, sensors, lows, highs, radii, silent, found)
    else:
        bound = solve(link, sensors, lows, highs, radii, math.inf, TOLERANCE, found)
    if place >= 0:
        memory[which, place, 1:] = found
        memory[which, place, 0] = bound  # last: another thread may be reading
    return bound


@compiled
def prepare(link: Any, sensors: Any, radii: Any, rules: Any) -> Any:
    """Return ``leaves`` for ``bound_of``; none where the silent bound is not known or leaves no room."""
    free = np.empty(len(sensors))
    for i in range(len(sensors)):
        free[i] = limits(sensors[i], math.inf, rules[0])[0]
    silent = 0.0 if math.isnan(rules[2]) else rules[2]
    boxes, keys, masks = leaves_of(link, sensors, free, radii[0], silent)
    return boxes, keys, masks, free


@compiled
def bounds_of(
    link: Any, leaves: Any, sensors: Any, radii: Any, rules: Any, memory: Any, readings: Any, result: Any
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
        bound = bound_of(link, leaves, sensors, radii, rules, memory, readings[n], own, found)
        result[n] = bound if bound < math.inf else math.nan

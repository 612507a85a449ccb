"""Balls that hide from sensors whose echoes are others'. Compiled: import lazily."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.compiled import compiled
from ..model.link_table import squared_minus
from .bound_box import ROOM, look
from .bound_leaves import opened
from .bound_search import MOST, search
from .bound_solve import SMALLEST, TOLERANCE, solve


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

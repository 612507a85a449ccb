"""Bounds over one box of ball centres: what ``bound_search`` cuts by. Compiled: import lazily."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.compiled import compiled
from ..model.link_table import squared_minus, upper
from .sectors import cone_coordinates, ray_gradient, sector_distance, sector_gradient

ROOM = 1e-7  # [m]; a ball may reach this much into a sector that it should only graze: rounding
COLUMNS = 12  # constraints that a certificate weighs, at most
SWEEPS = 8  # of its coordinate descent


@compiled
def look(task: Any, x: float, y: float, z: float, reach: float) -> Any:
    """Return g (least distance from a sector to avoid), h (greatest from one to meet), e [m], and g's sensor.

    A ball that grazes the edge of a cone nearer than an echo's low touches both sectors, without being such
    an echo: the point where it comes nearest to the edge lies beyond low, t ≥ low. e is the least t − low.
    Where no ball with its centre within ``reach`` is admissible, h is inf.
    """
    _, _, _, _, sensors, lows, highs, radius_min, radius_max = task
    g, h, e, nearest = math.inf, 0.0, math.inf, -1
    for i in range(len(lows)):
        t, b = cone_coordinates(sensors[i], x, y, z)
        if lows[i] > 0.0:
            d = sector_distance(t, b, lows[i])
            if d < g:
                g, nearest = d, i
            if d + reach + ROOM < radius_min:
                return g, math.inf, e, nearest
        if highs[i] < math.inf:
            h = max(h, sector_distance(t, b, highs[i]))
            if lows[i] > 0.0:
                e = min(e, t - lows[i])
            if h - reach - ROOM > radius_max or e + reach + ROOM < 0.0:
                return g, math.inf, e, nearest
    return g, h, e, nearest


@compiled
def certificate(task: Any, m: Any, least: float, most: float, work: Any) -> Any:
    """Return a lower bound of the gap over a box, of second order in its size.

    For weights μ, λ ≥ 0 all admissible balls with centre in the box and R in [least, most] have

        D − R ≥ D + Σ μ (h_k − R) + Σ λ (R − g_i) + Σ ν (low_k − t_k) − R − room·(Σ μ + Σ λ + Σ ν).

    D ≥ √Q, with Q multilinear: the values of D² − |c|² at the corners, interpolated, and |c|² from below by
    its tangent. √Q, −g_i, −t_k and the tangents of the convex h_k are concave along each axis, so the least
    value over the box is that of a corner. The weights are those that nearly cancel the gradient in (c, R);
    any are valid.

    Args:
        task: See ``bound_search.search``.
        m: (6,) centre and half edges of the box [m].
        least: Bounds of R in the box [m].
        most: See least.
        work: (COLUMNS + 1, 8) scratch: gradient (4), value, weight, index, kind.
    """
    levels, values, box, _, sensors, lows, highs, radius_min, radius_max = task
    x, y, z = m[0], m[1], m[2]
    reach2 = m[3] * m[3] + m[4] * m[4] + m[5] * m[5]
    reach = math.sqrt(reach2)
    roots = work[COLUMNS]
    gx, gy, gz = 0.0, 0.0, 0.0
    for j in range(8):
        sx, sy, sz = 1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 1.0 - 0.5 * (j & 4)
        cx, cy, cz = x + sx * m[3], y + sy * m[4], z + sz * m[5]
        q = squared_minus(levels, values, box, cx, cy, cz) + (cx * cx + cy * cy + cz * cz)
        if q <= reach2:
            return 0.0
        roots[j] = math.sqrt(q - reach2)
        gx += sx * roots[j]
        gy += sy * roots[j]
        gz += sz * roots[j]
    # The gradient in (c, R) of D − R, and beside it those of the constraints that may hold with equality.
    e0, e1, e2, e3 = gx / (8.0 * m[3]), gy / (8.0 * m[4]), gz / (8.0 * m[5]), -1.0
    n = 0
    for i in range(len(lows)):
        if lows[i] > 0.0 and n < COLUMNS:
            d, dx, dy, dz = sector_gradient(sensors[i], lows[i], x, y, z)
            if d - reach < most:
                work[n, 0], work[n, 1], work[n, 2], work[n, 3] = -dx, -dy, -dz, 1.0
                work[n, 4], work[n, 5], work[n, 6], work[n, 7] = d, 0.0, i, 0.0
                n += 1
        if highs[i] < math.inf and n < COLUMNS:
            d, dx, dy, dz = sector_gradient(sensors[i], highs[i], x, y, z)
            if d + reach > least:
                work[n, 0], work[n, 1], work[n, 2], work[n, 3] = dx, dy, dz, -1.0
                work[n, 4], work[n, 5], work[n, 6], work[n, 7] = d, 0.0, i, 1.0
                n += 1
            if lows[i] > 0.0 and n < COLUMNS:
                t, dx, dy, dz = ray_gradient(sensors[i], x, y, z)
                if t - reach < lows[i]:
                    work[n, 0], work[n, 1], work[n, 2], work[n, 3] = -dx, -dy, -dz, 0.0
                    work[n, 4], work[n, 5], work[n, 6], work[n, 7] = t, 0.0, i, 2.0
                    n += 1
    for _ in range(SWEEPS):
        change = 0.0
        for k in range(n):
            c = work[k]
            # R's own bounds take up what pushes against them.
            r3 = e3
            if (r3 < 0.0 and most >= radius_max - 1e-12) or (r3 > 0.0 and least <= radius_min + 1e-12):
                r3 = 0.0
            own = 1.0 if r3 != 0.0 else 0.0
            size = c[0] * c[0] + c[1] * c[1] + c[2] * c[2] + own
            if size < 1e-12:
                continue
            step = -(e0 * c[0] + e1 * c[1] + e2 * c[2] + r3 * c[3]) / size
            step = max(step, -c[5])
            c[5] += step
            e0 += step * c[0]
            e1 += step * c[1]
            e2 += step * c[2]
            e3 += step * c[3]
            change = max(change, abs(step))
        if change < 1e-2:
            break
    best = math.inf
    for j in range(8):
        sx, sy, sz = 1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 1.0 - 0.5 * (j & 4)
        px, py, pz = sx * m[3], sy * m[4], sz * m[5]
        value = roots[j]
        for k in range(n):
            c = work[k]
            if c[5] > 0.0:
                if c[7] == 1.0:
                    value += c[5] * (c[4] + c[0] * px + c[1] * py + c[2] * pz)
                    continue
                i = int(c[6])
                t, b = cone_coordinates(sensors[i], x + px, y + py, z + pz)
                value += c[5] * (lows[i] - t if c[7] == 2.0 else -sector_distance(t, b, lows[i]))
        best = min(best, value)
    of_radius, weight = -1.0, 0.0
    for k in range(n):
        of_radius += work[k, 5] * work[k, 3]
        weight += work[k, 5]
    return best + of_radius * (least if of_radius > 0.0 else most) - ROOM * weight - 1e-9


@compiled
def excludes(sensor: Any, length: float, m: Any, radius: float) -> Any:
    """Return whether all balls of that radius with centre in a box meet the sector.

    The distance from a sector is convex, so that its greatest value is that of a corner.
    """
    for j in range(8):
        x, y, z = (
            m[0] + (1 - 2 * (j & 1)) * m[3],
            m[1] + (1 - (j & 2)) * m[4],
            m[2] + (1 - 0.5 * (j & 4)) * m[5],
        )
        t, b = cone_coordinates(sensor, x, y, z)
        if sector_distance(t, b, length) + ROOM >= radius:
            return False
    return True


@compiled
def box_bound(task: Any, m: Any, limit: float, work: Any, found: Any) -> Any:
    """Return a lower bound of the gap of the admissible balls with centre in a box; inf: there are none.

    Args:
        task: See ``bound_search.search``.
        m: (6,) centre and half edges of the box [m].
        limit: Bounds at or above it need not be made better [m].
        work: Scratch of ``certificate``.
        found: (5,) gap, centre and radius of the best ball so far; replaced by a better one.
    """
    levels, values, box, points, sensors, lows, _, radius_min, radius_max = task
    reach = math.sqrt(m[3] * m[3] + m[4] * m[4] + m[5] * m[5])
    x, y, z = m[0], m[1], m[2]
    g, h, e, nearest = look(task, x, y, z, reach)
    least = max(radius_min, h - reach - ROOM)
    most = min(radius_max, g + reach + ROOM)
    if least > most:
        return math.inf
    edge = min(m[3], min(m[4], m[5]))
    if (
        edge > 0.0
        and g + edge + ROOM < radius_min
        and excludes(sensors[nearest], lows[nearest], m, radius_min)
    ):
        return math.inf
    squared = squared_minus(levels, values, box, x, y, z) + (x * x + y * y + z * z)
    distance = math.sqrt(max(0.0, squared))
    if distance < radius_max:  # else D says nothing of R
        farthest = upper(levels, values, box, points, x, y, z)
        if farthest + reach < least:
            return math.inf
        most = min(most, farthest + reach)
    else:
        farthest = math.inf
    radius = min(min(radius_max, g + ROOM), farthest)
    if radius >= max(radius_min, h - ROOM) and e >= -ROOM:
        gap = max(0.0, distance - radius)
        if gap < found[0]:
            found[0], found[1], found[2], found[3], found[4] = gap, x, y, z, radius
    bound = max(0.0, distance - reach - most)
    # A box whose balls are all nearer must be cut on whatever a certificate says, unless it is of the last.
    worth = limit == math.inf or bound + 2.0 * reach >= limit or reach < 0.002
    if bound < limit and 0.0 < reach < 0.06 and worth:
        bound = max(bound, certificate(task, m, least, most, work))
    return bound


@compiled
def scratch() -> Any:
    """Return the scratch of ``certificate``."""
    return np.zeros((COLUMNS + 1, 8))

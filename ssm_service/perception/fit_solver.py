"""Levenberg–Marquardt for the ball of ``sphere_fit``, compiled with everything round it. Import lazily.

Why our own: MINPACK is what this should be. But SciPy reaches it only from Python, at 21 µs a start for
a problem of this size whose residuals cost nothing, and there are one to ten starts a scan; the whole fit
may take 40 µs. The tests hold this solver against ``scipy.optimize.least_squares`` on the same residuals.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from ..model.compiled import compiled
from ..model.link_table import squared_minus
from .fit_cost import AXIS, ORIGIN, SIDE, SIN, UP, UP_MEAN, residuals

MOST_STARTS: Final = 10
MOST_STEPS: Final = 60
RESULTS: Final = 10
"""Columns of a result: centre (3), distance, position (3), deviation of the distance, cost, iterations."""

_FEW_STEPS: Final = 10  # from each start; the best is then followed to its end
_STEP_M: Final = 1e-9  # a step this short ends the search
_GAIN: Final = 1e-14  # so does so small a share of the cost
_ASIDE: Final = 0.5  # of the beam's half-width: where balls are that the next sensor just sees
_SLOPE_M: Final = 1e-3  # half the base of the distance's gradient: the table is piecewise smooth


@compiled
def _normal(res: Any, jac: Any, H: Any, g: Any) -> None:
    """Write JᵀJ (3, 3) and Jᵀr (3,)."""
    for a in range(3):
        g[a] = 0.0
        for b in range(3):
            H[a, b] = 0.0
    for i in range(len(res)):
        for a in range(3):
            g[a] += jac[i, a] * res[i]
            for b in range(3):
                H[a, b] += jac[i, a] * jac[i, b]


@compiled
def _solve(H: Any, add: float, g: Any, s: Any) -> None:
    """Write s with (H + add·I) s = −g, by Cholesky."""
    l11 = math.sqrt(H[0, 0] + add)
    l21, l31 = H[1, 0] / l11, H[2, 0] / l11
    l22 = math.sqrt(max(H[1, 1] + add - l21 * l21, 1e-300))
    l32 = (H[2, 1] - l31 * l21) / l22
    l33 = math.sqrt(max(H[2, 2] + add - l31 * l31 - l32 * l32, 1e-300))
    z0 = -g[0] / l11
    z1 = (-g[1] - l21 * z0) / l22
    z2 = (-g[2] - l31 * z0 - l32 * z1) / l33
    s[2] = z2 / l33
    s[1] = (z1 - l32 * s[2]) / l22
    s[0] = (z0 - l21 * s[1] - l31 * s[2]) / l11


@compiled
def descend(x: Any, sensors: Any, m: Any, lead: int, R: float, w: Any, most: int) -> Any:
    """Move x (3,) to its local minimum, in at most ``most`` steps; return the cost and the steps taken."""
    rows = 2 * len(m) + 2
    res, jac, res_new, jac_new = np.empty(rows), np.empty((rows, 3)), np.empty(rows), np.empty((rows, 3))
    H, g, s, y = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    cost = residuals(x, sensors, m, lead, R, w, res, jac)
    _normal(res, jac, H, g)
    damping = 1e-3
    steps = 0
    while steps < most and damping < 1e12:
        steps += 1
        _solve(H, damping * (H[0, 0] + H[1, 1] + H[2, 2]), g, s)
        for a in range(3):
            y[a] = x[a] + s[a]
        new = residuals(y, sensors, m, lead, R, w, res_new, jac_new)
        length = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        if new < cost:
            gain = cost - new
            x[:], cost = y, new
            if gain <= _GAIN * cost or length <= _STEP_M:
                break
            res, jac, res_new, jac_new = res_new, jac_new, res, jac
            _normal(res, jac, H, g)
            damping = max(0.1 * damping, 1e-12)
        else:
            if length <= _STEP_M:
                break
            damping *= 8.0
    return cost, steps


@compiled
def starts(sensors: Any, m: Any, lead: int, R: float, w: Any, mirrored: bool, found: Any) -> int:
    """Write the starts into ``found`` (10, 3); return how many.

    On the axis of the least reading; and for each of the two next readings that look to the same side,
    half-way between the two, and in the least reading's beam but towards the other. Each of them on either
    side of the ring's plane, unless the sensors look alike to both.
    """
    count = 1
    half = (m[lead] + R) * sensors[lead, SIN] + R
    for a in range(3):
        found[0, a] = sensors[lead, ORIGIN + a] + (m[lead] + R) * sensors[lead, AXIS + a]
    last = lead
    for _ in range(2):
        other, least = -1, np.inf
        for i in range(len(m)):
            same = 0.0
            for a in range(3):
                same += sensors[i, AXIS + a] * sensors[lead, AXIS + a]
            if i != lead and i != last and m[i] < least and same > 0.0:
                other, least = i, m[i]
        if other < 0:
            break
        last = other
        size, side = 0.0, 0.0
        for a in range(3):
            size += (sensors[lead, AXIS + a] + sensors[other, AXIS + a]) ** 2
            side += sensors[other, AXIS + a] * sensors[lead, SIDE + a]
        aside = math.copysign(_ASIDE * half, side)
        reach = (0.5 * (m[lead] + least) + 0.7 * R) / math.sqrt(size)
        for a in range(3):
            middle = 0.5 * (sensors[lead, ORIGIN + a] + sensors[other, ORIGIN + a])
            found[count, a] = middle + reach * (sensors[lead, AXIS + a] + sensors[other, AXIS + a])
            found[count + 1, a] = found[0, a] + aside * sensors[lead, SIDE + a]
        count += 2
    rise = w[UP_MEAN] * half
    for i in range(count):
        for a in range(3):
            found[count + i, a] = found[i, a] - rise * sensors[lead, UP + a]
            found[i, a] += rise * sensors[lead, UP + a]
    return count if mirrored else 2 * count


@compiled
def _distance(levels: Any, values: Any, box: Any, x: float, y: float, z: float) -> float:
    return math.sqrt(max(0.0, squared_minus(levels, values, box, x, y, z) + (x * x + y * y + z * z)))


@compiled
def _place(x: Any, R: float, levels: Any, values: Any, box: Any, slope: Any, out: Any) -> None:
    """Write the distance, the nearest point and the centre's distance's unit gradient (3,)."""
    h = _SLOPE_M
    d = _distance(levels, values, box, x[0], x[1], x[2])
    size = 0.0
    for a in range(3):
        u, v, t = h * (a == 0), h * (a == 1), h * (a == 2)
        slope[a] = _distance(levels, values, box, x[0] + u, x[1] + v, x[2] + t) - _distance(
            levels, values, box, x[0] - u, x[1] - v, x[2] - t
        )
        size += slope[a] * slope[a]
    scale = 1.0 / math.sqrt(size) if size > 0.0 else 0.0
    out[3] = max(0.0, d - R)
    for a in range(3):
        slope[a] *= scale
        out[4 + a] = x[a] - min(R, d) * slope[a]


@compiled
def _deviation(x: Any, sensors: Any, m: Any, lead: int, R: float, w: Any, ratios: Any, slope: Any) -> float:
    """Return √(nᵀ H⁻¹ Jᵀ W J H⁻¹ n): W holds the residuals' variances (``ratios``)."""
    k = len(m)
    rows = 2 * k + 2
    res, jac, H, g, s = np.empty(rows), np.empty((rows, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    residuals(x, sensors, m, lead, R, w, res, jac)
    _normal(res, jac, H, g)
    _solve(H, 1e-9 * (H[0, 0] + H[1, 1] + H[2, 2]), -slope, s)
    variance = 0.0
    for i in range(rows):
        if i >= 2 * k:
            ratio = ratios[2 + i - 2 * k]
        else:
            ratio = ratios[0] if i % 2 == 0 and m[i // 2] < np.inf else ratios[1]
        part = jac[i, 0] * s[0] + jac[i, 1] * s[1] + jac[i, 2] * s[2]
        variance += ratio * part * part
    return math.sqrt(variance)


@compiled
def fit_one(
    sensors: Any,
    m: Any,
    R: float,
    w: Any,
    ratios: Any,
    mirrored: bool,
    levels: Any,
    values: Any,
    box: Any,
    out: Any,
) -> None:
    """Fit one scan into ``out`` (10,): NaN where no sensor has an echo."""
    lead, least = -1, np.inf
    for i in range(len(m)):
        if m[i] < least:
            lead, least = i, m[i]
    out[:] = np.nan
    if lead < 0:
        return
    found = np.empty((MOST_STARTS, 3))
    best, steps = np.inf, 0
    for i in range(starts(sensors, m, lead, R, w, mirrored, found)):
        cost, taken = descend(found[i], sensors, m, lead, R, w, _FEW_STEPS)
        steps += taken
        if cost < best:
            best = cost
            out[:3] = found[i]
    best, taken = descend(out[:3], sensors, m, lead, R, w, MOST_STEPS)
    steps += taken
    slope = np.empty(3)
    _place(out[:3], R, levels, values, box, slope, out)
    out[7] = _deviation(out[:3], sensors, m, lead, R, w, ratios, slope)
    out[8], out[9] = best, steps


@compiled
def fit_many(
    sensors: Any,
    M: Any,
    R: float,
    w: Any,
    ratios: Any,
    mirrored: bool,
    levels: Any,
    values: Any,
    box: Any,
    out: Any,
) -> None:
    """Fit each row of M (n, k) into the same row of ``out`` (n, 10)."""
    for i in range(len(M)):
        fit_one(sensors, M[i], R, w, ratios, mirrored, levels, values, box, out[i])

"""What ``sphere_fit`` minimises: how ill a ball agrees with readings, silences and what is likely beforehand.

Compiled; import this module lazily. All lengths in m, the link's frame. One row of a sensor table is

    origin (3), sensing axis (3), up (3), side (3), cos α, sin α, least range, greatest range

with ``up`` square to the sensing axis, as near to the ring's axis as can be, and ``side`` square to both.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from ..model.compiled import compiled

ORIGIN: Final = 0
AXIS: Final = 3
UP: Final = 6
SIDE: Final = 9
COS: Final = 12
SIN: Final = 13
RANGE_MIN: Final = 14
RANGE_MAX: Final = 15
COLUMNS: Final = 16

# Places of ``FitWeights`` in the array that the compiled functions take.
READING, FARTHER, SILENCE, DOUBT, MISS, MISSED, UP_MEAN, UP_STD, SIDE_STD = range(9)

_EDGE: Final = (
    0.97  # share of R by which a ball may reach over the edge before its reading is carried on linearly
)
_ROUND: Final = 0.04  # share of the beam's half-width over which |up| is rounded at 0


@compiled
def _view(s: Any, x: Any) -> Any:
    """Return b, t, c and the gradients of b, t and c (each x, y, z) of a ball's centre x for one sensor.

    t runs along the cone's nearest edge ray, b square to it, negative inside the cone; c is the distance from
    the apex.
    """
    px, py, pz = x[0] - s[0], x[1] - s[1], x[2] - s[2]
    along = px * s[3] + py * s[4] + pz * s[5]
    qx, qy, qz = px - along * s[3], py - along * s[4], pz - along * s[5]
    off = math.sqrt(qx * qx + qy * qy + qz * qz)
    c = math.sqrt(px * px + py * py + pz * pz)
    per_off = 1.0 / off if off > 1e-12 else 0.0
    per_c = 1.0 / c if c > 1e-12 else 0.0
    qx, qy, qz = qx * per_off, qy * per_off, qz * per_off
    cos, sin = s[12], s[13]
    return (
        off * cos - along * sin,
        along * cos + off * sin,
        c,
        (qx * cos - s[3] * sin, qy * cos - s[4] * sin, qz * cos - s[5] * sin),
        (s[3] * cos + qx * sin, s[4] * cos + qy * sin, s[5] * cos + qz * sin),
        (px * per_c, py * per_c, pz * per_c),
    )


@compiled
def _reading(view: Any, radius: float) -> Any:
    """Return the reading of the ball and its gradient: the closed form, carried on linearly past the edge."""
    b, t, c, db, dt, dc = view
    if b <= 0.0:
        return c - radius, dc
    reach = min(b, _EDGE * radius)
    root = math.sqrt(radius * radius - reach * reach)
    slope = reach / root
    gradient = (dt[0] + slope * db[0], dt[1] + slope * db[1], dt[2] + slope * db[2])
    return t - root + slope * (b - reach), gradient


@compiled
def _outside(view: Any) -> Any:
    """Return how far the centre is from the cone, negative inside it, and the gradient."""
    b, t, c, db, _, dc = view
    if t > 0.0:
        return b, db
    return c, dc


@compiled
def _soft(r: float, limit: float) -> Any:
    """Return r / √(1 + (r / limit)²), which never passes ``limit``, and its derivative."""
    u = 1.0 / math.sqrt(1.0 + (r / limit) * (r / limit))
    return r * u, u * u * u


@compiled
def _write(res: Any, jac: Any, row: int, value: float, factor: float, gradient: Any) -> None:
    res[row] = value
    jac[row, 0], jac[row, 1], jac[row, 2] = factor * gradient[0], factor * gradient[1], factor * gradient[2]


@compiled
def _echo(res: Any, jac: Any, row: int, s: Any, view: Any, m: float, leads: bool, R: float, w: Any) -> None:
    """Write two rows: the reading's error, and how far the ball is from reaching into the cone at all.

    An echo from farther than the ball, or where the ball is not, may come from another part of the obstacle,
    so these two are bounded; except those of the least reading, which the ball has to explain.
    """
    h, dh = _reading(view, R)
    e, de = _outside(view)
    r, factor = (h - m) / w[READING], 1.0 / w[READING]
    if r < 0.0 and m <= s[RANGE_MIN]:
        r, factor = 0.0, 0.0  # what is nearer than the least range reads as the least range
    elif r > 0.0 and not leads:
        r, slope = _soft(r, w[FARTHER])
        factor *= slope
    elif r < 0.0 and not leads and (R - e) / w[SILENCE] < -r:
        # The ball would be seen nearer than anything was: moving out of the cone is the lesser change.
        r, factor = -max(0.0, R - e) / w[SILENCE], 1.0 / w[SILENCE] if e < R else 0.0
        dh = de
    _write(res, jac, row, r, factor, dh)
    u, factor = max(0.0, e - R) / w[MISS], 1.0 / w[MISS] if e > R else 0.0
    if not leads:
        u, slope = _soft(u, w[MISSED])
        factor *= slope
    _write(res, jac, row + 1, u, factor, de)


@compiled
def _silence(res: Any, jac: Any, row: int, s: Any, view: Any, R: float, w: Any) -> None:
    """Write two rows: by how much the ball would have to move to be unseen, and nothing."""
    h, dh = _reading(view, R)
    e, de = _outside(view)
    u, factor, gradient = R - e, -1.0 / w[SILENCE], de
    if s[RANGE_MAX] - h < u:
        u, gradient = s[RANGE_MAX] - h, dh
    if u <= 0.0:
        u, factor = 0.0, 0.0
    r, slope = _soft(u / w[SILENCE], w[DOUBT])
    _write(res, jac, row, r, factor * slope, gradient)
    _write(res, jac, row + 1, 0.0, 0.0, gradient)


@compiled
def _priors(res: Any, jac: Any, row: int, s: Any, x: Any, m: float, R: float, w: Any) -> None:
    """Write two rows: where in the beam of the least reading a ball is likely to be."""
    px, py, pz = x[0] - s[0], x[1] - s[1], x[2] - s[2]
    half = (m + R) * s[SIN] + R
    up = px * s[6] + py * s[7] + pz * s[8]
    side = px * s[9] + py * s[10] + pz * s[11]
    size = math.sqrt(up * up + (_ROUND * half) * (_ROUND * half))
    factor = 1.0 / (w[UP_STD] * half)
    _write(res, jac, row, (size - w[UP_MEAN] * half) * factor, factor * up / size, (s[6], s[7], s[8]))
    factor = 1.0 / (w[SIDE_STD] * half)
    _write(res, jac, row + 1, side * factor, factor, (s[9], s[10], s[11]))


@compiled
def residuals(x: Any, sensors: Any, m: Any, lead: int, R: float, w: Any, res: Any, jac: Any) -> float:
    """Write the residuals and their Jacobian for a ball at x; return the sum of squares.

    Args:
        x: (3,) centre [m].
        sensors: (k, 16) sensor table.
        m: (k,) readings [m], inf for silence.
        lead: Index of the least reading.
        R: Radius [m].
        w: (9,) weights.
        res: (2k + 2,) written.
        jac: (2k + 2, 3) written [1/m].
    """
    k = len(m)
    for i in range(k):
        view = _view(sensors[i], x)
        if m[i] < np.inf:
            _echo(res, jac, 2 * i, sensors[i], view, m[i], i == lead, R, w)
        else:
            _silence(res, jac, 2 * i, sensors[i], view, R, w)
    _priors(res, jac, 2 * k, sensors[lead], x, m[lead], R, w)
    total = 0.0
    for i in range(2 * k + 2):
        total += res[i] * res[i]
    return total

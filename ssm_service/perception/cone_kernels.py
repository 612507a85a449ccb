"""Readings of balls, capsules and triangles in closed form or by a convex line search, one at a time.

All take the shape relative to the sensor's face (the apex) in any frame, the sensing direction as a unit
vector of that frame, and the cosine and sine of the cone's half angle α < 90°. ``inf`` is no echo, however
far the range.
"""

from __future__ import annotations

import math
from typing import Final

from ..model.compiled import compiled

INFINITY: Final = math.inf
_GOLDEN: Final = 0.5 * (math.sqrt(5.0) - 1.0)
_STEPS: Final = 52  # 0.618^52 = 1.4e-11 of the segment; the reading is flat at its least value
_SLACK: Final = 1e-12  # rounding that counts as touching, relative to the lengths at hand


@compiled
def ball_in_cone(x: float, off_axis: float, radius: float, cos: float, sin: float) -> float:
    """Return the reading of a ball whose centre lies at ``x`` along the axis and ``off_axis`` beside it.

    The closed form of ``reading.sphere_readings``.
    """
    gap = math.sqrt(x * x + off_axis * off_axis) - radius
    if gap <= 0.0:
        return 0.0
    beside = off_axis * cos - x * sin
    if beside <= 0.0:
        return gap
    along = x * cos + off_axis * sin
    if beside > radius or along <= 0.0:
        return INFINITY
    return gap * (gap + 2.0 * radius) / (along + math.sqrt(max(radius * radius - beside * beside, 0.0)))


@compiled
def _beyond(x: float, off_axis: float, radius: float, cos: float, sin: float) -> float:
    """Return by how much a ball misses the cone [m], 0 where it does not."""
    along = x * cos + off_axis * sin
    away = math.sqrt(x * x + off_axis * off_axis) if along <= 0.0 else off_axis * cos - x * sin
    return max(away - radius, 0.0)


@compiled
def capsule_in_cone(
    px: float, py: float, pz: float, qx: float, qy: float, qz: float, radius: float,
    ux: float, uy: float, uz: float, cos: float, sin: float,
) -> float:  # fmt: skip
    """Return the reading of the balls of ``radius`` round all points of the segment from p to q.

    The reading of a ball is convex in its centre where there is one, and so is the distance by which it
    misses the cone: along the segment (miss, reading) has one valley in dictionary order, and a golden
    section finds it.
    """
    ex, ey, ez = qx - px, qy - py, qz - pz
    # Along the segment, s from 0 to 1: x = x0 + s·x1, and c² = c0 + 2·s·c1 + s²·c2.
    x0, x1 = px * ux + py * uy + pz * uz, ex * ux + ey * uy + ez * uz
    # Off the axis, as vectors: the difference c² − x² would cancel.
    ox, oy, oz = px - x0 * ux, py - x0 * uy, pz - x0 * uz
    fx, fy, fz = ex - x1 * ux, ey - x1 * uy, ez - x1 * uz
    length2 = ex * ex + ey * ey + ez * ez
    s = 0.0
    if length2 > 0.0:
        s = min(max(-(px * ex + py * ey + pz * ez) / length2, 0.0), 1.0)
    x = x0 + s * x1
    off = math.sqrt((ox + s * fx) ** 2 + (oy + s * fy) ** 2 + (oz + s * fz) ** 2)
    best = ball_in_cone(x, off, radius, cos, sin)
    if best == 0.0 or off * cos - x * sin <= 0.0:
        return best  # the capsule's nearest point is in the cone
    low, high = 0.0, 1.0
    a, b = 1.0 - _GOLDEN, _GOLDEN
    miss_a, read_a, miss_b, read_b = -1.0, 0.0, -1.0, 0.0
    for end in (0.0, 1.0):
        x = x0 + end * x1
        off = math.sqrt((ox + end * fx) ** 2 + (oy + end * fy) ** 2 + (oz + end * fz) ** 2)
        best = min(best, ball_in_cone(x, off, radius, cos, sin))
    for _ in range(_STEPS):
        if miss_a < 0.0:
            x = x0 + a * x1
            off = math.sqrt((ox + a * fx) ** 2 + (oy + a * fy) ** 2 + (oz + a * fz) ** 2)
            miss_a, read_a = _beyond(x, off, radius, cos, sin), ball_in_cone(x, off, radius, cos, sin)
            best = min(best, read_a)
        if miss_b < 0.0:
            x = x0 + b * x1
            off = math.sqrt((ox + b * fx) ** 2 + (oy + b * fy) ** 2 + (oz + b * fz) ** 2)
            miss_b, read_b = _beyond(x, off, radius, cos, sin), ball_in_cone(x, off, radius, cos, sin)
            best = min(best, read_b)
        if miss_a < miss_b or (miss_a == miss_b and read_a <= read_b):
            high, b, miss_b, read_b = b, a, miss_a, read_a
            a, miss_a = high - _GOLDEN * (high - low), -1.0
        else:
            low, a, miss_a, read_a = a, b, miss_b, read_b
            b, miss_b = low + _GOLDEN * (high - low), -1.0
    return best


@compiled
def _edge_in_cone(
    ax: float, ay: float, az: float, ex: float, ey: float, ez: float,
    ux: float, uy: float, uz: float, cos: float, best: float,
) -> float:  # fmt: skip
    """Return the least distance of the part of a + s·e, 0 ≤ s ≤ 1, in the cone, or a lesser ``best``."""
    ee = ex * ex + ey * ey + ez * ez
    ae = ax * ex + ay * ey + az * ez
    aa = ax * ax + ay * ay + az * az
    au, eu = ax * ux + ay * uy + az * uz, ex * ux + ey * uy + ez * uz
    s = min(max(-ae / ee, 0.0), 1.0) if ee > 0.0 else 0.0
    least = math.sqrt((ax + s * ex) ** 2 + (ay + s * ey) ** 2 + (az + s * ez) ** 2)
    if least >= best:
        return best
    if au + s * eu >= cos * least - _SLACK:
        return least
    c2 = cos * cos
    # Where it crosses (p·u)² = cos²α·p²: A·s² + 2·B·s + C = 0.
    A, B, C = eu * eu - c2 * ee, au * eu - c2 * ae, au * au - c2 * aa
    disc = B * B - A * C
    if disc < 0.0:
        if disc < -1e-14 * (B * B + abs(A * C)):
            return best
        disc = 0.0
    q = -(B + math.copysign(math.sqrt(disc), B))
    for k in range(2):
        s = q / A if k == 0 else C / q
        if -_SLACK <= s <= 1.0 + _SLACK and au + s * eu >= 0.0:
            best = min(best, math.sqrt(max(aa + s * (2.0 * ae + s * ee), 0.0)))
    return best


@compiled
def _holds(
    nx: float, ny: float, nz: float, ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float, x: float, y: float, z: float,
) -> bool:  # fmt: skip
    """Return whether the triangle a, b, c with normal n = (b − a) × (c − a) holds a point of its plane."""
    slack = -_SLACK * (nx * nx + ny * ny + nz * nz)
    for k in range(3):
        if k == 0:
            sx, sy, sz, ex, ey, ez = ax, ay, az, bx - ax, by - ay, bz - az
        elif k == 1:
            sx, sy, sz, ex, ey, ez = bx, by, bz, cx - bx, cy - by, cz - bz
        else:
            sx, sy, sz, ex, ey, ez = cx, cy, cz, ax - cx, ay - cy, az - cz
        wx, wy, wz = x - sx, y - sy, z - sz
        if nx * (ey * wz - ez * wy) + ny * (ez * wx - ex * wz) + nz * (ex * wy - ey * wx) < slack:
            return False
    return True


@compiled
def triangle_in_cone(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float, cz: float,
    ux: float, uy: float, uz: float, cos: float, sin: float, best: float, front: bool,
) -> float:  # fmt: skip
    """Return the reading of the triangle a, b, c, or ``best`` if that is less.

    The nearest point of triangle and cone is one of these: the apex's projection to the plane; the nearest
    point of an edge; a point where an edge crosses the cone's mantle; a point where the distance along the
    mantle's curve in the plane is stationary, which lies in the direction in which the normal leans from
    the axis, or against it.

    With ``front``, a triangle counts only if the apex is on the side to which (b − a) × (c − a) points.
    """
    fx, fy, fz, gx, gy, gz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    nx, ny, nz = fy * gz - fz * gy, fz * gx - fx * gz, fx * gy - fy * gx
    nn = nx * nx + ny * ny + nz * nz
    h = nx * ax + ny * ay + nz * az
    if (front and h >= 0.0) or h * h >= best * best * nn > 0.0:
        return best
    if nn > 0.0:
        t = h / nn
        x, y, z = t * nx, t * ny, t * nz
        distance = abs(t) * math.sqrt(nn)
        in_cone = x * ux + y * uy + z * uz >= cos * distance - _SLACK
        if in_cone and _holds(nx, ny, nz, ax, ay, az, bx, by, bz, cx, cy, cz, x, y, z):
            return distance  # below best: checked above
        nu = nx * ux + ny * uy + nz * uz
        lx, ly, lz = nx - nu * ux, ny - nu * uy, nz - nu * uz
        lean = math.sqrt(lx * lx + ly * ly + lz * lz)
        if lean > 0.0:
            for k in range(2):
                side = (sin if k == 0 else -sin) / lean
                dx, dy, dz = cos * ux + side * lx, cos * uy + side * ly, cos * uz + side * lz
                t = h / (nx * dx + ny * dy + nz * dz)
                if 0.0 <= t < best and _holds(
                    nx, ny, nz, ax, ay, az, bx, by, bz, cx, cy, cz, t * dx, t * dy, t * dz
                ):
                    best = t
    best = _edge_in_cone(ax, ay, az, fx, fy, fz, ux, uy, uz, cos, best)
    best = _edge_in_cone(bx, by, bz, cx - bx, cy - by, cz - bz, ux, uy, uz, cos, best)
    return _edge_in_cone(cx, cy, cz, -gx, -gy, -gz, ux, uy, uz, cos, best)


@compiled
def box_in_cone(
    hx: float, hy: float, hz: float, ax: float, ay: float, az: float,
    ux: float, uy: float, uz: float, cos: float, sin: float,
) -> float:  # fmt: skip
    """Return the reading of a box with these half edges; apex a and sensing direction u are in its frame.

    Only the faces whose outer side faces the apex can hold the nearest point.
    """
    half, a = (hx, hy, hz), (ax, ay, az)
    x = min(max(ax, -hx), hx) - ax
    y = min(max(ay, -hy), hy) - ay
    z = min(max(az, -hz), hz) - az
    nearest = math.sqrt(x * x + y * y + z * z)
    if x * ux + y * uy + z * uz >= cos * nearest - _SLACK:
        return nearest
    best = INFINITY
    for axis in range(3):
        if abs(a[axis]) <= half[axis]:
            continue
        face = math.copysign(half[axis], a[axis])
        for sign in (1.0, -1.0):  # two triangles: three corners of the face, without one or the other
            if axis == 0:
                best = triangle_in_cone(
                    face - ax, -hy - ay, hz - az, face - ax, hy - ay, -hz - az,
                    face - ax, sign * hy - ay, sign * hz - az, ux, uy, uz, cos, sin, best, False,
                )  # fmt: skip
            elif axis == 1:
                best = triangle_in_cone(
                    -hx - ax, face - ay, hz - az, hx - ax, face - ay, -hz - az,
                    sign * hx - ax, face - ay, sign * hz - az, ux, uy, uz, cos, sin, best, False,
                )  # fmt: skip
            else:
                best = triangle_in_cone(
                    -hx - ax, hy - ay, face - az, hx - ax, -hy - ay, face - az,
                    sign * hx - ax, sign * hy - ay, face - az, ux, uy, uz, cos, sin, best, False,
                )  # fmt: skip
    return best

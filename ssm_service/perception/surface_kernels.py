"""Readings of the arm's own links: capsules, or the triangles of a mesh in a tree of balls."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import compiled
from .cone_kernels import ball_in_cone, capsule_in_cone, triangle_in_cone


@compiled
def read_surface(
    T_base_bodies: NDArray[np.float64],
    sensor_bodies: NDArray[np.intp],
    T_body_sensors: NDArray[np.float64],
    half_angles: NDArray[np.float64],
    bodies: NDArray[np.intp],
    roots: NDArray[np.intp],
    capsules: NDArray[np.float64],
    balls: NDArray[np.float64],
    nodes: NDArray[np.intp],
    corners: NDArray[np.float64],
    rigid: bool,
    out: NDArray[np.float64],
) -> None:
    """Lower ``out`` (m,) to the readings of what is (``rigid``) or is not rigidly joined to the sensor."""
    stack = np.empty(128, dtype=np.intp)
    for sensor in range(len(out)):
        cos, sin = math.cos(half_angles[sensor]), math.sin(half_angles[sensor])
        T, local = T_base_bodies[sensor_bodies[sensor]], T_body_sensors[sensor]
        apex, look = np.empty(3), np.empty(3)
        for i in range(3):
            look[i] = T[i, 0] * local[0, 0] + T[i, 1] * local[1, 0] + T[i, 2] * local[2, 0]
            apex[i] = T[i, 0] * local[0, 3] + T[i, 1] * local[1, 3] + T[i, 2] * local[2, 3] + T[i, 3]
        for body in range(len(bodies)):
            if (bodies[body] == sensor_bodies[sensor]) != rigid:
                continue
            T = T_base_bodies[bodies[body]]
            a, u = np.empty(3), np.empty(3)  # apex and sensing direction in the body's frame
            for i in range(3):
                a[i] = u[i] = 0.0
                for j in range(3):
                    a[i] += T[j, i] * (apex[j] - T[j, 3])
                    u[i] += T[j, i] * look[j]
            if roots[body] < 0:
                out[sensor] = min(out[sensor], _capsule(capsules[body], a, u, cos, sin, rigid))
            else:
                out[sensor] = _tree(
                    roots[body], balls, nodes, corners, stack, a, u, cos, sin, out[sensor], rigid
                )


@compiled
def _capsule(
    capsule: NDArray[np.float64],
    a: NDArray[np.float64],
    u: NDArray[np.float64],
    cos: float,
    sin: float,
    front: bool,
) -> float:
    px, py, pz = capsule[0] - a[0], capsule[1] - a[1], capsule[2] - a[2]
    qx, qy, qz = capsule[3] - a[0], capsule[4] - a[1], capsule[5] - a[2]
    reading = capsule_in_cone(px, py, pz, qx, qy, qz, capsule[6], u[0], u[1], u[2], cos, sin)
    return math.inf if front and reading == 0.0 else reading


@compiled
def _node(
    ball: NDArray[np.float64], a: NDArray[np.float64], u: NDArray[np.float64], cos: float, sin: float
) -> float:
    """Return the reading of a node's ball: nothing in the node reads less."""
    x, y, z = ball[0] - a[0], ball[1] - a[1], ball[2] - a[2]
    along = x * u[0] + y * u[1] + z * u[2]
    off = math.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
    return ball_in_cone(along, off, ball[3], cos, sin)


@compiled
def _tree(
    root: int,
    balls: NDArray[np.float64],
    nodes: NDArray[np.intp],
    corners: NDArray[np.float64],
    stack: NDArray[np.intp],
    a: NDArray[np.float64],
    u: NDArray[np.float64],
    cos: float,
    sin: float,
    best: float,
    front: bool,
) -> float:
    """Return the least reading of a tree's triangles, or ``best`` if that is less."""
    stack[0], height = root, 1
    while height > 0:
        height -= 1
        node = stack[height]
        if not _node(balls[node], a, u, cos, sin) < best:
            continue
        left, right = nodes[node, 0], nodes[node, 1]
        if left < 0:
            for i in range(-1 - left, right):
                c = corners[i]
                best = triangle_in_cone(
                    c[0] - a[0], c[1] - a[1], c[2] - a[2], c[3] - a[0], c[4] - a[1], c[5] - a[2],
                    c[6] - a[0], c[7] - a[1], c[8] - a[2], u[0], u[1], u[2], cos, sin, best, front,
                )  # fmt: skip
            continue
        if _node(balls[left], a, u, cos, sin) < _node(balls[right], a, u, cos, sin):
            left, right = right, left  # the nearer one is taken up first
        stack[height], stack[height + 1] = left, right
        height += 2
    return best

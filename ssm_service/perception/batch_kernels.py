"""Readings of many shapes by many sensors, each shape in each cone (``cone_kernels``)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import compiled
from .cone_kernels import ball_in_cone, box_in_cone, capsule_in_cone


@compiled
def read_spheres(
    centres: NDArray[np.float64],
    radii: NDArray[np.float64],
    apexes: NDArray[np.float64],
    looks: NDArray[np.float64],
    cos: NDArray[np.float64],
    sin: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Fill ``out`` (N, k) with the readings of N balls by k sensors."""
    for n in range(len(centres)):
        for k in range(len(apexes)):
            u = looks[k]
            x, y, z = centres[n, 0] - apexes[k, 0], centres[n, 1] - apexes[k, 1], centres[n, 2] - apexes[k, 2]
            along = x * u[0] + y * u[1] + z * u[2]
            x, y, z = x - along * u[0], y - along * u[1], z - along * u[2]
            out[n, k] = ball_in_cone(along, math.sqrt(x * x + y * y + z * z), radii[n], cos[k], sin[k])


@compiled
def read_capsules(
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    radii: NDArray[np.float64],
    apexes: NDArray[np.float64],
    looks: NDArray[np.float64],
    cos: NDArray[np.float64],
    sin: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Fill ``out`` (N, k) with the readings of N capsules by k sensors."""
    for n in range(len(starts)):
        p, q = starts[n], ends[n]
        for k in range(len(apexes)):
            a, u = apexes[k], looks[k]
            out[n, k] = capsule_in_cone(
                p[0] - a[0], p[1] - a[1], p[2] - a[2], q[0] - a[0], q[1] - a[1], q[2] - a[2], radii[n],
                u[0], u[1], u[2], cos[k], sin[k],
            )  # fmt: skip


@compiled
def read_boxes(
    centres: NDArray[np.float64],
    rotations: NDArray[np.float64],
    halves: NDArray[np.float64],
    apexes: NDArray[np.float64],
    looks: NDArray[np.float64],
    cos: NDArray[np.float64],
    sin: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Fill ``out`` (N, k) with the readings of N boxes by k sensors."""
    a, u = np.empty(3), np.empty(3)
    for n in range(len(centres)):
        h, R = halves[n], rotations[n]
        for k in range(len(apexes)):
            for i in range(3):
                a[i] = u[i] = 0.0
                for j in range(3):
                    a[i] += R[j, i] * (apexes[k, j] - centres[n, j])
                    u[i] += R[j, i] * looks[k, j]
            out[n, k] = box_in_cone(h[0], h[1], h[2], a[0], a[1], a[2], u[0], u[1], u[2], cos[k], sin[k])

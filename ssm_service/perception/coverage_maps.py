"""Maps of what a link's sensors see: in a ring's plane, and over the link's whole surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..model import Ring
from .coverage_link import SensedLink

Array = NDArray[np.float64]

_STEP_M: Final = 0.005


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PolarMap:
    """How many sensors see a ball in a ring's plane.

    Attributes:
        bearings: (m,) from the ring's sensor 1 [rad].
        gaps: (k,) from the cylinder on which the sensors sit [m].
        counts: (k, m).
    """

    bearings: Array
    gaps: Array
    counts: NDArray[np.int64]


def polar_map(
    link: SensedLink, ring: Ring, transform_ring_to_link: Array, radius: float, limit: float
) -> PolarMap:
    """Count the sensors that see balls of ``radius`` [m] in a ring's plane, out to ``limit`` [m]."""
    bearings = np.linspace(0.0, 2.0 * np.pi, 721)
    gaps = np.linspace(0.0, limit, 201)
    rho = ring.radius + radius + gaps[:, np.newaxis]
    local = np.stack([rho * np.cos(bearings), rho * np.sin(bearings), np.zeros((201, 721))], axis=-1)
    centres = local.reshape(-1, 3) @ transform_ring_to_link[:3, :3].T + transform_ring_to_link[:3, 3]
    counts = link.cones.counts(centres, np.array([radius]))[0]
    return PolarMap(bearings=bearings, gaps=gaps, counts=counts.reshape(201, 721))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfaceMap:
    """A link's surface, unrolled about its long axis: from every point of a core segment, square to it.

    At either end of the segment follow the directions of a half sphere. Values are taken every 5 mm along
    each ray: pictures, not proofs.

    Attributes:
        places: (k,) of the foot point along the link's long axis [m].
        elevations: (k,) of the rays out of the plane across that axis [rad]; 0 along the segment.
        bearings: (m,) about the axis [rad], from the link's next axis (x for z, y for x, z for y).
        largest: (k, m) radius of the largest ball that touches the link unseen on the ray [m].
        gaps: (k, m) least gap of an unseen ball of the given radius on the ray [m]; infinite where none is.
    """

    places: Array
    elevations: Array
    bearings: Array
    largest: Array
    gaps: Array


def surface_map(link: SensedLink, radius: float, limit: float) -> SurfaceMap:
    """Map how a link is guarded against balls of ``radius`` [m], out to gaps of ``limit`` [m]."""
    rotation, foot, places, elevations = _core(link)
    bearings = np.linspace(0.0, 2.0 * np.pi, 145)
    cos, sin = np.cos(elevations)[:, np.newaxis], np.sin(elevations)[:, np.newaxis]
    local = np.stack(
        [cos * np.cos(bearings), cos * np.sin(bearings), np.broadcast_to(sin, (len(places), 145))], axis=-1
    )
    directions = (local @ rotation.T).reshape(-1, 3)
    feet = np.repeat(foot, 145, axis=0)
    largest = np.zeros(len(directions))
    gaps = np.full(len(directions), np.inf)
    for reach in np.arange(_STEP_M, limit + radius + float(np.ptp(link.points, axis=0).max()), _STEP_M):
        centres = feet + reach * directions
        unseen = link.cones.least_distances(centres)
        near, far = link.distances(centres)
        middle = 0.5 * (near + far)
        largest = np.where((unseen > far) & (near <= limit), np.maximum(largest, near), largest)
        hit = (unseen > radius) & (middle >= radius) & (middle <= radius + limit)
        gaps = np.where(hit, np.minimum(gaps, middle - radius), gaps)
    shape = len(places), 145
    return SurfaceMap(
        places=places,
        elevations=elevations,
        bearings=bearings,
        largest=largest.reshape(shape),
        gaps=gaps.reshape(shape),
    )


def long_axis(link: SensedLink) -> int:
    """Return the index of the link's longest axis."""
    return int(np.argmax(link.body.box[3:] - link.body.box[:3]))


def axes_about(axis: int) -> Array:
    """Return the rotation (3, 3) whose columns are the next two axes and the given one."""
    return np.eye(3)[:, [(axis + 1) % 3, (axis + 2) % 3, axis]]


def _core(link: SensedLink) -> tuple[Array, Array, Array, Array]:
    """Return the map's rotation, the rays' foot points (k, 3), their places (k,) and elevations (k,)."""
    axis = long_axis(link)
    rotation = axes_about(axis)
    lower, upper = link.body.box[:3], link.body.box[3:]
    middle, spans = 0.5 * (lower + upper), upper - lower
    inset = 0.5 * min(float(np.delete(spans, axis).max()), 0.9 * float(spans[axis]))
    first, last = lower[axis] + inset, upper[axis] - inset
    side = np.linspace(first, last, max(2, round((last - first) / _STEP_M) + 1))
    cap = np.linspace(0.0, 0.5 * np.pi, 19)[1:]
    places = np.concatenate([np.full(18, first), side, np.full(18, last)])
    elevations = np.concatenate([-cap[::-1], np.zeros(len(side)), cap])
    feet = np.tile(middle, (len(places), 1))
    feet[:, axis] = places
    return rotation, feet, places, elevations

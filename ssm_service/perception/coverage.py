"""What the sensors of one link see and do not see of balls: all numbers of ``ssm coverage`` for one link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..model import Ring, SensorArray
from .coverage_gap import ClearDistance, LargestUnseen, clear_distance, largest_unseen
from .coverage_link import SensedLink, sensed_link, sensed_links
from .coverage_maps import PolarMap, SurfaceMap, polar_map, surface_map
from .coverage_search import FIELDS_OF_VIEW_DEG, Plan, PlannedRing, SearchResult, plan_count, search
from .coverage_shares import SeenShares, place_shares, ring_shares

Array = NDArray[np.float64]

LARGEST_BALL_M: Final = 0.5
"""Radius beyond which nobody asks whether a ball is seen."""

AXIAL_M: Final = 0.1
"""Balls round a ring lie within ± this of its plane (SCIENCE 3)."""

_FINER: Final = 4.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkCoverage:
    """What one link's sensors see of balls of one radius.

    Attributes:
        link: The link and its sensors.
        ring: Its ring that looks most squarely outwards: that of the shares below.
        clear: Greatest gap up to which every ball is seen.
        largest: The largest ball that can touch the link unseen.
        places: Shares of all places round the link, by the gap to its real surface.
        plane: Shares of the bearings in the ring's plane, by the gap to the ring's cylinder.
        band: Likewise, of bearings and axial offsets within ± ``AXIAL_M``.
    """

    link: SensedLink
    ring: Ring
    clear: ClearDistance
    largest: LargestUnseen
    places: SeenShares
    plane: SeenShares
    band: SeenShares


def link_coverage(
    link: SensedLink, array: SensorArray, radius: float, distance: float, resolution: float = 0.004
) -> LinkCoverage:
    """Compute what the sensors of a link see.

    Args:
        link: The link with its sensors.
        array: Where its rings are.
        radius: Of the balls [m].
        distance: Gap that matters [m].
        resolution: Least edge of the boxes that the shares are made of [m]; bounds shrink with it.

    Raises:
        InputError: ``out_of_range``.
    """
    ring, transform = main_ring(array)
    return LinkCoverage(
        link=link,
        ring=ring,
        clear=proved_clear_distance(link, radius, distance),
        largest=largest_unseen(link, LARGEST_BALL_M),
        places=place_shares(link, radius, gap_edges(distance), resolution),
        plane=ring_shares(link, ring, transform, radius, gap_edges(0.5), 0.0, 0.25 * resolution),
        band=ring_shares(link, ring, transform, radius, gap_edges(0.5), AXIAL_M, 0.5 * resolution),
    )


def proved_clear_distance(link: SensedLink, radius: float, distance: float) -> ClearDistance:
    """Return the clear distance out to the sensors' range; finer where it does not tell at ``distance`` [m].

    Raises:
        InputError: ``out_of_range``.
    """
    found = clear_distance(link, radius, max(distance, float(link.cones.reaches.max())))
    if found.lower < distance and (found.upper is None or found.upper > distance):
        finer = clear_distance(link, radius, distance, 0.002 / _FINER)
        if finer.lower > found.lower:
            return finer
    return found


def gap_edges(limit: float) -> Array:
    """Return the edges of the bins of gaps up to ``limit`` [m]: 0, 5 cm, and every 10 cm."""
    usual = [0.0, 0.05, *(0.1 * step for step in range(1, 100))]
    return np.array([edge for edge in usual if edge < limit - 1e-9] + [limit])


def main_ring(array: SensorArray) -> tuple[Ring, Array]:
    """Return the ring that looks most squarely outwards, and its transform to the link, (4, 4) [m]."""
    order = sorted(
        range(len(array.rings)), key=lambda i: (abs(array.rings[i].tilt), -array.rings[i].count, i)
    )
    index = order[0]
    ring = array.rings[index]
    first = sum(other.count for other in array.rings[:index])
    T_link_ring: Array = array.transforms_sensor_to_link[first] @ np.linalg.inv(
        ring.transform_sensors_to_ring[0]
    )
    return ring, T_link_ring


__all__ = [
    "AXIAL_M",
    "FIELDS_OF_VIEW_DEG",
    "LARGEST_BALL_M",
    "ClearDistance",
    "LargestUnseen",
    "LinkCoverage",
    "Plan",
    "PlannedRing",
    "PolarMap",
    "SearchResult",
    "SeenShares",
    "SensedLink",
    "SurfaceMap",
    "clear_distance",
    "gap_edges",
    "largest_unseen",
    "link_coverage",
    "main_ring",
    "place_shares",
    "plan_count",
    "polar_map",
    "proved_clear_distance",
    "ring_shares",
    "search",
    "sensed_link",
    "sensed_links",
    "surface_map",
]

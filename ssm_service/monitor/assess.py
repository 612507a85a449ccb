"""From what the sources say to the zone that this tick alone would give."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..config import SourcesConfig
from ..model import ClosestPair, Kinematics, Robot
from ..safety import SourceStatus, Zone, ZoneProfile, forces_stop
from .decision import Nearest, SourceReport

PERCEPTION = ("ranges", "obstacles")
"""The sources that say how near something is."""


class Assessment(Struct, frozen=True, kw_only=True, eq=False):
    """The zone of one tick alone, and why.

    Attributes:
        zone: See ``Decision.momentary_zone``.
        nearest: The nearest thing over all sources.
        sources: Every source's report.
        reasons: In the order in which they were found.
    """

    zone: Zone
    nearest: Nearest | None
    sources: dict[str, SourceReport]
    reasons: list[str]


def assess(
    profile: ZoneProfile,
    config: SourcesConfig,
    statuses: Sequence[SourceStatus],
    seen: Sequence[Nearest],
) -> Assessment:
    """Combine source states and distances into one zone; every unknown makes it more severe.

    Args:
        profile: The zone profile in force.
        config: The sources' configuration.
        statuses: One for each source.
        seen: What each fresh source of perception sees nearest, if it sees anything.
    """
    reasons: list[str] = []
    zone = Zone.GREEN
    distances = {thing.source: thing.distance for thing in seen}
    reports: dict[str, SourceReport] = {}
    for status in statuses:
        source = getattr(config, status.name)
        reports[status.name] = SourceReport(
            status=status, required=source.required, distance=distances.get(status.name)
        )
        if status.name != "target" and forces_stop(status, source):
            zone = Zone.STOP
            reasons.append(str(status.reason))
    nearest = min(seen, key=lambda thing: thing.distance, default=None)
    if nearest is not None:
        by_distance = profile.zone_at(nearest.distance)
        if by_distance is Zone.STOP:
            reasons.append("contact")
        elif by_distance is not Zone.GREEN:
            reasons.append("distance")
        zone = max(zone, by_distance)
    return Assessment(zone=zone, nearest=nearest, sources=reports, reasons=reasons)


def nearest_by_rings(robot: Robot, kinematics: Kinematics, ranges: NDArray[np.float64]) -> Nearest | None:
    """Return the least reading of all rings as the nearest thing: the estimator ``nearest``.

    Args:
        robot: The robot.
        kinematics: Its frames now.
        ranges: (m,), [m], ``inf`` for no echo.

    Returns:
        ``None`` where no sensor has an echo.
    """
    if not len(ranges):
        return None
    index = int(ranges.argmin())
    distance = float(ranges[index])
    if math.isinf(distance):
        return None
    ring = robot.ring_of_sensor[index]
    T_base_sensor = kinematics.transform_sensor_to_base(index)
    direction = T_base_sensor[:3, 0]
    return Nearest(
        source="ranges",
        link=ring.parent_frame,
        obstacle=None,
        distance=distance,
        point_on_link=T_base_sensor[:3, 3],
        point_on_obstacle=T_base_sensor[:3, 3] + distance * direction,
        normal=-direction,
    )


def nearest_by_obstacles(pair: ClosestPair | None) -> Nearest | None:
    """Return the exact closest pair as the nearest thing; ``None`` where nothing is there."""
    if pair is None:
        return None
    return Nearest(
        source="obstacles",
        link=pair.link,
        obstacle=pair.obstacle,
        distance=pair.distance,
        point_on_link=pair.point_on_link,
        point_on_obstacle=pair.point_on_obstacle,
        normal=pair.normal,
    )

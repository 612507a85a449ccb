"""The numbers of ``ssm coverage`` as plain values, in the order in which they are written."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .._version import __version__
from ..safety import SeparationLaw

if TYPE_CHECKING:
    from ..model import Robot
    from ..perception.coverage import LinkCoverage, SeenShares

ISOLATED = (
    "each link with its own sensors alone: no other link stands in a sensor's way, and none helps; "
    "with --position the arm's own links do stand in the way"
)
SEEN_BY = ("unseen", "by_one", "by_two", "by_more")


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """What the greatest speed depends on beside the sensors.

    Attributes:
        human_speed: v_h [m/s].
        reaction: Reaction time beside the scan [s].
        stopping_time: T_s [s]; None: the greatest of the robot file's.
    """

    human_speed: float
    reaction: float
    stopping_time: float | None


def numbers(
    robot: Robot,
    covered: Sequence[LinkCoverage],
    times: Times,
    *,
    distance: float,
    position: list[float] | None,
    resolution: float,
) -> dict[str, Any]:
    """Return the whole report."""
    assumptions = robot.config.file.assumptions
    links = [item.link.name for item in covered]
    return {
        "version": __version__,
        "robot": robot.name,
        "radius_m": covered[0].clear.radius,
        "distance_m": distance,
        "reading_error_m": assumptions.reading_error_m if assumptions is not None else 0.0,
        "position": position,
        "resolution_m": resolution,
        "assumes": ISOLATED,
        "sensors": robot.sensor_count,
        "links_without_sensors": [link for link in robot.monitored_links if link not in links],
        "links": {item.link.name: _link(robot, item, times, distance) for item in covered},
    }


def _link(robot: Robot, item: LinkCoverage, times: Times, distance: float) -> dict[str, Any]:
    array = next(array for array in robot.sensor_arrays if array.link == item.link.name)
    clear, largest = item.clear, item.largest
    return {
        "sensors": item.link.cones.count,
        "rings": [ring.name for ring in array.rings],
        "clear_distance": {
            "proved_m": clear.lower,
            "unseen_ball_at_m": clear.upper,
            "unseen_ball_centre_m": clear.witness,
            "looked_to_m": clear.limit,
            "no_blind_spot_to_distance": clear.lower >= distance,
        },
        "largest_unseen_touching_ball": {
            "at_least_m": largest.lower,
            "at_most_m": largest.upper if math.isfinite(largest.upper) else None,
            "looked_to_m": largest.cap,
        },
        "places_by_gap": _rows(item.places),
        "ring": item.ring.name,
        "ring_plane_by_gap": _rows(item.plane),
        "ring_band_by_gap": _rows(item.band),
        "speed": _speed(robot, item, times, max(ring.period for ring in array.rings)),
    }


def _rows(shares: SeenShares) -> list[dict[str, Any]]:
    rows = []
    for index in range(len(shares.shares)):
        row: dict[str, Any] = {"gap_m": shares.edges[index : index + 2].tolist()}
        for name, share, error in zip(SEEN_BY, shares.shares[index], shares.errors[index], strict=True):
            row[name] = {"share": float(share), "error": float(error)}
        rows.append(row)
    return rows


def _speed(robot: Robot, item: LinkCoverage, times: Times, period: float) -> dict[str, Any]:
    """Return the greatest closing speed that a silence justifies, by the proof and by the range alone."""
    stopping = robot.config.file.stopping
    T_s = times.stopping_time
    if T_s is None and stopping:
        T_s = max(joint.time_s for joint in stopping.values())
    found: dict[str, Any] = {
        "human_speed_m_s": times.human_speed,
        "scan_period_s": period,
        "reaction_time_s": period + times.reaction,
        "stopping_time_s": T_s,
        "range_m": float(item.link.cones.reaches.min()),
        "greatest_m_s": None,
        "greatest_if_nothing_were_unseen_m_s": None,
    }
    if T_s is not None:
        law = SeparationLaw(
            human_speed=times.human_speed, reaction_time=period + times.reaction, stopping_time=T_s
        )
        found["greatest_m_s"] = law.greatest_speed(min(item.clear.lower, found["range_m"]))
        found["greatest_if_nothing_were_unseen_m_s"] = law.greatest_speed(found["range_m"])
        found["standing_still_needs_m"] = law.terms(0.0).S_p
    return found

"""From what the sources say to the zone that this tick alone would give."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from msgspec import Struct

from ..config import SourcesConfig
from ..model import ClosestPair, Pairs
from ..safety import SourceStatus, Zone, ZoneProfile, forces_stop
from .decision import Comparison, Nearest, SourceReport
from .ranges import RangeReading

PERCEPTION = ("ranges", "obstacles")
"""The sources that say how near something is."""


class Assessment(Struct, frozen=True, kw_only=True, eq=False):
    """The zone of one tick alone, and why.

    Attributes:
        zone: See ``Decision.momentary_zone``.
        beside: What the zone would be if there were no separation.
        nearest: The nearest thing over all sources.
        sources: Every source's report.
        comparison: See ``Decision.comparison``.
        reasons: In the order in which they were found.
    """

    zone: Zone
    beside: Zone
    nearest: Nearest | None
    sources: dict[str, SourceReport]
    comparison: Comparison | None
    reasons: list[str]


class Seen(Struct, frozen=True, kw_only=True, eq=False):
    """What the fresh sources of perception say.

    Attributes:
        things: What each sees nearest, if it sees anything.
        reading: The scan; ``None`` without a fresh one.
        comparison: Both sources side by side; ``None`` unless both are fresh.
        pairs: Every monitored link with every tracked obstacle; ``None`` where nobody asked for them.
    """

    things: Sequence[Nearest] = ()
    reading: RangeReading | None = None
    comparison: Comparison | None = None
    pairs: Pairs | None = None


def assess(
    profile: ZoneProfile,
    config: SourcesConfig,
    statuses: Sequence[SourceStatus],
    seen: Seen,
    separation: Zone = Zone.GREEN,
) -> Assessment:
    """Combine source states and distances into one zone; every unknown makes it more severe.

    Args:
        profile: The zone profile in force.
        config: The sources' configuration.
        statuses: One for each source.
        seen: What the fresh sources of perception say.
        separation: The zone of the profile's separation.
    """
    reasons: list[str] = []
    zone = Zone.GREEN
    distances = {thing.source: thing.distance for thing in seen.things}
    reports: dict[str, SourceReport] = {}
    for status in statuses:
        source = getattr(config, status.name)
        reports[status.name] = SourceReport(
            status=status, required=source.required, distance=distances.get(status.name)
        )
        if status.name != "target" and forces_stop(status, source):
            zone = Zone.STOP
            reasons.append(str(status.reason))
    nearest = min(seen.things, key=lambda thing: thing.distance, default=None)
    if nearest is not None:
        by_distance = profile.zone_at(nearest.distance)
        unseen = nearest.source == "ranges" and seen.reading is not None and seen.reading.unseen
        if by_distance is Zone.STOP and unseen:
            reasons.append("uncovered")
        elif by_distance is Zone.STOP:
            reasons.append("contact")
        elif by_distance is not Zone.GREEN:
            reasons.append("distance")
        zone = max(zone, by_distance)
    if separation is not Zone.GREEN:
        reasons.append("separation")
    for word, worth in _doubts(profile, seen):
        if word not in reasons:
            reasons.append(word)
        zone = max(zone, worth)
    return Assessment(
        zone=max(zone, separation),
        beside=zone,
        nearest=nearest,
        sources=reports,
        comparison=seen.comparison,
        reasons=reasons,
    )


def _doubts(profile: ZoneProfile, seen: Seen) -> Iterator[tuple[str, Zone]]:
    """Give the reasons to believe less than the distances say, and the zone that each is worth at least.

    A tracker that is fresh looks everywhere, so that beside it no sector is uncovered. Readings that no
    admissible obstacle explains prove that the assumptions do not hold: nothing may be promised.
    """
    config, reading = profile.config, seen.reading
    if reading is not None:
        if reading.contradicted:
            yield "disagree", Zone.STOP
        if reading.uncovered and seen.comparison is None and config.uncovered != "off":
            yield "uncovered", Zone[config.uncovered.upper()]
    if seen.comparison is not None and seen.comparison.disagrees:
        yield "disagree", Zone[config.disagree_zone.upper()]


def compare(
    reading: RangeReading, exact: float | None, link: str, estimator: str, margin: float | None
) -> Comparison:
    """Put what the rings say of one link beside the exact distance of the tracked obstacles.

    The two contradict each other where a sensor sees something nearer than everything that is tracked, or
    where something tracked is nearer than the estimate.

    Args:
        reading: The scan.
        exact: Of the nearest tracked obstacle from the link [m]; ``None`` where nothing is tracked.
        link: The link.
        estimator: The profile's.
        margin: What may be between them [m]; ``None`` where nobody minds.
    """
    nearest = reading.nearest
    estimate = nearest.distance if nearest is not None and nearest.link == link else None
    # How deep a contact is, is not well defined: hulls and meshes tell it differently.
    tracked = math.inf if exact is None else max(exact, 0.0)
    disagrees = margin is not None and (
        tracked - reading.least.get(link, math.inf) > margin
        or (estimate is not None and estimate - tracked > margin)
    )
    return Comparison(
        link=link,
        estimator=estimator,
        estimate=estimate,
        exact=exact,
        difference=None if estimate is None or exact is None else estimate - exact,
        disagrees=disagrees,
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

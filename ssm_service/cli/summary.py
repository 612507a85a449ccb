"""Numbers of a recording: each one measured, ``null`` where there was nothing to measure."""

from __future__ import annotations

import itertools
from collections import Counter
from typing import Any, Final

from ..safety import Zone
from .limits import limits_obeyed
from .recording import Recording

BUSY_SHARE: Final = 0.002
"""Share of decisions with an overrun, a loss or a stop of the consumer's own that is called many."""

BUSY_COUNT: Final = 3
"""So many of them are never called many."""


def summarise(recording: Recording) -> dict[str, Any]:
    """Return the summary of a recording as plain values; times in s, distances in m, speeds in rad/s."""
    decisions = recording.decisions
    arrivals, service = _arrivals(recording), _service(recording)
    troubles = arrivals["lost"] + len(recording.stops) + (service["overruns"] if service else 0)
    return {
        "robot": recording.robot,
        "profile": recording.profile or None,
        "seconds": recording.seconds,
        "decisions": arrivals,
        "zones": zone_shares(recording),
        "zone_changes": sum(a.zone is not b.zone for a, b in itertools.pairwise(decisions)),
        "least_exact_distance_m": _least(row.exact for row in decisions),
        "least_estimated_distance_m": _least(row.estimated for row in decisions),
        "reasons": dict(Counter(reason for row in decisions for reason in row.reasons).most_common()),
        "joint_speed_limits": limits_obeyed(recording),
        "watchdog_stops": {
            "count": len(recording.stops),
            "seconds": sum(stop.end - stop.t for stop in recording.stops),
            "reasons": dict(Counter(reason for stop in recording.stops for reason in stop.reasons)),
        },
        "service": service,
        "machine_too_busy": troubles > max(BUSY_COUNT, BUSY_SHARE * len(decisions)),
    }


def zone_shares(recording: Recording) -> dict[str, float | None]:
    """Return each zone's share of the time: a decision holds until the next one arrives."""
    rows = recording.decisions
    times = dict.fromkeys(Zone, 0.0)
    for row, after in itertools.pairwise(rows):
        times[row.zone] += after.t - row.t
    total = sum(times.values())
    return {zone.word: times[zone] / total if total > 0.0 else None for zone in Zone}


def _arrivals(recording: Recording) -> dict[str, Any]:
    rows = recording.decisions
    steps = [b.seq - a.seq for a, b in itertools.pairwise(rows)]
    gaps = [b.t - a.t for a, b in itertools.pairwise(rows)]
    span = rows[-1].t - rows[0].t if rows else 0.0
    return {
        "received": len(rows),
        "mean_rate_hz": (len(rows) - 1) / span if span > 0.0 else None,
        "worst_gap_s": max(gaps, default=None),
        "sequence_gaps": sum(step != 1 for step in steps),
        "lost": sum(max(step - 1, 0) for step in steps),
        "refused": dict(recording.refused),
    }


def _service(recording: Recording) -> dict[str, Any] | None:
    if not recording.health:
        return None
    first, last = recording.health[0].health, recording.health[-1].health
    return {
        "version": last.version,
        "rate_hz": last.rate_hz,
        "ticks": last.ticks - first.ticks,
        "overruns": last.overruns - first.overruns,
        "skipped": last.skipped - first.skipped,
        "tick_us": last.tick_us,
        "lateness_us": last.lateness_us,
        "rejected": last.rejected,
        "warnings": last.warnings,
    }


def _least(distances: Any) -> float | None:
    return min((distance for distance in distances if distance is not None), default=None)

"""Numbers of a recording: each one measured, ``null`` where there was nothing to measure."""

from __future__ import annotations

import bisect
import itertools
from collections import Counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..safety import Zone
from .recording import Recording

TOLERANCE_RAD_S: Final = 1e-3
"""A measured joint speed this little above its limit counts as obeying it."""


def summarise(recording: Recording) -> dict[str, Any]:
    """Return the summary of a recording as plain values; times in s, distances in m, speeds in rad/s."""
    decisions = recording.decisions
    return {
        "robot": recording.robot,
        "profile": recording.profile or None,
        "seconds": recording.seconds,
        "decisions": _arrivals(recording),
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
        "service": _service(recording),
    }


def zone_shares(recording: Recording) -> dict[str, float | None]:
    """Return each zone's share of the time: a decision holds until the next one arrives."""
    rows = recording.decisions
    times = dict.fromkeys(Zone, 0.0)
    for row, after in itertools.pairwise(rows):
        times[row.zone] += after.t - row.t
    total = sum(times.values())
    return {zone.word: times[zone] / total if total > 0.0 else None for zone in Zone}


def limits_obeyed(recording: Recording) -> dict[str, Any]:
    """Compare every measured joint state with the limits that were known when it arrived.

    A zone that tightens takes effect at once, a joint slows down over some time; that time is not excused
    here, but shown: as the greatest excess and the longest time above a limit.
    """
    excess = speed_excess(recording)
    over = excess > TOLERANCE_RAD_S
    times = np.array([row.t for row in recording.joints])
    return {
        "joint_states": len(excess),
        "obeyed_share": float(np.mean(~over)) if len(excess) else None,
        "greatest_excess_rad_s": max(float(excess.max()), 0.0) if len(excess) else None,
        "tolerance_rad_s": TOLERANCE_RAD_S,
        "longest_excess_s": _longest_run(times[-len(excess) :], over) if len(excess) else None,
        "commands": len(recording.commands),
        "commands_within_share": _commands_within(recording),
    }


def speed_excess(recording: Recording) -> NDArray[np.float64]:
    """Return by how much the worst joint of each joint state is above its limit, (k,), [rad/s].

    Joint states that came before the first decision are left out.
    """
    arrivals = [row.t for row in recording.decisions]
    excess = []
    for state in recording.joints:
        index = bisect.bisect_right(arrivals, state.t) - 1
        if index >= 0:
            limit = recording.decisions[index].limit
            excess.append(max(abs(v) - top for v, top in zip(state.velocity, limit, strict=True)))
    return np.array(excess, dtype=np.float64)


def _commands_within(recording: Recording) -> float | None:
    limits = {row.seq: row.limit for row in recording.decisions}
    within = [
        all(abs(v) <= top + 1e-9 for v, top in zip(row.velocity, limits[row.seq], strict=True))
        for row in recording.commands
        if row.seq in limits
    ]
    return sum(within) / len(within) if within else None


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


def _longest_run(times: NDArray[np.float64], flags: NDArray[np.bool_]) -> float:
    longest, began = 0.0, None
    for t, flag in zip(times.tolist(), flags.tolist(), strict=True):
        if began is not None:
            longest = max(longest, t - began)
        if not flag:
            began = None
        elif began is None:
            began = t
    return longest

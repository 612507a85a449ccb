"""Commands and measured joint speeds against the limits in force, as numbers."""

from __future__ import annotations

import bisect
import itertools
import math
from typing import Any, Final, NamedTuple

from .recording import DecisionRow, Recording

TOLERANCE_RAD_S: Final = 1e-3
"""A measured joint speed this little above its limit counts as within it."""

BRAKING_WINDOW_S: Final = 0.3
"""For so long after a joint's limit fell, a speed above it is put down to braking [s]."""


class Excess(NamedTuple):
    """A measured speed above its limit.

    Attributes:
        above: By how much [rad/s].
        since_fall: Time since this joint's limit last fell [s]; infinite where it never did.
    """

    above: float
    since_fall: float

    @property
    def braking(self) -> bool:
        """Whether the limit had just fallen."""
        return self.since_fall <= BRAKING_WINDOW_S


def limits_obeyed(recording: Recording) -> dict[str, Any]:
    """Compare commands with the limits sent with them, and joint states with the limits known by then.

    A limit that falls takes effect at once, an arm slows down over some time. What was measured above a limit
    that had just fallen is therefore counted apart from what was measured above one that had not. Where the
    profile limits by direction (``directed``), the limits are those that are safe in any direction, and
    moving away may be faster.
    """
    states = measured_excess(recording)
    above = [excess for excesses in states for excess in excesses]
    braking = [excess for excess in above if excess.braking]
    otherwise = [excess for excess in above if not excess.braking]
    within = sum(not excesses for excesses in states)
    return {
        "directed": recording.directed,
        "commands": len(recording.commands),
        "commands_within_share": _commands_within(recording),
        "joint_states": len(states),
        "joint_states_within_share": within / len(states) if states else None,
        "above_a_limit_that_had_just_fallen": {
            "joint_states": sum(any(excess.braking for excess in excesses) for excesses in states),
            "longest_after_the_fall_s": max((excess.since_fall for excess in braking), default=None),
            "greatest_excess_rad_s": max((excess.above for excess in braking), default=None),
        },
        "above_a_limit_otherwise": {
            "joint_states": sum(any(not excess.braking for excess in excesses) for excesses in states),
            "greatest_excess_rad_s": max((excess.above for excess in otherwise), default=None),
        },
        "just_fallen_s": BRAKING_WINDOW_S,
        "tolerance_rad_s": TOLERANCE_RAD_S,
    }


def measured_excess(recording: Recording) -> list[list[Excess]]:
    """Return what of each joint state is above its limit; states before the first decision are left out."""
    falls = _falls(recording.decisions)
    arrivals = [row.t for row in recording.decisions]
    found = []
    for state in recording.joints:
        index = bisect.bisect_right(arrivals, state.t) - 1
        if index < 0:
            continue
        limit = recording.decisions[index].limit
        found.append(
            [
                Excess(abs(speed) - top, _since(falls[joint], state.t))
                for joint, (speed, top) in enumerate(zip(state.velocity, limit, strict=True))
                if abs(speed) - top > TOLERANCE_RAD_S
            ]
        )
    return found


def _falls(decisions: list[DecisionRow]) -> list[list[float]]:
    """Return for each joint the times at which its limit fell [s], rising."""
    falls: list[list[float]] = [[] for _ in (decisions[0].limit if decisions else ())]
    for before, after in itertools.pairwise(decisions):
        if before.limit == after.limit:
            continue
        for joint, (old, new) in enumerate(zip(before.limit, after.limit, strict=True)):
            if new < old:
                falls[joint].append(after.t)
    return falls


def _since(times: list[float], now: float) -> float:
    index = bisect.bisect_right(times, now) - 1
    return now - times[index] if index >= 0 else math.inf


def _commands_within(recording: Recording) -> float | None:
    limits = {row.seq: row.limit for row in recording.decisions}
    within = [
        all(abs(v) <= top + 1e-9 for v, top in zip(row.velocity, limits[row.seq], strict=True))
        for row in recording.commands
        if row.seq in limits
    ]
    return sum(within) / len(within) if within else None

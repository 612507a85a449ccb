"""What one tick decides."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..safety import SourceStatus, Zone
from .separated import Separated


class Nearest(Struct, frozen=True, kw_only=True, eq=False):
    """The nearest thing of one source, in the base frame.

    Attributes:
        source: ``ranges`` or ``obstacles``.
        link: The URDF link (for ``ranges``: the ring's parent frame).
        obstacle: The obstacle's id; ``None`` for ``ranges``, which cannot know it.
        distance: [m] from the link's surface; at or below 0 is contact.
        point_on_link: (3,), [m].
        point_on_obstacle: (3,), [m].
        normal: (3,), unit, from the obstacle to the link.
    """

    source: str
    link: str
    obstacle: str | None
    distance: float
    point_on_link: NDArray[np.float64]
    point_on_obstacle: NDArray[np.float64]
    normal: NDArray[np.float64]


class Comparison(Struct, frozen=True, kw_only=True, eq=False):
    """What the rings say beside what is tracked, of one link, as of the newest message of either.

    Attributes:
        link: The link that the estimate is of.
        estimator: The profile's estimator.
        estimate: [m]; ``None`` where it says nothing.
        exact: [m] to the nearest tracked obstacle; ``None`` where nothing is tracked or the link is not
            monitored.
        difference: ``estimate - exact`` [m]; above 0 the rings think the obstacle farther than it is.
        disagrees: Whether the two contradict each other by more than the profile allows.
    """

    link: str
    estimator: str
    estimate: float | None
    exact: float | None
    difference: float | None
    disagrees: bool


class SourceReport(Struct, frozen=True, kw_only=True, eq=False):
    """One source as this tick saw it.

    Attributes:
        status: Its state and age.
        required: As configured.
        distance: [m] what this source alone says; ``None`` if it saw nothing or says nothing of distance.
    """

    status: SourceStatus
    required: bool
    distance: float | None


class Decision(Struct, frozen=True, kw_only=True, eq=False):
    """Zone, limits and command of one tick, all from the same snapshot.

    Attributes:
        tick: Number of the tick, rising by 1.
        zone: The zone in force.
        momentary_zone: What this tick alone would give; never more severe than ``zone``.
        distance: [m] the least over all sources; ``None`` where nothing was seen.
        nearest: The nearest thing; ``None`` where nothing was seen.
        sources: Every source's report, by name.
        comparison: The rings beside the tracked obstacles; ``None`` unless both are fresh.
        speed_limit: (n,), [rad/s], by joint: safe in any direction.
        speed_scaling: 0 to 1.
        velocity: (n,), [rad/s], the command.
        reasons: Fixed words; empty in an undisturbed green with a target.
        position: (n,), the joint position that all this was computed for, or ``None``.
        separation: Every pair's protective separation; ``None`` where the profile has none, or nobody knows
            where the robot is.
    """

    tick: int
    zone: Zone
    momentary_zone: Zone
    distance: float | None
    nearest: Nearest | None
    sources: dict[str, SourceReport]
    comparison: Comparison | None
    speed_limit: NDArray[np.float64]
    speed_scaling: float
    velocity: NDArray[np.float64]
    reasons: tuple[str, ...]
    position: NDArray[np.float64] | None
    separation: Separated | None = None

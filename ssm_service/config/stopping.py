"""How the robot stops, and how long it takes to begin to."""

from __future__ import annotations

import itertools
from typing import Annotated

from .section import Section, described


class StoppingPoint(Section, frozen=True, kw_only=True):
    """How one joint stops from one speed."""

    speed_rad_s: Annotated[float, described("speed from which it stops", "rad/s or m/s", gt=0.0, le=100.0)]
    time_s: Annotated[float, described("stopping time from that speed", "s", gt=0.0, le=10.0)]
    distance_rad: Annotated[
        float, described("stopping distance from that speed", "rad or m", gt=0.0, le=100.0)
    ]


class StoppingConfig(Section, frozen=True, kw_only=True):
    """How one joint stops from its greatest speed, by the maker's data (worst load and extension)."""

    speed_rad_s: Annotated[float, described("speed from which it stops", "rad/s or m/s", gt=0.0, le=100.0)]
    time_s: Annotated[float, described("stopping time from that speed", "s", gt=0.0, le=10.0)]
    distance_rad: Annotated[
        float, described("stopping distance from that speed", "rad or m", gt=0.0, le=100.0)
    ]
    slower: Annotated[
        list[StoppingPoint],
        described(
            "the same from lower speeds, in rising order; left out: the one above holds for all speeds"
        ),
    ] = []

    def __post_init__(self) -> None:
        points: list[StoppingPoint | StoppingConfig] = [*self.slower, self]
        for before, after in itertools.pairwise(points):
            if not before.speed_rad_s < after.speed_rad_s:
                raise ValueError(
                    "`slower` must be in rising order of `speed_rad_s`, all below the table's own"
                )
            if before.time_s > after.time_s:
                raise ValueError("`slower` must not have a longer `time_s` at a lower speed")
            if before.distance_rad * after.speed_rad_s > after.distance_rad * before.speed_rad_s * (1 + 1e-9):
                raise ValueError(
                    "`slower` must not have more `distance_rad` per `speed_rad_s` at a lower speed"
                )


class ReactionConfig(Section, frozen=True, kw_only=True):
    """Parts of the reaction time that the service cannot measure, or not always."""

    robot_s: Annotated[
        float,
        described(
            "the robot's own: from the arrival of a command to the beginning of the stop", "s", ge=0.0, le=5.0
        ),
    ] = 0.1
    transport_s: Annotated[
        float,
        described(
            "from the service to the robot, at least: "
            "a longer one that a consumer's echo shows takes its place",
            "s",
            ge=0.0,
            le=5.0,
        ),
    ] = 0.02

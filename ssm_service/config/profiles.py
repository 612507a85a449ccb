"""Zone profiles: by steps of distance, by the separation equation, or by both."""

from __future__ import annotations

from typing import Annotated, Literal

from .section import Section, described


class ZoneConfig(Section, frozen=True, kw_only=True):
    """One zone that slows the robot. Red is nearer than yellow and never faster."""

    distance_m: Annotated[
        float, described("the zone holds up to and including this distance", "m", gt=0.0, le=100.0)
    ]
    joint_speed_rad_s: Annotated[
        float, described("speed limit of every joint in this zone", "rad/s or m/s", gt=0.0, le=100.0)
    ]
    speed_scaling: Annotated[float, described("speed scaling told to consumers", None, gt=0.0, le=1.0)]


class SeparationConfig(Section, frozen=True, kw_only=True):
    """The protective separation distance ([TS15066] 5.5.4): what it assumes of people and of measurements."""

    human_speed_m_s: Annotated[
        float,
        described("v_h: speed at which people are taken to come near ([ISO13855])", "m/s", gt=0.0, le=10.0),
    ] = 1.6
    tracked_velocity: Annotated[
        bool, described("true: where a tracker says an obstacle's velocity, its speed takes the place of v_h")
    ] = False
    human_speed_floor_m_s: Annotated[
        float, described("what a tracked speed counts at least", "m/s", gt=0.0, le=10.0)
    ] = 0.25
    intrusion_m: Annotated[
        float,
        described("C: how far a part of the body may reach in before it is noticed", "m", ge=0.0, le=10.0),
    ]
    human_uncertainty_m: Annotated[
        float,
        described(
            "Z_d: uncertainty of a tracked position (a ring's `accuracy_m` where that is greater)",
            "m",
            ge=0.0,
            le=10.0,
        ),
    ]
    robot_uncertainty_m: Annotated[
        float, described("Z_r: uncertainty of the robot's own position", "m", ge=0.0, le=10.0)
    ]
    red_scaling: Annotated[
        float,
        described(
            "the zone is red where less than this share of the joint speeds is admissible",
            None,
            gt=0.0,
            lt=1.0,
        ),
    ] = 0.25

    def __post_init__(self) -> None:
        if self.human_speed_floor_m_s > self.human_speed_m_s:
            raise ValueError("`human_speed_floor_m_s` must not be above `human_speed_m_s`")


class LatchConfig(Section, frozen=True, kw_only=True):
    """When errors of the network's integrity are taken for a broken network, and not for an accident."""

    interval_s: Annotated[
        float,
        described(
            "a second error within this time latches `stop` until a `reset`, also across a restart",
            "s",
            gt=0.0,
            le=1e6,
        ),
    ] = 3600.0


class ProfileConfig(Section, frozen=True, kw_only=True):
    """A zone profile: by distance in steps ([Kang2022] II-B-1), by the separation equation, or by both."""

    red: Annotated[ZoneConfig | None, described("the nearer zone; with `yellow`, or neither")] = None
    yellow: Annotated[ZoneConfig | None, described("the farther zone; beyond it is green")] = None
    separation: Annotated[
        SeparationConfig | None,
        described("speed and separation monitoring by the equation; left out: only distances count"),
    ] = None
    latch: Annotated[
        LatchConfig | None, described("stop for good after errors of integrity; left out: never")
    ] = None
    range_estimator: Annotated[
        Literal["nearest", "lower_bound"],
        described(
            "what the zone takes the readings for: the least reading, "
            "or the least distance that any admissible obstacle could have (needs `assumptions`)"
        ),
    ] = "nearest"
    uncovered: Annotated[
        Literal["off", "yellow", "red", "stop"],
        described(
            "zone, at least, while a ball of `assumptions.radius_min_m` could be within the yellow distance "
            "of a ring's link unseen and no other source looks; without `assumptions` nobody can tell"
        ),
    ] = "yellow"
    disagree_margin_m: (
        Annotated[
            float,
            described(
                "by how much rings and tracked obstacles may contradict each other before "
                "`disagree` is raised; left out: it never is",
                "m",
                ge=0.0,
                le=100.0,
            ),
        ]
        | None
    ) = None
    disagree_zone: Annotated[
        Literal["yellow", "red", "stop"], described("zone, at least, while they differ by more")
    ] = "red"
    recovery_ticks: Annotated[
        int, described("good ticks in a row before a zone becomes milder", "ticks", ge=1, le=100_000)
    ] = 25

    @property
    def edges(self) -> tuple[float, ...]:
        """Distances [m] up to which red and yellow reach, in this order; none without such steps."""
        return tuple([zone.distance_m for zone in (self.red, self.yellow) if zone is not None])

    def __post_init__(self) -> None:
        if (self.red is None) != (self.yellow is None):
            raise ValueError("`red` and `yellow` come together or not at all")
        if self.red is None or self.yellow is None:
            if self.separation is None:
                raise ValueError("`red` and `yellow`, or `separation`, or all of them must be there")
            return
        for key in ("distance_m", "joint_speed_rad_s", "speed_scaling"):
            if getattr(self.red, key) > getattr(self.yellow, key):
                raise ValueError(f"`red.{key}` must not be above `yellow.{key}`: nearer is never faster")
        if self.red.distance_m == self.yellow.distance_m:
            raise ValueError("`red.distance_m` must be below `yellow.distance_m`")

"""What a robot file may hold: every key with its type, unit, bounds, default and meaning.

The structures are frozen and know nothing of URDFs; whether a named joint, link or frame exists is
checked where the URDF is read (``ssm_service.model``). The reference page of all keys is generated
from this module (``ssm_service.config.reference``).
"""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct, field


def _meta(meaning: str, unit: str | None = None, **bounds: Any) -> Meta:
    return Meta(description=meaning, extra={"unit": unit or "–"}, **bounds)


Coordinate = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of every table in a robot file: frozen, no unknown keys."""


class JointsConfig(Section, frozen=True, kw_only=True):
    """Which joints do not move. Joints named nowhere are free; none may be named in both tables."""

    locked: Annotated[
        dict[str, float],
        _meta(
            "joints that stay in every message but that no command ever moves, and the position at which "
            "the simulated robot holds them",
            "rad or m",
        ),
    ] = {}
    fixed: Annotated[
        dict[str, float],
        _meta(
            "joints that are taken out of the model at this position and appear in no message "
            "(a gripper's fingers)",
            "rad or m",
        ),
    ] = {}


class SimulatedSensorConfig(Section, frozen=True, kw_only=True):
    """How the simulated sensors of a ring err. Everything is off by default."""

    noise_std_m: Annotated[float, _meta("standard deviation of Gaussian noise", "m", ge=0.0, le=1.0)] = 0.0
    bias_m: Annotated[float, _meta("constant offset of every reading", "m", ge=-1.0, le=1.0)] = 0.0
    resolution_m: Annotated[float, _meta("quantisation step; 0 is none", "m", ge=0.0, le=0.1)] = 0.0
    dropout_probability: Annotated[float, _meta("chance that an echo is lost", None, ge=0.0, le=1.0)] = 0.0
    latency_s: Annotated[float, _meta("delay from measurement to message", "s", ge=0.0, le=1.0)] = 0.0


class RingConfig(Section, frozen=True, kw_only=True):
    """One ring of range sensors round a link, evenly spaced, looking outwards; a file may hold several."""

    name: Annotated[str, _meta("name of the ring", None, min_length=1)]
    parent_frame: Annotated[
        str, _meta("URDF link (or other frame) that carries the ring", None, min_length=1)
    ]
    origin_m: Annotated[Vector3, _meta("centre of the ring in the parent frame", "m")]
    axis: Annotated[Vector3, _meta("the ring's axis in the parent frame; need not be of unit length")] = (
        0.0,
        0.0,
        1.0,
    )
    first_direction: Annotated[
        Vector3, _meta("sensing direction of sensor 1 in the parent frame, perpendicular to the axis")
    ] = (1.0, 0.0, 0.0)
    count: Annotated[int, _meta("number of sensors, evenly spaced about the axis", None, ge=1, le=64)]
    radius_m: Annotated[
        float,
        _meta("distance of the sensors from the axis: the radius of the link there", "m", gt=0.0, le=2.0),
    ]
    tilt_deg: Annotated[
        float,
        _meta(
            "elevation of the sensing directions out of the ring's plane, towards the axis",
            "deg",
            gt=-90.0,
            lt=90.0,
        ),
    ] = 0.0
    field_of_view_deg: Annotated[
        float, _meta("full opening angle of one sensor's cone", "deg", gt=0.0, lt=180.0)
    ]
    range_min_m: Annotated[float, _meta("least distance that the device resolves", "m", ge=0.0, le=100.0)] = (
        0.0
    )
    range_max_m: Annotated[
        float,
        _meta("greatest distance that the device reports; beyond it there is no echo", "m", gt=0.0, le=100.0),
    ]
    period_s: Annotated[float, _meta("time of one scan of all sensors", "s", gt=0.0, le=10.0)]
    accuracy_m: Annotated[
        float, _meta("greatest error of a reading that the maker states (±)", "m", ge=0.0, le=1.0)
    ] = 0.0
    simulated: Annotated[SimulatedSensorConfig, _meta("errors of the simulated sensors")] = (
        SimulatedSensorConfig()
    )

    def __post_init__(self) -> None:
        if self.range_min_m >= self.range_max_m:
            raise ValueError("`range_min_m` must be below `range_max_m`")
        norms = math.hypot(*self.axis), math.hypot(*self.first_direction)
        if min(norms) < 1e-9:
            raise ValueError("`axis` and `first_direction` must not be zero")
        dot = sum(a * b for a, b in zip(self.axis, self.first_direction, strict=True))
        if abs(dot) > 1e-6 * norms[0] * norms[1]:
            raise ValueError("`first_direction` must be perpendicular to `axis`")


class AssumptionsConfig(Section, frozen=True, kw_only=True):
    """What is taken for granted of obstacles and readings; `lower_bound` is sound within it, not beyond."""

    radius_min_m: Annotated[
        float, _meta("obstacles are balls of at least this radius", "m", gt=0.0, le=10.0)
    ] = 0.05
    radius_max_m: Annotated[
        float, _meta("obstacles are balls of at most this radius", "m", gt=0.0, le=10.0)
    ] = 0.15
    assumed_radius_m: (
        Annotated[
            float,
            _meta("radius that `sphere_fit` assumes; left out: `radius_min_m`", "m", gt=0.0, le=10.0),
        ]
        | None
    ) = None
    reading_error_m: Annotated[
        float, _meta("ε: greatest error of a reading (±); no echo is lost otherwise", "m", ge=0.0, le=1.0)
    ]
    obstacles: Annotated[
        Literal["one", "many"],
        _meta(
            "`one`: all echoes are those of one ball; `many`: another ball may hide wherever no sensor looks"
        ),
    ] = "many"
    links: Annotated[
        list[str] | None,
        _meta("links that the rings answer for, each of which carries a ring; left out: all that do"),
    ] = None

    def __post_init__(self) -> None:
        if self.radius_min_m > self.radius_max_m:
            raise ValueError("`radius_min_m` must not be above `radius_max_m`")
        if self.assumed_radius_m is not None and not (
            self.radius_min_m <= self.assumed_radius_m <= self.radius_max_m
        ):
            raise ValueError("`assumed_radius_m` must lie between `radius_min_m` and `radius_max_m`")


class StoppingPoint(Section, frozen=True, kw_only=True):
    """How one joint stops from one speed."""

    speed_rad_s: Annotated[float, _meta("speed from which it stops", "rad/s or m/s", gt=0.0, le=100.0)]
    time_s: Annotated[float, _meta("stopping time from that speed", "s", gt=0.0, le=10.0)]
    distance_rad: Annotated[float, _meta("stopping distance from that speed", "rad or m", gt=0.0, le=100.0)]


class StoppingConfig(Section, frozen=True, kw_only=True):
    """How one joint stops from its greatest speed, by the maker's data (worst load and extension)."""

    speed_rad_s: Annotated[float, _meta("speed from which it stops", "rad/s or m/s", gt=0.0, le=100.0)]
    time_s: Annotated[float, _meta("stopping time from that speed", "s", gt=0.0, le=10.0)]
    distance_rad: Annotated[float, _meta("stopping distance from that speed", "rad or m", gt=0.0, le=100.0)]
    slower: Annotated[
        list[StoppingPoint],
        _meta("the same from lower speeds, in rising order; left out: the one above holds for all speeds"),
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
        _meta(
            "the robot's own: from the arrival of a command to the beginning of the stop", "s", ge=0.0, le=5.0
        ),
    ] = 0.1
    transport_s: Annotated[
        float,
        _meta(
            "from the service to the robot, at least: "
            "a longer one that a consumer's echo shows takes its place",
            "s",
            ge=0.0,
            le=5.0,
        ),
    ] = 0.02


class LimitsConfig(Section, frozen=True, kw_only=True):
    """Limits beside those of the URDF: the smaller of two limits holds."""

    velocity_rad_s: Annotated[
        dict[str, Annotated[float, Meta(gt=0.0, le=100.0)]],
        _meta("joint speed limits by joint, below or in place of the URDF's", "rad/s or m/s"),
    ] = {}
    acceleration_rad_s2: Annotated[
        float,
        _meta(
            "how fast a commanded joint may speed up; slowing down is never delayed",
            "rad/s²",
            gt=0.0,
            le=1000.0,
        ),
    ] = 4.0
    position_margin_rad: Annotated[
        float, _meta("distance that is kept from each joint's position limits", "rad or m", ge=0.0, le=1.0)
    ] = 0.02


class SourceConfig(Section, frozen=True, kw_only=True):
    """Whether one input must be there, and how old it may be."""

    required: Annotated[
        bool,
        _meta(
            "true: `stop` until it has arrived; "
            "false: it may be absent, but once it has been seen it must stay fresh"
        ),
    ]
    timeout_s: Annotated[float, _meta("age beyond which the source is stale", "s", gt=0.0, le=10.0)]
    period_s: Annotated[
        float,
        _meta(
            "time from one measurement to the next, at least (the ranges' is that of their rings); "
            "a longer one that is measured takes its place",
            "s",
            ge=0.0,
            le=10.0,
        ),
    ] = 0.0
    integrity: Annotated[
        Literal["crc", "none"],
        _meta(
            "`crc`: a message without the right checksum in its attachment is refused; "
            "`none`: it may come without (a simple driver), and `health` says so"
        ),
    ] = "crc"
    prove_age: Annotated[
        bool,
        _meta(
            "true: a message must name a tick of the service that its sender had heard before, "
            "which bounds its age without any common clock"
        ),
    ] = False


class SourcesConfig(Section, frozen=True, kw_only=True):
    """The inputs of the monitor. Ranges, obstacles or both must be required."""

    joints: Annotated[SourceConfig, _meta("joint positions and velocities; always required")] = SourceConfig(
        required=True, timeout_s=0.1
    )
    ranges: Annotated[SourceConfig, _meta("readings of the sensor rings")] = SourceConfig(
        required=True, timeout_s=0.4
    )
    obstacles: Annotated[SourceConfig, _meta("tracked obstacles, for the exact distance")] = SourceConfig(
        required=False, timeout_s=0.25
    )
    target: Annotated[SourceConfig, _meta("the wanted motion; its absence never makes a zone milder")] = (
        SourceConfig(required=False, timeout_s=0.5)
    )

    def __post_init__(self) -> None:
        if not self.joints.required:
            raise ValueError("`joints.required` must be true: without joint positions nothing is known")
        if self.target.required:
            raise ValueError("`target.required` must be false: a missing target only zeroes the command")


class PlausibilityConfig(Section, frozen=True, kw_only=True):
    """What cannot be true although it is in due form; each check is off where its first key is left out."""

    joint_speed_factor: (
        Annotated[
            float,
            _meta(
                "a joint that seems to have moved faster than this many times its speed limit "
                "since the message before stops (`implausible:joints`)",
                ge=1.0,
                le=10.0,
            ),
        ]
        | None
    ) = None
    joint_tolerance_rad: Annotated[
        float, _meta("what a joint's position may be off beside that", "rad or m", ge=0.0, le=1.0)
    ] = 0.02
    follow_window_s: (
        Annotated[
            float,
            _meta(
                "over this time the joints must have moved as this service's commands say, or it stops "
                "(`implausible:joints`); only for a robot that nothing else moves",
                "s",
                gt=0.0,
                le=10.0,
            ),
        ]
        | None
    ) = None
    follow_delay_s: Annotated[
        float, _meta("by how much the motion may lag behind the commands", "s", gt=0.0, le=10.0)
    ] = 0.3
    frozen_scans: (
        Annotated[
            int,
            _meta(
                "so many readings of one sensor in a row that are the same to the last digit stop "
                "(`frozen:ranges`); only for sensors whose noise is above their resolution",
                "scans",
                ge=2,
                le=100_000,
            ),
        ]
        | None
    ) = None
    echo_margin_m: (
        Annotated[
            float,
            _meta(
                "a sensor that looks at something tracked and reads more than this beyond it stops "
                "(`missing:ranges`)",
                "m",
                ge=0.0,
                le=100.0,
            ),
        ]
        | None
    ) = None
    hold_s: Annotated[
        float, _meta("how long such a stop lasts after the last sign of it", "s", ge=0.0, le=60.0)
    ] = 0.5


class MotionConfig(Section, frozen=True, kw_only=True):
    """How targets become joint velocities ([Kang2022] (11)–(16) and Algorithm 1)."""

    controller: Annotated[
        Literal["field", "field3d"],
        _meta(
            "for `position` targets: the conventional potential field, or the 3-D field of the sensor ring"
        ),
    ] = "field"
    speed_m_s: Annotated[
        float, _meta("speed of the end effector under a `position` target", "m/s", gt=0.0, le=5.0)
    ] = 0.1
    attractive_gain: Annotated[float, _meta("ξ of the attractive field", "1/s²", gt=0.0, le=1e6)] = 1.0
    repulsive_gain: Annotated[float, _meta("η of the repulsive field", "m⁴/s²", ge=0.0, le=1e6)] = 0.002
    influence_distance_m: Annotated[
        float, _meta("ρ0: obstacles beyond this distance do not repel", "m", gt=0.0, le=10.0)
    ] = 0.3
    approach_gain: Annotated[
        float,
        _meta("the end effector slows to this times its distance from the goal", "1/s", gt=0.0, le=100.0),
    ] = 2.0
    arrival_tolerance_m: Annotated[
        float, _meta("the goal counts as reached within this distance", "m", gt=0.0, le=0.1)
    ] = 0.001
    singular_value_threshold: Annotated[
        float,
        _meta(
            "damping begins where the Jacobian's least singular value is below this", "m/rad", gt=0.0, le=1.0
        ),
    ] = 0.02
    max_damping: Annotated[
        float, _meta("greatest damping λ, at a singular configuration", "m/rad", gt=0.0, le=1.0)
    ] = 0.02


class ZoneConfig(Section, frozen=True, kw_only=True):
    """One zone that slows the robot. Red is nearer than yellow and never faster."""

    distance_m: Annotated[
        float, _meta("the zone holds up to and including this distance", "m", gt=0.0, le=100.0)
    ]
    joint_speed_rad_s: Annotated[
        float, _meta("speed limit of every joint in this zone", "rad/s or m/s", gt=0.0, le=100.0)
    ]
    speed_scaling: Annotated[float, _meta("speed scaling told to consumers", None, gt=0.0, le=1.0)]


class SeparationConfig(Section, frozen=True, kw_only=True):
    """The protective separation distance ([TS15066] 5.5.4): what it assumes of people and of measurements."""

    human_speed_m_s: Annotated[
        float, _meta("v_h: speed at which people are taken to come near ([ISO13855])", "m/s", gt=0.0, le=10.0)
    ] = 1.6
    tracked_velocity: Annotated[
        bool, _meta("true: where a tracker says an obstacle's velocity, its speed takes the place of v_h")
    ] = False
    human_speed_floor_m_s: Annotated[
        float, _meta("what a tracked speed counts at least", "m/s", gt=0.0, le=10.0)
    ] = 0.25
    intrusion_m: Annotated[
        float, _meta("C: how far a part of the body may reach in before it is noticed", "m", ge=0.0, le=10.0)
    ]
    human_uncertainty_m: Annotated[
        float,
        _meta(
            "Z_d: uncertainty of a tracked position (a ring's `accuracy_m` where that is greater)",
            "m",
            ge=0.0,
            le=10.0,
        ),
    ]
    robot_uncertainty_m: Annotated[
        float, _meta("Z_r: uncertainty of the robot's own position", "m", ge=0.0, le=10.0)
    ]
    red_scaling: Annotated[
        float,
        _meta(
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
        _meta(
            "a second error within this time latches `stop` until a `reset`, also across a restart",
            "s",
            gt=0.0,
            le=1e6,
        ),
    ] = 3600.0


class ProfileConfig(Section, frozen=True, kw_only=True):
    """A zone profile: by distance in steps ([Kang2022] II-B-1), by the separation equation, or by both."""

    red: Annotated[ZoneConfig | None, _meta("the nearer zone; with `yellow`, or neither")] = None
    yellow: Annotated[ZoneConfig | None, _meta("the farther zone; beyond it is green")] = None
    separation: Annotated[
        SeparationConfig | None,
        _meta("speed and separation monitoring by the equation; left out: only distances count"),
    ] = None
    latch: Annotated[
        LatchConfig | None, _meta("stop for good after errors of integrity; left out: never")
    ] = None
    range_estimator: Annotated[
        Literal["nearest", "lower_bound"],
        _meta(
            "what the zone takes the readings for: the least reading, "
            "or the least distance that any admissible obstacle could have (needs `assumptions`)"
        ),
    ] = "nearest"
    uncovered: Annotated[
        Literal["off", "yellow", "red", "stop"],
        _meta(
            "zone, at least, while a ball of `assumptions.radius_min_m` could be within the yellow distance "
            "of a ring's link unseen and no other source looks; without `assumptions` nobody can tell"
        ),
    ] = "yellow"
    disagree_margin_m: (
        Annotated[
            float,
            _meta(
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
        Literal["yellow", "red", "stop"], _meta("zone, at least, while they differ by more")
    ] = "red"
    recovery_ticks: Annotated[
        int, _meta("good ticks in a row before a zone becomes milder", "ticks", ge=1, le=100_000)
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


class RobotFile(Section, frozen=True, kw_only=True):
    """What the robot is and what is monitored; these keys stand before the first table of the file."""

    urdf: Annotated[
        str,
        _meta(
            "path of the URDF, relative to this file, "
            "or `example-robot-data:PATH` for one of that package's robots",
            None,
            min_length=1,
        ),
    ]
    package_dirs: Annotated[
        list[str], _meta("folders in which `package://` mesh paths are looked up, relative to this file")
    ] = []
    end_effector_frame: Annotated[
        str, _meta("frame that `twist` and `position` targets move", None, min_length=1)
    ]
    links: Annotated[
        list[str] | None,
        _meta("links whose distance is monitored; left out: every link with collision geometry"),
    ] = None
    hull_pieces: Annotated[
        dict[str, Annotated[int, Meta(ge=1, le=32)]],
        _meta("into how many slabs a link's mesh is cut for its convex bound; 1 where not named"),
    ] = {}
    joints: Annotated[JointsConfig, _meta("joints that do not move")] = JointsConfig()
    rings: Annotated[list[RingConfig], _meta("sensor rings, in the order of the readings in `Ranges`")] = []
    assumptions: Annotated[
        AssumptionsConfig | None,
        _meta("what `sphere_fit` and `lower_bound` assume; left out: neither is computed"),
    ] = None
    stopping: Annotated[
        dict[str, StoppingConfig], _meta("stopping data by joint, from the robot maker's manual")
    ] = {}
    reaction: Annotated[ReactionConfig, _meta("reaction time, where a profile has a `separation`")] = (
        ReactionConfig()
    )
    limits: Annotated[LimitsConfig, _meta("limits beside the URDF's")] = LimitsConfig()
    sources: Annotated[SourcesConfig, _meta("inputs")] = SourcesConfig()
    plausibility: Annotated[
        PlausibilityConfig, _meta("checks of inputs that are in due form; all off where left out")
    ] = PlausibilityConfig()
    motion: Annotated[MotionConfig, _meta("from target to velocity")] = MotionConfig()
    default_profile: Annotated[str, _meta("profile used when `--profile` names none", None, min_length=1)]
    profiles: Annotated[dict[str, ProfileConfig], _meta("zone profiles by name", None, min_length=1)]

    def __post_init__(self) -> None:
        if self.default_profile not in self.profiles:
            raise ValueError(
                f"`default_profile` names '{self.default_profile}', which is not among `profiles`: "
                + ", ".join(self.profiles)
            )
        both = sorted(set(self.joints.locked) & set(self.joints.fixed))
        if both:
            raise ValueError(f"`joints.locked` and `joints.fixed` both name {both[0]}")
        names = [ring.name for ring in self.rings]
        if len(set(names)) != len(names):
            raise ValueError("`rings` must have different names")
        if not self.rings and self.sources.ranges.required:
            raise ValueError("`sources.ranges.required` is true but the file has no `rings`")
        if not self.rings and self.assumptions is not None:
            raise ValueError("`assumptions` speak of the readings of `rings`, and the file has none")
        for name, profile in self.profiles.items():
            if profile.range_estimator == "lower_bound" and self.assumptions is None:
                raise ValueError(
                    f"`profiles.{name}.range_estimator` is 'lower_bound', which needs `assumptions`"
                )
        if not self.rings and self.motion.controller == "field3d":
            raise ValueError("`motion.controller` is 'field3d', which needs `rings`")
        if not (self.sources.ranges.required or self.sources.obstacles.required):
            raise ValueError(
                "at least one of `sources.ranges.required` and `sources.obstacles.required` must be true"
            )


class RobotConfig(Struct, frozen=True, kw_only=True):
    """A robot file with the place it came from."""

    name: str
    path: str
    file: RobotFile = field()

    def to_builtins(self) -> dict[str, Any]:
        """Return the configuration in force as plain values, for messages and reports."""
        return {"name": self.name, **msgspec.to_builtins(self.file)}

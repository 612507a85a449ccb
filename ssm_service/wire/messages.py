"""The messages of the network, version 1: JSON objects with exactly these fields.

Lengths in m, angles in rad, times as named, everything in the robot's base frame, quaternions x y z w.
Every number is finite; 'none' is ``null``. Unknown fields are refused, so a misspelt optional field can
never be silently taken as left out.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct
from msgspec.json import Decoder

from ..config import ControllerName

Identity = Annotated[
    str, Meta(min_length=1, max_length=64, description="random id made at the producer's start")
]
Sequence = Annotated[int, Meta(ge=0, le=2**63 - 1, description="rises by 1 for each message of one producer")]
Stamp = Annotated[
    int,
    Meta(
        ge=-(2**63),
        le=2**63 - 1,
        description="UTC in ns since 1970, for people and logs; no age is judged by it",
    ),
]
ValidFor = Annotated[
    int,
    Meta(
        ge=1,
        le=2**63 - 1,
        description="ns after its arrival for which a consumer may act on the message; then it stops",
    ),
]
ZoneWord = Literal["green", "yellow", "red", "stop"]
ShapeWord = Literal["sphere", "capsule", "cylinder", "box"]
Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

MAX_PAYLOAD = 65_536
"""Greatest payload of an input message [bytes]."""

MAX_OBSTACLES = 128
"""Greatest number of obstacles in one message: it bounds the time of a tick."""

MAX_JOINTS = 64
"""Greatest number of joints in one message."""

MAX_SENSORS = 1024
"""Greatest number of readings in one scan."""

# Every list from outside has a greatest length, so that refusing a message costs no more than accepting one.
Names = Annotated[list[str], Meta(max_length=MAX_JOINTS)]
Positions = Annotated[list[float], Meta(max_length=MAX_JOINTS, description="rad or m, by name")]
Velocities = Annotated[list[float], Meta(max_length=MAX_JOINTS, description="rad/s or m/s, by name")]
Readings = Annotated[list[float | None], Meta(max_length=MAX_SENSORS, description="m; null is no echo")]


class Message(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of all messages."""


class JointState(Message, frozen=True, kw_only=True):
    """Measured joint state; joints are matched by name, in any order."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    name: Names
    position: Positions
    velocity: Velocities


class Ranges(Message, frozen=True, kw_only=True):
    """One scan of all sensor rings, in the order of the robot file's rings and sensors."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    ranges: Readings


class ObstacleEntry(Message, frozen=True, kw_only=True):
    """One tracked obstacle."""

    id: Annotated[str, Meta(min_length=1, max_length=64)]
    shape: ShapeWord
    size: Annotated[
        list[float],
        Meta(
            max_length=3,
            description="m; sphere [r], capsule or cylinder [r, length] along z, box [x, y, z]",
        ),
    ]
    position: Annotated[Vector3, Meta(description="m, base frame")]
    quaternion_xyzw: Annotated[Quaternion, Meta(description="orientation, base frame")] = (0.0, 0.0, 0.0, 1.0)
    velocity: Annotated[Vector3 | None, Meta(description="m/s, base frame; null: not known")] = None


class Obstacles(Message, frozen=True, kw_only=True):
    """All tracked obstacles; an empty list means 'seen, and nothing there'."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    obstacles: Annotated[list[ObstacleEntry], Meta(max_length=MAX_OBSTACLES)]


class Target(Message, frozen=True, kw_only=True):
    """The wanted motion."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    kind: Literal["joint_velocity", "twist", "position", "pose"]
    value: Annotated[list[float], Meta(max_length=64)]
    controller: ControllerName | None = None


class Echo(Message, frozen=True, kw_only=True):
    """What a consumer sends back now and then, so that the service can measure the transport to it."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    service: Annotated[Identity, Meta(description="producer of the zone that is echoed")]
    tick: Annotated[Sequence, Meta(description="seq of the newest zone that had arrived")]
    held_ns: Annotated[
        int, Meta(ge=0, le=2**63 - 1, description="ns from its arrival to this echo, at least")
    ]


class ResetReply(Message, frozen=True, kw_only=True):
    """Answer to a ``reset`` query."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    robot: str
    cleared: Annotated[
        str | None, Meta(description="what was latched, or remembered; null where there was nothing")
    ]


class NearestEntry(Message, frozen=True, kw_only=True):
    """The nearest thing of all sources."""

    source: Annotated[str, Meta(description="ranges or obstacles")]
    link: str
    obstacle: Annotated[str | None, Meta(description="id; null for ranges")]
    distance: Annotated[float, Meta(description="m, from the link's surface; at or below 0 is contact")]
    point_on_link: Vector3
    point_on_obstacle: Vector3
    normal: Annotated[Vector3, Meta(description="unit, from the obstacle to the link")]


class SourceEntry(Message, frozen=True, kw_only=True):
    """One input as this tick saw it."""

    state: Literal["absent", "fresh", "stale", "invalid"]
    required: bool
    age_s: Annotated[float | None, Meta(description="upper bound, by the service's own monotonic clock")]
    distance: Annotated[float | None, Meta(description="m; what this source alone says")]


class ComparisonEntry(Message, frozen=True, kw_only=True):
    """What the rings say of one link beside the tracked obstacles, as of the newest message of either."""

    link: str
    estimator: Annotated[str, Meta(description="the profile's: nearest or lower_bound")]
    estimate: Annotated[float | None, Meta(description="m; null where the estimator says nothing")]
    exact: Annotated[float | None, Meta(description="m, by Coal; null where nothing is tracked")]
    difference: Annotated[
        float | None, Meta(description="m, estimate less exact: above 0 it is nearer than the rings say")
    ]


class LimitingEntry(Message, frozen=True, kw_only=True):
    """The link and obstacle that leave the least speed, where the profile has a separation."""

    source: Annotated[str, Meta(description="ranges or obstacles")]
    link: str
    obstacle: Annotated[str | None, Meta(description="id; null for ranges")]
    distance: Annotated[float, Meta(description="m, as the equation takes it")]
    closing_speed: Annotated[float, Meta(description="m/s, v_r: measured, towards the obstacle")]
    max_closing_speed: Annotated[float, Meta(description="m/s, at which S_p is the distance")]
    separation: Annotated[dict[str, float], Meta(description="terms at the closing speed now [m]")]


class Zone(Message, frozen=True, kw_only=True):
    """Zone and speed limits of one tick."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    valid_for_ns: ValidFor
    robot: str
    profile: str
    zone: ZoneWord
    distance: Annotated[
        float | None, Meta(description="m, least over all sources; null where nothing was seen")
    ]
    name: list[str]
    speed_limit: Annotated[list[float], Meta(description="rad/s or m/s, by name")]
    speed_scaling: Annotated[float, Meta(ge=0.0, le=1.0)]
    nearest: NearestEntry | None
    sources: dict[str, SourceEntry]
    comparison: Annotated[
        ComparisonEntry | None, Meta(description="null unless both ranges and obstacles are fresh")
    ] = None
    reaction: Annotated[
        dict[str, float] | None, Meta(description="terms of the reaction time, where the profile uses one")
    ]
    limiting: Annotated[
        LimitingEntry | None, Meta(description="null where the profile has no separation, or nothing is near")
    ] = None
    reasons: list[str]


class VelocityCommand(Message, frozen=True, kw_only=True):
    """Joint velocities of one tick; ``seq`` is the same as that of the tick's ``Zone``."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    valid_for_ns: ValidFor
    robot: str
    zone: ZoneWord
    name: list[str]
    velocity: Annotated[list[float], Meta(description="rad/s or m/s, by name")]


class EvaluateTarget(Message, frozen=True, kw_only=True):
    """A target inside an ``evaluate`` input."""

    kind: Literal["joint_velocity", "twist", "position", "pose"]
    value: Annotated[list[float], Meta(max_length=64)]
    controller: ControllerName | None = None


class EvaluateInput(Message, frozen=True, kw_only=True):
    """One question to ``evaluate``; a source that is left out counts as not configured."""

    position: Positions
    velocity: Velocities | None = None
    name: Names | None = None
    ranges: Readings | None = None
    obstacles: Annotated[list[ObstacleEntry], Meta(max_length=10_000)] | None = None
    target: EvaluateTarget | None = None


class PairEntry(Message, frozen=True, kw_only=True):
    """The exact distance of one monitored link and one obstacle."""

    link: str
    obstacle: str
    distance: Annotated[float, Meta(description="m, negative in penetration")]
    point_on_link: Vector3
    point_on_obstacle: Vector3
    normal: Annotated[Vector3, Meta(description="unit, from the obstacle to the link")]
    closing_speed: Annotated[
        float | None,
        Meta(
            description="m/s, of the link's nearest point towards the obstacle; null without joint velocities"
        ),
    ]
    max_closing_speed: Annotated[float | None, Meta(description="m/s; null where the profile sets none")]
    separation: Annotated[
        dict[str, float] | None,
        Meta(description="terms of the protective separation distance; null where the profile uses none"),
    ]


class EstimateEntry(Message, frozen=True, kw_only=True):
    """One estimate from the readings of a ring."""

    distance: Annotated[float, Meta(description="m, from the link's surface")]
    position: Annotated[Vector3 | None, Meta(description="m, base frame")]
    bearing: Annotated[float | None, Meta(description="rad, about the link, from sensor 1")]
    sensors: Annotated[list[int], Meta(description="the sensors used, numbered from 1 as in Ranges")]
    std: Annotated[float | None, Meta(description="m, standard deviation where one is known")] = None


class EstimatesEntry(Message, frozen=True, kw_only=True):
    """Every estimator's answer; ``null`` where it has none, with the word in ``reasons``."""

    as_printed: EstimateEntry | None = None
    corrected: EstimateEntry | None = None
    nearest: EstimateEntry | None = None
    sphere_fit: EstimateEntry | None = None
    lower_bound: EstimateEntry | None = None
    reasons: dict[str, str] = {}


class SeparationPair(Message, frozen=True, kw_only=True):
    """The protective separation of one link from one obstacle."""

    source: Annotated[str, Meta(description="ranges or obstacles")]
    link: str
    obstacle: Annotated[str | None, Meta(description="id; null for ranges")]
    distance: Annotated[float, Meta(description="m, exact where `exact`, else never above it")]
    exact: bool
    point_on_link: Vector3
    point_on_obstacle: Vector3
    normal: Annotated[Vector3, Meta(description="unit, from the obstacle to the link")]
    human_speed: Annotated[float, Meta(description="m/s, v_h")]
    closing_speed: Annotated[float, Meta(description="m/s, v_r: measured, towards the obstacle")]
    max_closing_speed: Annotated[float, Meta(description="m/s, at which S_p is the distance")]
    reaction_time: Annotated[float, Meta(description="s, T_r")]
    stopping_time: Annotated[float, Meta(description="s, T_s")]
    separation: Annotated[dict[str, float], Meta(description="terms at the closing speed now [m]")]


class Separation(Message, frozen=True, kw_only=True):
    """Every pair of one tick with all terms; published now and then, and the newest tick's when asked."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    robot: str
    profile: str
    reaction: Annotated[
        dict[str, dict[str, float]], Meta(description="terms of the reaction time by source [s]")
    ]
    pairs: list[SeparationPair]


class FramesEntry(Message, frozen=True, kw_only=True):
    """Transforms to the base frame, row by row."""

    sensors: list[list[list[float]]]
    end_effector: list[list[float]]


class CommandEntry(Message, frozen=True, kw_only=True):
    """A velocity command in the robot's joint order."""

    velocity: list[float]


class EvaluateOutput(Message, frozen=True, kw_only=True):
    """One answer of ``evaluate``."""

    zone: ZoneWord
    distance: float | None
    speed_limit: list[float]
    speed_scaling: float
    reasons: list[str]
    pairs: list[PairEntry]
    estimates: EstimatesEntry | None
    frames: FramesEntry
    jacobian: Annotated[
        list[list[float]], Meta(description="3 × k: end effector position by the k free joints, base frame")
    ]
    command: CommandEntry | None


class EvaluateError(Message, frozen=True, kw_only=True):
    """The answer to a line that cannot be evaluated."""

    error: str


class FramesRequest(Message, frozen=True, kw_only=True):
    """Payload of a ``frames`` query; an empty payload asks for the present configuration."""

    position: Positions
    name: Names | None = None


class FramesReply(Message, frozen=True, kw_only=True):
    """Answer to a ``frames`` query: transforms to the base frame, row by row."""

    robot: str
    name: list[str]
    position: list[float]
    sensors: list[list[list[float]]]
    end_effector: list[list[float]]
    links: dict[str, list[list[float]]]
    jacobian: list[list[float]]


class Health(Message, frozen=True, kw_only=True):
    """Counters and timings of a running service."""

    producer: Identity
    seq: Sequence
    stamp_ns: Stamp
    robot: str
    version: str
    uptime_s: float
    rate_hz: float
    ticks: int
    skipped: Annotated[int, Meta(description="ticks that were left out after an overrun")]
    overruns: int
    tick_us: Annotated[dict[str, float], Meta(description="p50, p99, max over the last ticks")]
    lateness_us: Annotated[dict[str, float], Meta(description="p50, p99, max over the last ticks")]
    accepted: dict[str, int]
    rejected: Annotated[dict[str, dict[str, int]], Meta(description="by source and cause")]
    last_rejection: dict[str, str]
    lost: Annotated[dict[str, int], Meta(description="gaps in the senders' seq")]
    age_s: dict[str, float | None]
    queries: Annotated[dict[str, int], Meta(description="answered, by key")]
    integrity: Annotated[dict[str, str], Meta(description="by source: crc, or none")] = {}
    integrity_errors: Annotated[
        dict[str, int], Meta(description="by cause: corruption, repetition, insertion, …")
    ] = {}
    latched: Annotated[
        str | None, Meta(description="why the zone is held at stop until a `reset`; null where it is not")
    ] = None
    transport_s: Annotated[
        dict[str, float], Meta(description="to each consumer whose echo is fresh, an upper bound")
    ] = {}
    memory_bytes: Annotated[int | None, Meta(description="resident memory; null where unknown")]
    warnings: list[str]


INPUTS: dict[str, type[Message]] = {
    "joints": JointState,
    "ranges": Ranges,
    "obstacles": Obstacles,
    "target": Target,
}
"""Message of each input key ``in/NAME``."""

ALL: tuple[type[Message], ...] = (
    JointState,
    Ranges,
    Obstacles,
    Target,
    Zone,
    VelocityCommand,
    EvaluateInput,
    EvaluateOutput,
    EvaluateError,
    FramesRequest,
    FramesReply,
    Echo,
    Separation,
    Health,
    ResetReply,
)
"""Every message with a schema of its own."""

for _kind in ALL:
    # msgspec (0.22) works out what it must know of a type on first use, and crashes where two threads do so.
    Decoder(_kind)

VERSION = 1
"""Version of every message here."""


def encoding_of(message: type[Message]) -> str:
    """Return the Zenoh encoding, e.g. ``application/json;ssm.Zone/1``."""
    return f"application/json;ssm.{message.__name__}/{VERSION}"


def names_another(encoding: str, message: type[Message]) -> bool:
    """Tell whether a Zenoh encoding names one of our schemas, but not this message's.

    A simple driver may name none (``application/json``, or nothing at all). One that names another
    has sent this to the wrong key, or the network has delivered it there.
    """
    _, _, schema = encoding.partition(";")
    return schema.startswith("ssm.") and encoding != encoding_of(message)


def json_schemas() -> dict[str, Any]:
    """Return one JSON Schema document with a definition for every message."""
    import msgspec

    _, components = msgspec.json.schema_components(ALL, ref_template="#/$defs/{name}")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"ssm_service messages, version {VERSION}",
        "$defs": components,
    }

"""What a scenario file may hold: every key with its type, unit, bounds, default and meaning."""

from __future__ import annotations

import itertools
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

Coordinate = Annotated[float, Meta(ge=-100.0, le=100.0)]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
Quaternion = tuple[float, float, float, float]
Identifier = Annotated[str, Meta(min_length=1, max_length=64)]


def _meta(meaning: str, unit: str | None = None, **bounds: Any) -> Meta:
    return Meta(description=meaning, extra={"unit": unit or "–"}, **bounds)


AtTheEnd = Annotated[
    Literal["loop", "hold"],
    _meta("after the last waypoint: begin again, for which the path ends where it begins, or stay there"),
]


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of every table in a scenario file: frozen, no unknown keys."""


class WaypointConfig(Section, frozen=True, kw_only=True):
    """Where something is at one time; between waypoints it moves along a straight line at constant speed."""

    t_s: Annotated[
        float,
        _meta("time since the start of the path; 0 for the first, then rising", "s", ge=0.0, le=3600.0),
    ]
    position_m: Annotated[Vector3, _meta("position in the robot's base frame", "m")]


class ShapeConfig(Section, frozen=True, kw_only=True):
    """One convex shape of a group."""

    id: Annotated[Identifier, _meta("name in the messages; no two shapes of a scenario share one")]
    shape: Annotated[Literal["sphere", "capsule", "cylinder", "box"], _meta("kind of shape")]
    size_m: Annotated[
        list[float],
        _meta(
            "each above 0: sphere [r], capsule [r, length between the centres of its ends], "
            "cylinder [r, length], box [x, y, z]",
            "m",
            min_length=1,
        ),
    ]
    quaternion_xyzw: Annotated[
        Quaternion,
        _meta("orientation in the base frame, of norm 1; capsules and cylinders lie along their own z"),
    ] = (0.0, 0.0, 0.0, 1.0)
    offset_m: Annotated[Vector3, _meta("centre relative to the path", "m")] = (0.0, 0.0, 0.0)


class ObstacleConfig(Section, frozen=True, kw_only=True):
    """One or several shapes that move together along one path, without turning."""

    shapes: Annotated[list[ShapeConfig], _meta("the shapes; at most 128 in a scenario", None, min_length=1)]
    path: Annotated[list[WaypointConfig], _meta("where it is, in rising times from 0", None, min_length=1)]
    at_the_end: AtTheEnd = "loop"

    def __post_init__(self) -> None:
        times = [waypoint.t_s for waypoint in self.path]
        if times[0] != 0.0 or any(b <= a for a, b in itertools.pairwise(times)):
            raise ValueError("`path` must begin at t_s = 0 and go on in rising times")
        if self.at_the_end == "loop" and self.path[0].position_m != self.path[-1].position_m:
            raise ValueError("`path` must end where it begins, or `at_the_end` must be 'hold'")


class TargetConfig(Section, frozen=True, kw_only=True):
    """What the arm is told to do from one time of the cycle on."""

    t_s: Annotated[
        float,
        _meta(
            "time since the start of the cycle; 0 for the first, then rising, below `duration_s`",
            "s",
            ge=0.0,
            le=3600.0,
        ),
    ]
    kind: Annotated[
        Literal["joint_velocity", "twist", "position"],
        _meta("what `value` means, as in the message `Target`"),
    ]
    value: Annotated[
        list[float],
        _meta(
            "`joint_velocity`: of each joint, in the robot's order [rad/s or m/s]; `twist`: linear [m/s], "
            "then angular [rad/s] of the end effector; `position`: [x, y, z] of the end effector [m]",
            None,
            min_length=1,
            max_length=64,
        ),
    ]


class ScenarioFile(Section, frozen=True, kw_only=True):
    """One scenario; the targets repeat without end, and so does every path that does not say `hold`."""

    description: Annotated[str, _meta("one sentence for people", None, min_length=1)]
    duration_s: Annotated[
        float,
        _meta("length of one cycle of the targets, and a good length for a run", "s", gt=0.0, le=3600.0),
    ]
    start: Annotated[
        dict[str, float],
        _meta(
            "joint positions at the start; joints not named here start at rest. A robot that has none of the "
            "joints named here starts at rest and sways one joint in place of `targets`",
            "rad or m",
        ),
    ] = {}
    targets: Annotated[
        list[TargetConfig], _meta("what the arm is told to do, in rising times from 0; none: no target")
    ] = []
    obstacles: Annotated[list[ObstacleConfig], _meta("what moves or stands around the robot")] = []

    def __post_init__(self) -> None:
        times = [target.t_s for target in self.targets]
        if times and (times[0] != 0.0 or any(b <= a for a, b in itertools.pairwise(times))):
            raise ValueError("`targets` must begin at t_s = 0 and go on in rising times")
        if times and times[-1] >= self.duration_s:
            raise ValueError("the last of `targets` must begin before `duration_s`")
        ids = [shape.id for obstacle in self.obstacles for shape in obstacle.shapes]
        if len(set(ids)) != len(ids):
            raise ValueError("`obstacles` must not hold two shapes with the same id")

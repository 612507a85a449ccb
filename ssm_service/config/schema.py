"""What a robot file may hold: every key with its type, unit, bounds, default and meaning.

The structures are frozen and know nothing of URDFs; whether a named joint, link or frame exists is
checked where the URDF is read (``ssm_service.model``). The reference page of all keys is generated
from this module and those that it takes together (``ssm_service.config.reference``).
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct, field

from .motion import MotionConfig
from .profiles import ProfileConfig
from .rings import AssumptionsConfig, RingConfig
from .section import Section, described
from .sources import PlausibilityConfig, SourcesConfig
from .stopping import ReactionConfig, StoppingConfig


class JointsConfig(Section, frozen=True, kw_only=True):
    """Which joints do not move. Joints named nowhere are free; none may be named in both tables."""

    locked: Annotated[
        dict[str, float],
        described(
            "joints that stay in every message but that no command ever moves, and the position at which "
            "the simulated robot holds them",
            "rad or m",
        ),
    ] = {}
    fixed: Annotated[
        dict[str, float],
        described(
            "joints that are taken out of the model at this position and appear in no message "
            "(a gripper's fingers)",
            "rad or m",
        ),
    ] = {}


class LimitsConfig(Section, frozen=True, kw_only=True):
    """Limits beside those of the URDF: the smaller of two limits holds."""

    velocity_rad_s: Annotated[
        dict[str, Annotated[float, Meta(gt=0.0, le=100.0)]],
        described("joint speed limits by joint, below or in place of the URDF's", "rad/s or m/s"),
    ] = {}
    acceleration_rad_s2: Annotated[
        float,
        described(
            "how fast a commanded joint may speed up; slowing down is never delayed",
            "rad/s²",
            gt=0.0,
            le=1000.0,
        ),
    ] = 4.0
    position_margin_rad: Annotated[
        float,
        described("distance that is kept from each joint's position limits", "rad or m", ge=0.0, le=1.0),
    ] = 0.02


class RobotFile(Section, frozen=True, kw_only=True):
    """What the robot is and what is monitored; these keys stand before the first table of the file."""

    urdf: Annotated[
        str,
        described(
            "path of the URDF, relative to this file, "
            "or `example-robot-data:PATH` for one of that package's robots",
            None,
            min_length=1,
        ),
    ]
    package_dirs: Annotated[
        list[str], described("folders in which `package://` mesh paths are looked up, relative to this file")
    ] = []
    end_effector_frame: Annotated[
        str, described("frame that `twist` and `position` targets move", None, min_length=1)
    ]
    links: Annotated[
        list[str] | None,
        described("links whose distance is monitored; left out: every link with collision geometry"),
    ] = None
    hull_pieces: Annotated[
        dict[str, Annotated[int, Meta(ge=1, le=32)]],
        described("into how many slabs a link's mesh is cut for its convex bound; 1 where not named"),
    ] = {}
    joints: Annotated[JointsConfig, described("joints that do not move")] = JointsConfig()
    rings: Annotated[
        list[RingConfig], described("sensor rings, in the order of the readings in `Ranges`")
    ] = []
    assumptions: Annotated[
        AssumptionsConfig | None,
        described("what `sphere_fit` and `lower_bound` assume; left out: neither is computed"),
    ] = None
    stopping: Annotated[
        dict[str, StoppingConfig], described("stopping data by joint, from the robot maker's manual")
    ] = {}
    reaction: Annotated[ReactionConfig, described("reaction time, where a profile has a `separation`")] = (
        ReactionConfig()
    )
    limits: Annotated[LimitsConfig, described("limits beside the URDF's")] = LimitsConfig()
    sources: Annotated[SourcesConfig, described("inputs")] = SourcesConfig()
    plausibility: Annotated[
        PlausibilityConfig, described("checks of inputs that are in due form; all off where left out")
    ] = PlausibilityConfig()
    motion: Annotated[MotionConfig, described("from target to velocity")] = MotionConfig()
    default_profile: Annotated[str, described("profile used when `--profile` names none", None, min_length=1)]
    profiles: Annotated[dict[str, ProfileConfig], described("zone profiles by name", None, min_length=1)]

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

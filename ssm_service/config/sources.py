"""Inputs: whether they must be there, how old they may be, and when they cannot be true."""

from __future__ import annotations

from typing import Annotated, Literal

from .section import Section, described


class SourceConfig(Section, frozen=True, kw_only=True):
    """Whether one input must be there, and how old it may be."""

    required: Annotated[
        bool,
        described(
            "true: `stop` until it has arrived; "
            "false: it may be absent, but once it has been seen it must stay fresh"
        ),
    ]
    timeout_s: Annotated[float, described("age beyond which the source is stale", "s", gt=0.0, le=10.0)]
    period_s: Annotated[
        float,
        described(
            "time from one measurement to the next, at least (the ranges' is that of their rings); "
            "a longer one that is measured takes its place",
            "s",
            ge=0.0,
            le=10.0,
        ),
    ] = 0.0
    integrity: Annotated[
        Literal["crc", "none"],
        described(
            "`crc`: a message without the right checksum in its attachment is refused; "
            "`none`: it may come without (a simple driver), and `health` says so"
        ),
    ] = "crc"
    prove_age: Annotated[
        bool,
        described(
            "true: a message must name a tick of the service that its sender had heard before, "
            "which bounds its age without any common clock"
        ),
    ] = False


class SourcesConfig(Section, frozen=True, kw_only=True):
    """The inputs of the monitor. Ranges, obstacles or both must be required."""

    joints: Annotated[SourceConfig, described("joint positions and velocities; always required")] = (
        SourceConfig(required=True, timeout_s=0.1)
    )
    ranges: Annotated[SourceConfig, described("readings of the sensor rings")] = SourceConfig(
        required=True, timeout_s=0.4
    )
    obstacles: Annotated[SourceConfig, described("tracked obstacles, for the exact distance")] = SourceConfig(
        required=False, timeout_s=0.25
    )
    target: Annotated[SourceConfig, described("the wanted motion; its absence never makes a zone milder")] = (
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
            described(
                "a joint that seems to have moved faster than this many times its speed limit "
                "since the message before stops (`implausible:joints`)",
                ge=1.0,
                le=10.0,
            ),
        ]
        | None
    ) = None
    joint_tolerance_rad: Annotated[
        float, described("what a joint's position may be off beside that", "rad or m", ge=0.0, le=1.0)
    ] = 0.02
    follow_window_s: (
        Annotated[
            float,
            described(
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
        float, described("by how much the motion may lag behind the commands", "s", gt=0.0, le=10.0)
    ] = 0.3
    frozen_scans: (
        Annotated[
            int,
            described(
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
            described(
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
        float, described("how long such a stop lasts after the last sign of it", "s", ge=0.0, le=60.0)
    ] = 0.5

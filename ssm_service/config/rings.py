"""Rings of range sensors, how simulated ones err, and what is assumed of what they see."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from .section import Section, Vector3, described


class SimulatedSensorConfig(Section, frozen=True, kw_only=True):
    """How the simulated sensors of a ring err. Everything is off by default."""

    noise_std_m: Annotated[float, described("standard deviation of Gaussian noise", "m", ge=0.0, le=1.0)] = (
        0.0
    )
    bias_m: Annotated[float, described("constant offset of every reading", "m", ge=-1.0, le=1.0)] = 0.0
    resolution_m: Annotated[float, described("quantisation step; 0 is none", "m", ge=0.0, le=0.1)] = 0.0
    dropout_probability: Annotated[float, described("chance that an echo is lost", None, ge=0.0, le=1.0)] = (
        0.0
    )
    latency_s: Annotated[float, described("delay from measurement to message", "s", ge=0.0, le=1.0)] = 0.0


class RingConfig(Section, frozen=True, kw_only=True):
    """One ring of range sensors round a link, evenly spaced, looking outwards; a file may hold several."""

    name: Annotated[str, described("name of the ring", None, min_length=1)]
    parent_frame: Annotated[
        str, described("URDF link (or other frame) that carries the ring", None, min_length=1)
    ]
    origin_m: Annotated[Vector3, described("centre of the ring in the parent frame", "m")]
    axis: Annotated[Vector3, described("the ring's axis in the parent frame; need not be of unit length")] = (
        0.0,
        0.0,
        1.0,
    )
    first_direction: Annotated[
        Vector3, described("sensing direction of sensor 1 in the parent frame, perpendicular to the axis")
    ] = (1.0, 0.0, 0.0)
    count: Annotated[int, described("number of sensors, evenly spaced about the axis", None, ge=1, le=64)]
    radius_m: Annotated[
        float,
        described("distance of the sensors from the axis: the radius of the link there", "m", gt=0.0, le=2.0),
    ]
    tilt_deg: Annotated[
        float,
        described(
            "elevation of the sensing directions out of the ring's plane, towards the axis",
            "deg",
            gt=-90.0,
            lt=90.0,
        ),
    ] = 0.0
    field_of_view_deg: Annotated[
        float, described("full opening angle of one sensor's cone", "deg", gt=0.0, lt=180.0)
    ]
    range_min_m: Annotated[
        float, described("least distance that the device resolves", "m", ge=0.0, le=100.0)
    ] = 0.0
    range_max_m: Annotated[
        float,
        described(
            "greatest distance that the device reports; beyond it there is no echo", "m", gt=0.0, le=100.0
        ),
    ]
    period_s: Annotated[float, described("time of one scan of all sensors", "s", gt=0.0, le=10.0)]
    accuracy_m: Annotated[
        float, described("greatest error of a reading that the maker states (±)", "m", ge=0.0, le=1.0)
    ] = 0.0
    simulated: Annotated[SimulatedSensorConfig, described("errors of the simulated sensors")] = (
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
        float, described("obstacles are balls of at least this radius", "m", gt=0.0, le=10.0)
    ] = 0.05
    radius_max_m: Annotated[
        float, described("obstacles are balls of at most this radius", "m", gt=0.0, le=10.0)
    ] = 0.15
    assumed_radius_m: (
        Annotated[
            float,
            described("radius that `sphere_fit` assumes; left out: `radius_min_m`", "m", gt=0.0, le=10.0),
        ]
        | None
    ) = None
    reading_error_m: Annotated[
        float, described("ε: greatest error of a reading (±); no echo is lost otherwise", "m", ge=0.0, le=1.0)
    ]
    obstacles: Annotated[
        Literal["one", "many"],
        described(
            "`one`: all echoes are those of one ball; `many`: another ball may hide wherever no sensor looks"
        ),
    ] = "many"
    links: Annotated[
        list[str] | None,
        described("links that the rings answer for, each of which carries a ring; left out: all that do"),
    ] = None

    def __post_init__(self) -> None:
        if self.radius_min_m > self.radius_max_m:
            raise ValueError("`radius_min_m` must not be above `radius_max_m`")
        if self.assumed_radius_m is not None and not (
            self.radius_min_m <= self.assumed_radius_m <= self.radius_max_m
        ):
            raise ValueError("`assumed_radius_m` must lie between `radius_min_m` and `radius_max_m`")

"""The scene of ``bench.kang2022``: its file, its robot, and what each row of the table runs."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from ssm_service.config import ProfileConfig, load_robot_config
from ssm_service.model import Obstacle, Robot

Array = NDArray[np.float64]
Point = tuple[float, float, float]

FILE = Path(__file__).with_suffix("").with_name("kang2022.toml")
STEP_S = 0.002
"""Step of the world [s], which all periods of the file are multiples of."""

FREE, FIELD, FIELD3D = "free", "conventional", "3-D"
FULL, PRINTED = "3-D at δ = 1", "3-D as printed"
PLANTS = ("ideal", "real robot")


class Real(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the real robot has that the ideal one has not."""

    time_constant_s: float
    link_period_s: float
    scan_period_s: float
    noise_std_m: float
    resolution_m: float


class Scene(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``bench/kang2022.toml``; the keys are explained there."""

    robot: str
    tick_s: float
    start_rad: Point
    goal_m: Point
    speed_m_s: float
    acceleration_m_s2: float
    arrival_m: float
    ball_m: Point
    ball_radius_m: float
    attractive_gain: float
    repulsive_gain: float
    influence_m: float
    step_of_sensor: float
    recovery_ticks: int
    horizon_s: float
    stuck_s: float
    stuck_m: float
    real: Real

    def ball(self, position: Point | None = None) -> Obstacle:
        """Return the obstacle, at the file's place or another [m]."""
        return Obstacle(
            id="ball", shape="sphere", size=(self.ball_radius_m,), position=position or self.ball_m
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What one run is.

    Attributes:
        method: One of ``FREE``, ``FIELD``, ``FIELD3D``, ``FULL``, ``PRINTED``.
        limited: Whether the zones limit the joints ('with SSM').
        plant: One of ``PLANTS``.
        ball_m: Where the ball is in place of the scene's [m].
        seed: Of the sensors' noise.
    """

    method: str
    limited: bool
    plant: str
    ball_m: Point | None = None
    seed: int = 1

    @property
    def name(self) -> str:
        """The row's name."""
        if self.method == FREE:
            return "no obstacle"
        return f"{self.method}, {'SSM' if self.limited else 'no speed limits'}"


CASES = (
    (FREE, True),
    (FIELD, False),
    (FIELD3D, True),
    (FIELD, True),
    (FIELD3D, False),
    (FULL, True),
    (PRINTED, True),
)
"""Method and limits of the rows; the paper has the first three."""


@cache
def scene() -> Scene:
    """Read the scene's file."""
    return msgspec.convert(tomllib.loads(FILE.read_text(encoding="utf-8")), Scene, strict=True)


@cache
def robot(plant: str) -> Robot:
    """Return the scene's robot with the ring of a plant, and with a profile ``unlimited`` beside its own."""
    chosen = scene()
    config = load_robot_config(chosen.robot)
    file, real = config.file, chosen.real
    (ring,) = file.rings
    changed: dict[str, Any] = {"period_s": chosen.tick_s}
    if plant == PLANTS[1]:
        errors = replace(ring.simulated, noise_std_m=real.noise_std_m, resolution_m=real.resolution_m)
        changed = {"period_s": real.scan_period_s, "simulated": errors}
    zones = replace(file.profiles["kang2022"], recovery_ticks=chosen.recovery_ticks)
    motion = replace(
        file.motion,
        attractive_gain=chosen.attractive_gain,
        repulsive_gain=chosen.repulsive_gain,
        influence_distance_m=chosen.influence_m,
        arrival_tolerance_m=1e-6,
    )
    profiles = {"kang2022": zones, "unlimited": _unlimited(zones)}
    changed_file = replace(file, rings=[replace(ring, **changed)], profiles=profiles, motion=motion)
    return Robot(replace(config, file=changed_file))


def _unlimited(zones: ProfileConfig) -> ProfileConfig:
    """Return a profile with the same zones and no limit in any: the joints' own remain."""
    if zones.red is None or zones.yellow is None:
        raise ValueError("profile kang2022 has no zones")
    free = {"joint_speed_rad_s": 100.0, "speed_scaling": 1.0}
    return replace(zones, red=replace(zones.red, **free), yellow=replace(zones.yellow, **free))


def start(arm: Robot) -> Array:
    """Return the scene's start, (n,) [rad]."""
    position = arm.rest_position.copy()
    position[arm.free] = scene().start_rad
    return position

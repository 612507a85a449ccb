"""The scenes of ``bench.avoidance``: a start, a goal, things that stand, cross and chase."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssm_service.model import Obstacle, Robot

Array = NDArray[np.float64]

KINDS = ("static", "crossing", "chasing")
BASE_M = 0.22
"""Nothing that moves comes nearer than this to the axis of the base, whose links cannot move away."""

REST = np.array([0.0, -1.57, 0.0, -1.57, 0.0, 0.0])
STEP_S = 0.05
"""What chases is at its goal no sooner than in this time [s]; ways are looked at so often."""

_AWAY_M = 1.4
_LEAVING_M_S = 0.4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mover:
    """Something that moves.

    Attributes:
        obstacle: Its shape, and where it begins.
        velocity: (3,) of one that crosses [m/s].
        speed_m_s: Of one that chases; 0 for one that crosses.
        until_s: When one that chases gives up and leaves [s].
    """

    obstacle: Obstacle
    velocity: Array
    speed_m_s: float = 0.0
    until_s: float = 0.0

    def velocity_at(self, time_s: float, position: Array, end_effector: Array) -> Array:
        """Return its velocity, (3,) [m/s], where it is now.

        One that chases heads for the end effector, but never into the base, and leaves outwards in the end.
        """
        if self.speed_m_s == 0.0:
            return self.velocity
        outwards = np.array([position[0], position[1], 0.0])
        outwards /= max(float(np.linalg.norm(outwards)), 1e-9)
        if time_s >= self.until_s:
            return _LEAVING_M_S * outwards
        towards = end_effector - position
        distance = float(np.linalg.norm(towards))
        wanted: Array = towards * (self.speed_m_s / max(distance, self.speed_m_s * STEP_S))
        inwards = -float(wanted @ outwards)
        if math.hypot(*position[:2]) <= BASE_M + reach(self.obstacle) and inwards > 0.0:
            wanted = wanted + inwards * outwards
        return wanted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """One scene.

    Attributes:
        number: Its number.
        kind: Of ``KINDS``.
        start: (6,) [rad].
        goal: (3,) position of the end effector [m].
        fixed: What stands.
        movers: What moves.
        blocked: Whether the straight motion of the end effector, unavoidingly followed, touches what stands.
    """

    number: int
    kind: str
    start: Array
    goal: Array
    fixed: tuple[Obstacle, ...]
    movers: tuple[Mover, ...]
    blocked: bool

    def to_builtins(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {
            "number": self.number,
            "kind": self.kind,
            "start": self.start.tolist(),
            "goal": self.goal.tolist(),
            "fixed": [asdict(one) for one in self.fixed],
            "movers": [
                {
                    "obstacle": asdict(one.obstacle),
                    "velocity": one.velocity.tolist(),
                    "speed_m_s": one.speed_m_s,
                    "until_s": one.until_s,
                }
                for one in self.movers
            ],
            "blocked": self.blocked,
        }

    @classmethod
    def of(cls, values: dict[str, Any]) -> Scene:
        """Return the scene that ``to_builtins`` wrote."""
        movers = [
            Mover(**one | {"obstacle": _obstacle(one["obstacle"]), "velocity": np.array(one["velocity"])})
            for one in values["movers"]
        ]
        return cls(
            **values
            | {
                "start": np.array(values["start"]),
                "goal": np.array(values["goal"]),
                "fixed": tuple([_obstacle(one) for one in values["fixed"]]),
                "movers": tuple(movers),
            }
        )


def _obstacle(values: dict[str, Any]) -> Obstacle:
    return Obstacle(**{key: tuple(v) if isinstance(v, list) else v for key, v in values.items()})


class World:
    """The obstacles of a scene in the course of time.

    Attributes:
        time_s: Time since the start.
    """

    def __init__(self, scene: Scene) -> None:
        self.time_s = 0.0
        self._fixed = tuple([replace(one, velocity=(0.0, 0.0, 0.0)) for one in scene.fixed])
        self._movers = [[one, np.array(one.obstacle.position), one.velocity] for one in scene.movers]

    @property
    def still(self) -> bool:
        """Whether everything that moves is gone."""
        return not self._movers

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return all obstacles now, with their velocities."""
        moving = [
            replace(one.obstacle, position=tuple(place.tolist()), velocity=tuple(velocity.tolist()))
            for one, place, velocity in self._movers
        ]
        return (*self._fixed, *moving)

    def step(self, end_effector: Array, dt: float) -> None:
        """Move everything on by ``dt`` [s], with the end effector at (3,) [m]; what is far away is gone."""
        for mover in self._movers:
            mover[2] = mover[0].velocity_at(self.time_s, mover[1], end_effector)
            mover[1] = mover[1] + mover[2] * dt
        self.time_s += dt
        self._movers = [m for m in self._movers if not _gone(m[1], m[2])]


def _gone(position: Array, velocity: Array) -> bool:
    return float(np.linalg.norm(position)) > _AWAY_M and float(position @ velocity) > 0.0


@cache
def robot() -> Robot:
    """Return the arm of all scenes."""
    return Robot.load(Path(__file__).with_name("avoidance_robot.toml"))


def reach(obstacle: Obstacle) -> float:
    """Return the radius of the ball round an obstacle [m]."""
    if obstacle.shape in ("capsule", "cylinder"):
        return obstacle.size[0] + 0.5 * obstacle.size[1]
    return obstacle.radius


def end_effector(position: Array) -> Array:
    """Return where the end effector is, (3,) [m]."""
    place: Array = robot().kinematics(position).transform_end_effector_to_base[:3, 3]
    return place

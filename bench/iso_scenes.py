"""Random variants of the scenarios ``crossing``, ``hand`` and ``walk`` for ``bench.iso``, and its robot."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import Target
from ssm_service.simulation import Path3, Scenario, load_scenario
from ssm_service.simulation.scenario import Mover

SCENARIOS = ("crossing", "hand", "walk")
PROFILES = ("kang2022", "iso", "plain")
ARM_SPEEDS_M_S = (0.1, 0.25, 0.6)
"""Speeds of the end effector; the first is the robot file's own."""

LEGS = 4
"""Ways from one target to the next that make a cycle: twice there and back."""

ARRIVED_M = 0.005
FASTEST_M_S = 1.6

_ROOT = Path(__file__).resolve().parents[1]


def write_robots(folder: Path, stop_distance_m: float) -> list[Path]:
    """Write the UR3 without rings, whose tracker is required, once for each of ``ARM_SPEEDS_M_S``.

    Profile ``plain`` stands still up to and including ``stop_distance_m``, and knows no other limit.
    """
    text = (_ROOT / "robots" / "ur3.toml").read_text(encoding="utf-8")
    before, _, rest = text.partition("# Terabee")
    text = before + "# Category 0" + rest.partition("# Category 0")[2]
    for old, new in (
        ("ranges = { required = true", "ranges = { required = false"),
        ("obstacles = { required = false", "obstacles = { required = true"),
    ):
        if old not in text:
            raise ValueError(old)
        text = text.replace(old, new)
    text += (
        "\n[profiles.plain]\nuncovered = 'off'\nrecovery_ticks = 100\n"
        f"red = {{ distance_m = {stop_distance_m}, joint_speed_rad_s = 1e-9, speed_scaling = 1e-9 }}\n"
        f"yellow = {{ distance_m = {stop_distance_m + 1e-9}, joint_speed_rad_s = 1e-9, "
        "speed_scaling = 1e-9 }\n"
    )
    paths = []
    for number, speed in enumerate(ARM_SPEEDS_M_S):
        path = folder / f"arm{number}.toml"
        path.write_text(text.replace("speed_m_s = 0.1\n", f"speed_m_s = {speed}\n"), encoding="utf-8")
        paths.append(path)
    return paths


class Task(Scenario):
    """A scenario in which each target comes when the one before it is reached.

    The clock of the obstacles begins at ``phase_s``. ``reached_s`` holds when each target was reached.
    """

    phase_s: float
    robot: Robot
    reached_s: list[float]

    @classmethod
    def of(cls, robot: Robot, base: Scenario, movers: tuple[Mover, ...], rng: np.random.Generator) -> Task:
        """Return a variant of ``base`` with these obstacles and targets near its own."""
        targets = tuple(
            Target(kind="position", value=target.value + rng.uniform(-0.08, 0.08, 3))
            for target in base.targets[:2]
        )
        task = cls(
            name=base.name,
            description=base.description,
            duration_s=base.duration_s,
            start=base.start,
            movers=movers,
            target_times=base.target_times,
            targets=targets,
        )
        for name, value in (("phase_s", rng.uniform(0.0, 12.0)), ("robot", robot), ("reached_s", [])):
            object.__setattr__(task, name, value)
        return task

    def obstacles_at(self, time_s: float) -> tuple[Obstacle, ...]:
        """Return all obstacles at a time [s]."""
        return super().obstacles_at(time_s + self.phase_s)

    def target_at(self, time_s: float, position: NDArray[np.float64] | None = None) -> Target:
        """Return the target in force, the next one where the last was reached."""
        target = self.targets[len(self.reached_s) % len(self.targets)]
        if position is not None:
            end = self.robot.kinematics(position).transform_end_effector_to_base[:3, 3]
            if np.linalg.norm(end - target.value) <= ARRIVED_M:
                self.reached_s.append(time_s)
                target = self.targets[len(self.reached_s) % len(self.targets)]
        return target


def variant(robot: Robot, name: str, rng: np.random.Generator) -> Task:
    """Return a random variant of a scenario: other paths, speeds, phases and targets."""
    base = load_scenario(name, robot)
    draw = {"crossing": _crossing, "hand": _hand, "walk": _walk}[name]
    times, points = draw(rng)
    path = Path3.of(times, points, loop=True)
    turned = _turned(rng) if name == "hand" else None
    movers = [
        Mover(
            config=mover.config if turned is None else replace(mover.config, quaternion_xyzw=turned),
            path=path,
        )
        for mover in base.movers
    ]
    return Task.of(robot, base, tuple(movers), rng)


def _turned(rng: np.random.Generator) -> tuple[float, float, float, float]:
    x, y, z, w = rng.normal(size=4)
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return (float(x / length), float(y / length), float(z / length), float(w / length))


Waypoints = tuple[list[float], list[tuple[float, float, float]]]


def _through(points: list[NDArray[np.float64]], speeds: list[float], pauses: list[float]) -> Waypoints:
    """Return a closed path through points at the speeds of its legs, with a pause before each leg [s]."""
    times, places = [0.0], [points[0]]
    for index, (speed, pause) in enumerate(zip(speeds, pauses, strict=True)):
        following = points[(index + 1) % len(points)]
        times += [times[-1] + pause]
        places += [places[-1]]
        times += [times[-1] + float(np.linalg.norm(following - places[-1])) / speed]
        places += [following]
    return times, [(float(x), float(y), float(z)) for x, y, z in places]


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    angle = rng.uniform(-math.pi, math.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _speed(rng: np.random.Generator, least: float = 0.1) -> float:
    """Return a speed up to walking speed, which one in five has."""
    return FASTEST_M_S if rng.random() < 0.2 else float(rng.uniform(least, FASTEST_M_S))


def _crossing(rng: np.random.Generator) -> Waypoints:
    middle = rng.uniform([0.05, -0.2, 0.25], [0.5, 0.2, 0.75])
    way = _direction(rng) * rng.uniform(0.8, 1.6)
    pauses = rng.uniform(0.1, 2.0, 2).tolist()
    return _through([middle - way, middle + way], [_speed(rng), _speed(rng)], pauses)


def _hand(rng: np.random.Generator) -> Waypoints:
    inside = rng.uniform([0.1, -0.4, 0.2], [0.5, 0.4, 0.6])
    outside = inside + rng.uniform(0.8, 1.5) * _direction(rng) + [0.0, 0.0, rng.uniform(-0.1, 0.3)]
    pauses = [float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.5, 5.0))]
    return _through([outside, inside], [_speed(rng), _speed(rng)], pauses)


def _walk(rng: np.random.Generator) -> Waypoints:
    side, angle = rng.uniform(0.55, 1.3), rng.uniform(-math.pi, math.pi)
    away = np.array([math.cos(angle), math.sin(angle), 0.0])
    along = np.array([-away[1], away[0], 0.0]) * rng.uniform(2.0, 3.0)
    slant = away * rng.uniform(-0.2, 0.5)
    pauses = rng.uniform(0.1, 2.0, 2).tolist()
    ends = [side * away - along, side * away + along + slant]
    return _through(ends, [_speed(rng, 0.3), _speed(rng, 0.3)], pauses)

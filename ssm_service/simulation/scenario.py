"""Scenarios: what happens round the robot, and what the arm is told to do meanwhile."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..config import load_toml
from ..errors import ConfigError, InputError, listed, suggestion
from ..model import Obstacle, Robot
from ..monitor import Target, checked_target
from ..wire.messages import MAX_OBSTACLES
from .paths import Path3
from .schema import ObstacleConfig, ScenarioFile, ShapeConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class Mover:
    """One shape on its path.

    Attributes:
        config: The shape.
        path: The path of its group.
    """

    config: ShapeConfig
    path: Path3

    def at(self, time_s: float) -> Obstacle:
        """Return the obstacle at a time [s], with the path's velocity."""
        (x, y, z), velocity = self.path.at(time_s)
        dx, dy, dz = self.config.offset_m
        return Obstacle(
            id=self.config.id,
            shape=self.config.shape,
            size=tuple(self.config.size_m),
            position=(x + dx, y + dy, z + dz),
            quaternion_xyzw=self.config.quaternion_xyzw,
            velocity=velocity,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenario:
    """A scenario for one robot.

    Attributes:
        name: The file's name without its ending.
        description: One sentence for people.
        duration_s: Length of the targets' cycle [s], and a good length for a run.
        start: (n,) joint position at the start [rad or m].
        movers: The shapes on their paths.
        target_times: (k,) when each target begins within the cycle [s].
        targets: (k,) the targets.
    """

    name: str
    description: str
    duration_s: float
    start: NDArray[np.float64]
    movers: tuple[Mover, ...]
    target_times: tuple[float, ...]
    targets: tuple[Target, ...]

    def obstacles_at(self, time_s: float) -> tuple[Obstacle, ...]:
        """Return all obstacles at a time [s]."""
        return tuple([mover.at(time_s) for mover in self.movers])

    def target_at(self, time_s: float) -> Target | None:
        """Return the target in force at a time [s]; ``None`` where the scenario has none."""
        if not self.targets:
            return None
        phase = math.fmod(max(time_s, 0.0), self.duration_s)
        return self.targets[bisect.bisect_right(self.target_times, phase) - 1]


def scenarios_directory() -> Path:
    """Return the folder of the scenarios that come with the package."""
    return Path(__file__).resolve().parent / "scenarios"


def list_scenarios() -> list[str]:
    """Return the names that ``load_scenario`` accepts without a path, sorted."""
    return sorted(path.stem for path in scenarios_directory().glob("*.toml"))


def load_scenario(name_or_path: str | Path, robot: Robot) -> Scenario:
    """Read a scenario by name (``crossing``) or by path (``scenes/mine.toml``) for a robot.

    Raises:
        ConfigError: There is no such scenario, or the file has an unknown key, a wrong type, a value out of
            bounds, or something that this robot does not have; file, key, what was found and what is allowed.
    """
    path = _find(name_or_path)
    file = load_toml(path, ScenarioFile)
    return Scenario(
        name=path.stem,
        description=file.description,
        duration_s=file.duration_s,
        start=_start(path, file, robot),
        movers=_movers(path, file),
        target_times=tuple(target.t_s for target in file.targets),
        targets=_targets(path, file, robot),
    )


def _find(name_or_path: str | Path) -> Path:
    text = str(name_or_path)
    path = Path(text)
    if path.suffix == ".toml" or "/" in text:
        return path
    names = list_scenarios()
    if text not in names:
        allowed = f"{suggestion(text, names)}a name ({listed(names)}) or the path of a .toml file"
        raise ConfigError("--scenario", "", text, allowed)
    return scenarios_directory() / f"{text}.toml"


def _start(path: Path, file: ScenarioFile, robot: Robot) -> NDArray[np.float64]:
    start = robot.rest_position.copy()
    for name, value in file.start.items():
        if name not in robot.joint_names:
            allowed = (
                f"{suggestion(name, robot.joint_names)}a joint of {robot.name}: {listed(robot.joint_names)}"
            )
            raise ConfigError(path, f"start.{name}", name, allowed)
        index = robot.joint_names.index(name)
        low, high = robot.position_lower[index], robot.position_upper[index]
        if not low <= value <= high:
            raise ConfigError(path, f"start.{name}", value, f"{low:g} to {high:g}, the joint's limits")
        start[index] = value
    start.flags.writeable = False
    return start


def _movers(path: Path, file: ScenarioFile) -> tuple[Mover, ...]:
    movers = []
    for i, obstacle in enumerate(file.obstacles):
        track = _track(obstacle)
        for j, shape in enumerate(obstacle.shapes):
            mover = Mover(config=shape, path=track)
            try:
                for time_s in track.times:
                    mover.at(time_s)
            except InputError as error:
                field = {"size": "size_m", "position": "offset_m"}.get(error.where, error.where)
                key = f"obstacles[{i}].shapes[{j}].{field}"
                raise ConfigError(path, key, error.found, error.allowed) from error
            movers.append(mover)
    if len(movers) > MAX_OBSTACLES:
        raise ConfigError(path, "obstacles", f"{len(movers)} shapes", f"at most {MAX_OBSTACLES} shapes")
    return tuple(movers)


def _track(obstacle: ObstacleConfig) -> Path3:
    return Path3.of(
        [waypoint.t_s for waypoint in obstacle.path],
        [waypoint.position_m for waypoint in obstacle.path],
        loop=obstacle.at_the_end == "loop",
    )


def _targets(path: Path, file: ScenarioFile, robot: Robot) -> tuple[Target, ...]:
    targets = []
    for index, target in enumerate(file.targets):
        try:
            targets.append(checked_target(robot, target.kind, target.value))
        except InputError as error:
            field = error.where.removeprefix("target.")
            raise ConfigError(path, f"targets[{index}].{field}", error.found, error.allowed) from error
    return tuple(targets)

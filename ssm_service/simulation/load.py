"""Strict reading of scenario files, for the robot that is to run them."""

from __future__ import annotations

import difflib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..config import load_toml
from ..errors import ConfigError, InputError, listed, suggestion
from ..model import Robot
from ..monitor import Target, checked_target
from ..wire.messages import MAX_OBSTACLES
from .paths import Path3
from .scenario import Mover, Scenario
from .schema import ObstacleConfig, ScenarioFile
from .sway import Sway, sway_for


def scenarios_directory() -> Path:
    """Return the folder of the scenarios that come with the package."""
    return Path(__file__).resolve().parent / "scenarios"


def list_scenarios() -> list[str]:
    """Return the names that ``load_scenario`` accepts without a path, sorted."""
    return sorted(path.stem for path in scenarios_directory().glob("*.toml"))


def load_scenario(name_or_path: str | Path, robot: Robot) -> Scenario:
    """Read a scenario by name (``crossing``) or by path (``scenes/mine.toml``) for a robot.

    A scenario whose ``start`` names joints, but none of this robot's, is written for another arm. Its
    obstacles stay where they are in the base frame; this robot starts at rest and sways one joint in place
    of targets that it may not reach, and ``remark`` says so.

    Raises:
        ConfigError: There is no such scenario, or the file has an unknown key, a wrong type, a value out of
            bounds, or something that this robot does not have; file, key, what was found and what is allowed.
    """
    path = _find(name_or_path)
    file = load_toml(path, ScenarioFile)
    foreign = bool(file.start) and not set(file.start) & set(robot.joint_names)
    sway = sway_for(robot) if foreign and file.targets else None
    return Scenario(
        name=path.stem,
        description=file.description,
        duration_s=file.duration_s,
        start=robot.rest_position if foreign else _start(path, file, robot),
        movers=_movers(path, file),
        target_times=() if foreign else tuple(target.t_s for target in file.targets),
        targets=() if foreign else _targets(path, file, robot),
        sway=sway,
        remark=_remark(path, file, robot, sway) if foreign else "",
    )


def _remark(path: Path, file: ScenarioFile, robot: Robot, sway: Sway | None) -> str:
    if sway is None:
        does = "stays there"
    elif sway.index == robot.free[0]:
        does = f"sways its first free joint, {sway.joint}"
    else:
        does = f"sways {sway.joint}, its first free joint with room for it"
    return (
        f"scenario '{path.stem}' is written for the joints {listed(file.start)}; "
        f"{robot.name} starts at rest and {does}"
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
    _check_joints(path, file, robot)
    for name, value in file.start.items():
        index = robot.joint_names.index(name)
        low, high = robot.position_lower[index], robot.position_upper[index]
        if not low <= value <= high:
            raise ConfigError(path, f"start.{name}", value, f"{low:g} to {high:g}, the joint's limits")
        start[index] = value
    start.flags.writeable = False
    return start


def _check_joints(path: Path, file: ScenarioFile, robot: Robot) -> None:
    """Refuse a start that names joints of this robot and others: one arm cannot have been meant."""
    unknown = [name for name in file.start if name not in robot.joint_names]
    if not unknown:
        return
    hint = suggestion(unknown[0], _slips(unknown[0], file, robot)) if len(unknown) == 1 else ""
    allowed = (
        f"{hint}joints of {robot.name} alone, of which it also names some: {listed(robot.joint_names)}; "
        "or, for another arm, none of them"
    )
    raise ConfigError(path, f"start.{unknown[0]}", listed(unknown), allowed)


def _slips(name: str, file: ScenarioFile, robot: Robot) -> list[str]:
    """Return the joints not yet named that ``name`` begins or all but spells.

    Joint names are much alike: a looser comparison would take any joint of another arm for a slip.
    """
    return [
        joint
        for joint in robot.joint_names
        if joint not in file.start
        and (joint.startswith(name) or difflib.SequenceMatcher(None, joint, name).ratio() > 0.85)
    ]


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

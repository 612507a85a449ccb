"""What is wrong or weak in a robot file: everything is loaded as the service would load it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from ..config import ProfileConfig, RobotFile, load_robot_config
from ..errors import ConfigError, listed
from ..model import DistanceModel, Robot
from ..monitor import weaknesses
from ..safety import WALKING_SPEED_M_S
from .faults import all_faults
from .findings import Finding, Report
from .words import counted

REFERENCE_RATE_HZ: Final = 500.0
"""The default rate, for times that the file counts in ticks."""


def check_robot(name_or_path: str) -> Report:
    """Check a robot file.

    Raises:
        ConfigError: The file cannot be read at all: it is missing, or no TOML.
    """
    try:
        config = load_robot_config(name_or_path)
        robot = Robot(config)
        DistanceModel(robot)
    except ConfigError as error:
        if error.file == "--robot":  # which is no option here
            raise ConfigError("FILE", "", error.found, error.allowed) from error
        if not error.key:
            raise
        return Report(error.file, "robot", [*all_faults(Path(error.file), error)])
    findings, file = [_loaded(robot), _monitored(robot)], config.file
    for rule in (
        _reach,
        _weaknesses,
        _promises,
        _plausible,
        _readings,
        _timeouts,
        _trackers,
        _recovery,
        _speeds,
    ):
        findings.extend(rule(robot, file))
    findings.extend(_unmonitored(robot))
    return Report(config.path, "robot", findings)


def _loaded(robot: Robot) -> Finding:
    free = [robot.joint_names[i] for i in robot.free]
    return Finding(
        "ok", "urdf", f"{counted(len(robot.joint_names), 'joint')}, {len(free)} of them free "
        f"({listed(free)}); {counted(robot.sensor_count, 'sensor')} in {counted(len(robot.rings), 'ring')}"
    )  # fmt: skip


def _monitored(robot: Robot) -> Finding:
    return Finding("ok", "links", f"meshes and hulls of {listed(robot.monitored_links)}")


def _unmonitored(robot: Robot) -> Iterator[Finding]:
    left_out = [link for link in robot.geometry_of_link if link not in robot.monitored_links]
    if left_out:
        yield Finding(
            "weak", "links", f"not monitored, though they have collision geometry: {listed(left_out)}"
        )
    bare = [
        frame.name
        for frame in robot.model.frames
        if frame.type.name == "BODY" and frame.parentJoint > 0 and frame.name not in robot.geometry_of_link
    ]
    if bare:
        yield Finding(
            "note",
            "urdf",
            f"moving links without collision geometry, whose distance nobody measures: {listed(bare)}",
        )


def _reach(_robot: Robot, file: RobotFile) -> Iterator[Finding]:
    """Compare what silence of the sensors proves with the zones' distances."""
    for i, ring in enumerate(file.rings):
        for name, profile in file.profiles.items():
            for zone, edge in zip(("red", "yellow"), profile.edges, strict=False):
                key, field = f"rings[{i}].range_max_m", f"profiles.{name}.{zone}.distance_m"
                if ring.range_max_m < edge:
                    level = "weak" if file.sources.obstacles.required else "fault"
                    text = f"{ring.range_max_m:g} m: no echo does not prove {field} = {edge:g} m to be free"
                    yield Finding(level, key, text)  # type: ignore[arg-type]
                elif ring.range_max_m - ring.accuracy_m < edge:
                    sure = ring.range_max_m - ring.accuracy_m
                    text = f"{sure:g} m when accuracy is taken off, below {field} = {edge:g} m"
                    yield Finding("weak", key, text)
        nearest_edge = min((edge for p in file.profiles.values() for edge in p.edges), default=0.0)
        if ring.range_min_m > 0.0:
            text = f"what is nearer than {ring.range_min_m:g} m may give no echo, and silence counts as free"
            yield Finding(
                "fault" if ring.range_min_m >= nearest_edge else "weak", f"rings[{i}].range_min_m", text
            )


def _weaknesses(robot: Robot, file: RobotFile) -> Iterator[Finding]:
    """Name what the service will name in ``health``: of all profiles, each thing once."""
    found = dict.fromkeys(weakness for profile in file.profiles for weakness in weaknesses(robot, profile))
    yield from (Finding("weak", weakness.key, weakness.text) for weakness in found)


def _promises(_robot: Robot, file: RobotFile) -> Iterator[Finding]:
    """Name what the profiles take on trust of the rings."""
    if not file.rings:
        return
    if file.assumptions is None:
        text = "none: neither `sphere_fit` nor `lower_bound`, and `uncovered` cannot be told"
        yield Finding("weak", "assumptions", text)
    for name, profile in file.profiles.items():
        if profile.uncovered == "off":
            text = "off: what the sensors cannot see counts as free; `ssm coverage` shows what that is"
            yield Finding("weak", f"profiles.{name}.uncovered", text)
        if profile.range_estimator == "nearest":
            text = "nearest: the least reading is an estimate, which may be above the true distance"
            yield Finding("weak", f"profiles.{name}.range_estimator", text)
        if profile.disagree_margin_m is None:
            text = "none: readings and tracked obstacles may contradict each other unnoticed"
            yield Finding("note", f"profiles.{name}.disagree_margin_m", text)


def _plausible(_robot: Robot, file: RobotFile) -> Iterator[Finding]:
    """Name the checks of inputs in due form that are off."""
    believed = {
        "joint_speed_factor": "joints that jump farther than they can move are believed",
        "follow_window_s": "joints that do not do what they are told are believed",
        "frozen_scans": "a sensor that says the same for ever is believed" if file.rings else "",
        "echo_margin_m": "a sensor that misses what is tracked before it is believed" if file.rings else "",
    }
    for key, text in believed.items():
        if text and getattr(file.plausibility, key) is None:
            yield Finding("note", f"plausibility.{key}", f"none: {text}")


def _readings(_robot: Robot, file: RobotFile) -> Iterator[Finding]:
    for i, ring in enumerate(file.rings):
        if ring.accuracy_m > 0.0:
            text = f"readings may be off by {ring.accuracy_m:g} m, and zones take them as they are"
            if any(profile.range_estimator == "nearest" for profile in file.profiles.values()):
                yield Finding("weak", f"rings[{i}].accuracy_m", text)
            if file.assumptions is not None and file.assumptions.reading_error_m < ring.accuracy_m:
                text = f"below rings[{i}].accuracy_m = {ring.accuracy_m:g} m, so `lower_bound` is not sound"
                yield Finding("weak", "assumptions.reading_error_m", text)
        timeout = file.sources.ranges.timeout_s
        key = "sources.ranges.timeout_s"
        if timeout <= ring.period_s:
            text = (
                f"{timeout:g} s is not above rings[{i}].period_s = {ring.period_s:g} s: stale between scans"
            )
            yield Finding("fault", key, text)
        elif timeout < 2.0 * ring.period_s:
            text = (
                f"{timeout:g} s is below two scans of {ring.period_s:g} s: one lost message stops the robot"
            )
            yield Finding("weak", key, text)


def _timeouts(_robot: Robot, file: RobotFile) -> Iterator[Finding]:
    """Compare how far a person walks while a source may be silent with the zones' distances."""
    edge = max((edge for profile in file.profiles.values() for edge in profile.edges), default=math.inf)
    for name in ("joints", "ranges", "obstacles"):
        source = getattr(file.sources, name)
        if name == "ranges" and not file.rings:
            continue
        walked = WALKING_SPEED_M_S * source.timeout_s
        if name != "joints" and walked > edge:
            yield Finding(
                "weak",
                f"sources.{name}.timeout_s",
                f"in {source.timeout_s:g} s of silence a person walks {walked:.2f} m (ISO 13855, "
                f"{WALKING_SPEED_M_S:g} m/s), through all of the yellow zone ({edge:g} m)",
            )


def _trackers(_robot: Robot, file: RobotFile) -> Iterator[Finding]:
    if not file.rings:
        yield Finding("weak", "rings", "none: all perception is tracked obstacles")


def _recovery(_robot: Robot, file: RobotFile) -> Iterator[Finding]:
    slowest = max((ring.period_s for ring in file.rings), default=0.0)
    for name, profile in file.profiles.items():
        time_s = profile.recovery_ticks / REFERENCE_RATE_HZ
        if time_s < slowest:
            yield Finding(
                "weak",
                f"profiles.{name}.recovery_ticks",
                f"{profile.recovery_ticks} ticks: {time_s:g} s at {REFERENCE_RATE_HZ:g} Hz, less than a scan "
                f"of {slowest:g} s: one scan without an echo is enough for a milder zone",
            )


def _speeds(robot: Robot, file: RobotFile) -> Iterator[Finding]:
    override = file.limits.velocity_rad_s
    for name, wanted in override.items():
        limit = float(robot.velocity_limit[robot.joint_names.index(name)])
        if limit < wanted:
            text = f"{wanted:g} has no effect: the URDF's {limit:g} is smaller"
            yield Finding("weak", f"limits.velocity_rad_s.{name}", text)
    from_urdf = [joint for joint in robot.joint_names if joint not in override]
    if from_urdf:
        speeds = {float(robot.velocity_limit[robot.joint_names.index(joint)]) for joint in from_urdf}
        values = listed(f"{speed:g}" for speed in sorted(speeds))
        text = f"green lets them run at the URDF's limits ({values} rad/s or m/s): {listed(from_urdf)}"
        yield Finding("note", "limits.velocity_rad_s", text)
    for name, profile in file.profiles.items():
        yield from _useless_zones(robot, name, profile)
    endless = [
        joint
        for joint, low, high in zip(
            robot.joint_names, robot.position_lower, robot.position_upper, strict=True
        )
        if np.isinf(low) or np.isinf(high)
    ]
    if endless:
        yield Finding("note", "urdf", f"joints without position limits: {listed(endless)}")


def _useless_zones(robot: Robot, name: str, profile: ProfileConfig) -> Iterator[Finding]:
    for zone, step in (("red", profile.red), ("yellow", profile.yellow)):
        if step is None:
            continue
        speed = step.joint_speed_rad_s
        unslowed = [
            j for j, limit in zip(robot.joint_names, robot.velocity_limit, strict=True) if speed >= limit
        ]
        if unslowed:
            level = "fault" if len(unslowed) == len(robot.joint_names) else "weak"
            text = (
                f"{speed:g} is not below the joint's own limit, so {zone} slows nothing: {listed(unslowed)}"
            )
            yield Finding(level, f"profiles.{name}.{zone}.joint_speed_rad_s", text)  # type: ignore[arg-type]

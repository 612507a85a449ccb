"""``ssm coverage``: what the sensor rings see and do not see, and what ring would close the gaps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import ConfigError
from .options import JsonOption, RobotOption, number
from .output import emit, emit_json, log

if TYPE_CHECKING:
    from ..model import Robot
    from ..perception.coverage import LinkCoverage

LEAST_RESOLUTION_M = 0.001


def coverage(
    robot: RobotOption = "ur3",
    radius: Annotated[
        float, typer.Option("--radius", parser=number, metavar="M", help="Radius of the balls to be seen.")
    ] = 0.05,
    distance: Annotated[
        float,
        typer.Option("--distance", parser=number, metavar="M", help="Gap up to which none may be unseen."),
    ] = 0.355,
    position: Annotated[
        str | None,
        typer.Option(
            "--position",
            metavar="Q,Q,…",
            help="Joint positions at which the arm's other links stand in the way; left out: none does.",
        ),
    ] = None,
    human_speed: Annotated[
        float, typer.Option("--human-speed", parser=number, metavar="M/S", help="Speed of a person.")
    ] = 1.6,
    reaction: Annotated[
        float,
        typer.Option(
            "--reaction",
            parser=number,
            metavar="S",
            help="Reaction time beside the scan: tick, network, robot.",
        ),
    ] = 0.02,
    stopping_time: Annotated[
        float | None,
        typer.Option(
            "--stopping-time",
            parser=number,
            metavar="S",
            help="Stopping time; left out: the greatest of the robot file's.",
            show_default=False,
        ),
    ] = None,
    search: Annotated[
        bool, typer.Option("--search", help="Search for the least ring that closes the gap.")
    ] = False,
    resolution: Annotated[
        float,
        typer.Option(
            "--resolution", parser=number, metavar="M", help="Finest boxes of the shares; finer is slower."
        ),
    ] = 0.004,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FOLDER", help="Write coverage.json and figures.", show_default=False),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Say what the sensor rings see of balls, what they do not, and what ring would close the gaps.

    Each link is looked at with its own sensors. Shares come with bounds, and
    the clear distance is proved. Without --position no other link of the arm
    stands in a sensor's way, which in truth depends on the configuration.
    """
    _check({"--radius": radius, "--distance": distance, "--human-speed": human_speed})
    _check({"--reaction": reaction, "--stopping-time": stopping_time}, zero=True)
    _check({"--resolution": resolution}, least=LEAST_RESOLUTION_M)
    from ..model import Robot
    from .coverage_numbers import Times, numbers
    from .coverage_words import summary_lines

    loaded = Robot.load(robot)
    if not loaded.rings:
        raise ConfigError(loaded.config.path, "rings", "none", "at least one ring of sensors")
    joints = _position(loaded, position)
    log("looking at each link in turn; a minute at most")
    covered = _links(loaded, radius, distance, joints, resolution)
    times = Times(human_speed=human_speed, reaction=reaction, stopping_time=stopping_time)
    report = numbers(loaded, covered, times, distance=distance, position=joints, resolution=resolution)
    if search:
        from .coverage_progress import searched

        report["search"] = searched(covered, radius, distance)
    if out is not None:
        from .coverage_figures import write_report

        report["figures"] = write_report(out, loaded, covered, report, distance)
    if json:
        emit_json(report, indent=2)
    else:
        for line in summary_lines(report):
            emit(line)


def _links(
    robot: Robot, radius: float, distance: float, position: list[float] | None, resolution: float
) -> list[LinkCoverage]:
    from ..perception.coverage import link_coverage, sensed_links

    links = sensed_links(robot, position=position)
    return [
        link_coverage(link, array, radius, distance, resolution)
        for link, array in zip(links, robot.sensor_arrays, strict=True)
    ]


def _position(robot: Robot, text: str | None) -> list[float] | None:
    if text is None:
        return None
    count = len(robot.joint_names)
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) != count:
        allowed = f"{count} numbers [rad or m]: {', '.join(robot.joint_names)}"
        raise ConfigError("--position", "", text, allowed)
    return values


def _check(values: dict[str, Any], *, zero: bool = False, least: float = 0.0) -> None:
    for option, value in values.items():
        if value is None or (least <= value < 100.0 and (value > 0.0 or zero)):
            continue
        allowed = f"a number {'of 0 or more' if zero else f'above {least:g}'} and below 100"
        raise ConfigError(option, "", value, allowed)

"""``ssm watch``: follows zone and command live, as a consumer with its watchdog."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ConfigError, NoServiceError
from .options import (
    ConnectOption,
    JsonOption,
    SecondsOption,
    ZenohConfigOption,
    checked_seconds,
    endpoints,
)
from .output import emit, emit_json

if TYPE_CHECKING:
    from rich.console import ConsoleDimensions, RenderableType

    from .followers import Everyone, Watched

DEFAULT_NAME = "ur3"
POLL_S = 0.001
QUIET_S = 2.0
"""Without a terminal, a line comes when something changes, and otherwise this often."""


def watch(
    name: Annotated[
        str | None,
        typer.Option(
            "--name",
            "--robot",
            metavar="NAME",
            help="The robot's name on the network.  \\[ur3]",
            show_default=False,
        ),
    ] = None,
    everyone: Annotated[
        bool, typer.Option("--all", help="Show every robot on the network, instead of one.")
    ] = False,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    seconds: SecondsOption = None,
    json: JsonOption = False,
) -> None:
    """Follow zone and command live, as a consumer with its watchdog: no news is a stop.

    Waits for a service, and goes on with a restarted one. With --json, one
    line for each decision, and about ten a second while the watchdog stops.
    Exit status 1: there was no decision in all the --seconds.
    """
    checked_seconds("--seconds", seconds)
    if everyone and name is not None:
        raise ConfigError("--name", "", name, "no --name with --all, which follows every robot")
    name = name or DEFAULT_NAME
    from ..client import Connection
    from .followers import Everyone, Watched

    where = endpoints(connect, zenoh_config)
    watched = [] if everyone else [Watched(name)]
    connection = Connection(where, zenoh_config)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            _watch(Everyone(connection, watched, discover=everyone), seconds, json)
    finally:
        connection.close()
    if seconds is not None and not any(robot.decided for robot in watched):
        what = "any robot" if everyone else name
        raise NoServiceError(
            f"no decision for {what} at {', '.join(where) or zenoh_config} within {seconds:g} s"
        )


def _watch(everyone: Everyone, seconds: float | None, json: bool) -> None:
    from .display import Display

    began = time.monotonic()

    def picture(size: ConsoleDimensions) -> RenderableType:
        from .live import draw, draw_all

        if everyone.discover:
            return draw_all([robot.state for robot in list(everyone.watched)], size)
        return draw(everyone.watched[0].state, size)

    with Display(picture, quiet=json, stderr=False) as display:
        while seconds is None or time.monotonic() - began < seconds:
            for robot in everyone.poll():
                if json:
                    emit_json(robot.record())
                elif not display.shown:
                    _tell(robot)
            time.sleep(POLL_S)


def _tell(robot: Watched) -> None:
    """Write a line if it says something new, or nothing was said for a while."""
    from .live import line

    followed = robot.state.followed
    now = time.monotonic()
    says = None if followed is None else (followed.zone, followed.reasons, followed.stopped_by_consumer)
    if says != robot.said or now - robot.said_at >= QUIET_S:
        robot.said, robot.said_at = says, now
        emit(f"{robot.name}  {line(robot.state)}")

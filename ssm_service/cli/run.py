"""``ssm run``: the service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import ServiceError
from .options import (
    NameOption,
    ProfileOption,
    RateOption,
    RobotOption,
    SecondsOption,
    ZenohConfigOption,
    checked_seconds,
)
from .output import log

IN_USE = "Address already in use"
"""The operating system's words, as Zenoh passes them on."""


def run(
    robot: RobotOption = "ur3",
    name: NameOption = None,
    profile: ProfileOption = None,
    rate: RateOption = 500.0,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            "--listen",
            metavar="ENDPOINT",
            help="Endpoint to listen on; may be repeated.  \\[tcp/127.0.0.1:7447 if nothing else is said]",
            show_default=False,
        ),
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(
            "--connect", metavar="ENDPOINT", help="Endpoint to dial, e.g. a router's; may be repeated."
        ),
    ] = None,
    zenoh_config: ZenohConfigOption = None,
    seconds: SecondsOption = None,
    insecure: Annotated[
        bool,
        typer.Option(
            "--insecure", help="Allow endpoints beyond this machine without mutual TLS; `health` says so."
        ),
    ] = False,
    state: Annotated[
        Path | None,
        typer.Option(
            "--state",
            metavar="FOLDER",
            help="Where a latched stop is kept over a restart.  \\[~/.local/state/ssm-service]",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Run the service: joints, readings and obstacles in; zone, limits and command out.

    Prints 'ready' once it decides, after a few seconds; Ctrl-C ends it. `ssm
    sim` in another terminal is a robot to try it with, `ssm watch` shows what
    it decides. Beyond this machine it wants keys: see `ssm keys init`.
    """
    checked_seconds("--seconds", seconds)
    from ..service import ServiceOptions, run_service

    options = ServiceOptions(
        robot=robot,
        name=name,
        profile=profile,
        rate_hz=rate,
        listen=tuple(listen or ()),
        connect=tuple(connect or ()),
        zenoh_config=zenoh_config,
        seconds=seconds,
        insecure=insecure,
        state=state,
    )
    try:
        run_service(options, log)
    except ServiceError as error:
        if IN_USE not in str(error):
            raise
        text = f"{error}; is another `ssm run` listening there? Use --listen for another endpoint"
        raise ServiceError(text) from error

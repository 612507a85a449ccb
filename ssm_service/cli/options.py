"""Options that several commands share, each spelt and explained once."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from ..errors import ConfigError

LONGEST_TIMEOUT_S = 3600.0


def number(text: str | float) -> float:
    """Read an option's number; a default is passed through here as well.

    Raises:
        typer.BadParameter: It is none; says what was found.
    """
    try:
        return float(text)
    except ValueError as error:
        raise typer.BadParameter(f"found {text!r}, allowed: a number") from error


def whole_number(text: str | int) -> int:
    """Read an option's whole number, 0 or more; a default is passed through here as well.

    Raises:
        typer.BadParameter: It is none; says what was found.
    """
    if not str(text).isdecimal():
        raise typer.BadParameter(f"found {text!r}, allowed: a whole number, 0 or more")
    return int(text)


RobotOption = Annotated[
    str, typer.Option("--robot", metavar="NAME|FILE", help="Robot file, by name or path.")
]
NameOption = Annotated[
    str | None,
    typer.Option("--name", metavar="NAME", help="Name on the network; the robot file's if left out."),
]
FollowedOption = Annotated[
    str, typer.Option("--name", "--robot", metavar="NAME", help="The robot's name on the network.")
]
ProfileOption = Annotated[
    str | None,
    typer.Option("--profile", metavar="NAME", help="Zone profile; the robot file's default if left out."),
]
ConnectOption = Annotated[
    list[str] | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Endpoint to dial; may be repeated.  \\[tcp/127.0.0.1:7447]",
        show_default=False,
    ),
]
ZenohConfigOption = Annotated[
    Path | None,
    typer.Option("--zenoh-config", metavar="FILE", help="Zenoh configuration to start from."),
]
SecondsOption = Annotated[
    float | None,
    typer.Option("--seconds", parser=number, metavar="S", help="End after this time; never if left out."),
]
TimeoutOption = Annotated[
    float, typer.Option("--timeout", parser=number, metavar="S", help="How long to wait for an answer.")
]
RateOption = Annotated[
    float, typer.Option("--rate", parser=number, metavar="HZ", help="Ticks per second, 50 to 1000.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON, for machines.")]


def checked_seconds(option: str, value: float | None) -> None:
    """Refuse a duration that is not a positive number of seconds.

    Raises:
        ConfigError: It is not.
    """
    if value is not None and not 0.0 < value < math.inf:
        raise ConfigError(option, "", value, "a number of seconds above 0")


def checked_timeout(value: float) -> None:
    """Refuse a time to wait that is not a positive number of seconds, or longer than anybody waits.

    Raises:
        ConfigError: It is not.
    """
    if not 0.0 < value <= LONGEST_TIMEOUT_S:
        allowed = f"a number of seconds above 0, at most {LONGEST_TIMEOUT_S:g}"
        raise ConfigError("--timeout", "", value, allowed)


def checked_rate(value: float) -> None:
    """Refuse a rate that the loop is not made for.

    Raises:
        ConfigError: It is out of bounds.
    """
    from ..service import MAX_RATE_HZ, MIN_RATE_HZ

    if not MIN_RATE_HZ <= value <= MAX_RATE_HZ:
        raise ConfigError("--rate", "", value, f"{MIN_RATE_HZ} to {MAX_RATE_HZ} Hz")


def endpoints(connect: list[str] | None, zenoh_config: Path | None) -> tuple[str, ...]:
    """Return the endpoints to dial: those given, else the default one unless a file says where."""
    from ..wire.session import DEFAULT_ENDPOINT

    return tuple(connect or ()) or (() if zenoh_config else (DEFAULT_ENDPOINT,))

"""``ssm keys``: certificates and locked-down Zenoh configurations, one for each role."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import ConfigError
from .options import JsonOption, number
from .output import FAILED, emit, emit_json
from .words import counted

if TYPE_CHECKING:
    from .keys_files import KeyFolder

keys = typer.Typer(
    name="keys",
    help="Make, list and renew the keys with which only known programs reach a robot.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the keys.")]
DaysOption = Annotated[
    float, typer.Option("--days", parser=number, metavar="DAYS", help="How long certificates are valid.")
]


@keys.command()
def init(
    folder: FolderArgument,
    robot: Annotated[
        str, typer.Option("--robot", metavar="NAME[,NAME…]", help="Names of the robots on the network.")
    ] = "ur3",
    host: Annotated[
        list[str] | None,
        typer.Option(
            "--host",
            metavar="HOST",
            help="Name or address of the machine that listens; may be repeated, the first is dialled."
            "  \\[127.0.0.1]",
            show_default=False,
        ),
    ] = None,
    port: Annotated[
        int, typer.Option("--port", help="Where it listens; without a router, each robot takes the next.")
    ] = 7447,
    router: Annotated[
        bool, typer.Option("--router", help="All dial a router on that machine; no service listens.")
    ] = False,
    simulation: Annotated[
        bool, typer.Option("--simulation", help="Also a role for `ssm sim`, which drives and commands.")
    ] = False,
    days: DaysOption = 365.0,
    at: Annotated[
        str | None,
        typer.Option("--at", metavar="PATH", help="Where programs will find DIR; here if left out."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the keys that are there.")] = False,
    json: JsonOption = False,
) -> None:
    """Make an authority, and for each role a certificate and a Zenoh configuration.

    Roles: service, driver (joints and sensors, obeys), commander (targets,
    reset), viewer (listens and asks). Each has a folder of its own to be
    carried to where it runs; everything that its role does not need is denied.
    """
    from .keys_files import KeyFolder
    from .keys_network import Network

    _check_days(days)
    network = Network(
        robots=tuple(robot.split(",")),
        hosts=tuple(host or ("127.0.0.1",)),
        router=router,
        port=port,
        simulation=simulation,
    )
    made = KeyFolder(path=folder, network=network, at=PurePosixPath(at or folder.resolve()))
    files = made.create(days, force=force)
    if json:
        emit_json({"folder": str(folder), "files": [str(file) for file in files], "next": _next(made)})
        return
    emit(f"{folder}: {counted(len(network.members()), 'certificate')}, valid for {days:g} days")
    emit("Carry each folder to where it is used. Keep the authority's key where no robot is:")
    emit(f"  {folder / 'authority' / 'authority.key'}")
    emit("Then:")
    for line in _next(made):
        emit(f"  {line}")


@keys.command()
def show(folder: FolderArgument, json: JsonOption = False) -> None:
    """List the certificates and when they expire.

    Exit status 1: one has expired.
    """
    from .keys_files import KeyFolder

    found = [_described(name, path) for name, path in KeyFolder.load(folder).certificates()]
    if json:
        emit_json({"folder": str(folder), "certificates": found})
    else:
        for one in found:
            mark = {"valid": "", "soon": "  expires soon", "expired": "  EXPIRED"}[one["state"]]
            emit(f"{one['name']:24} until {one['ends']}  {one['days_left']:8.1f} days{mark}")
    if any(one["state"] == "expired" for one in found):
        raise typer.Exit(FAILED)


@keys.command()
def renew(
    folder: FolderArgument,
    name: Annotated[
        list[str] | None,
        typer.Option("--name", metavar="NAME", help="Whose, e.g. driver-ur3; may be repeated.  \\[all]"),
    ] = None,
    days: DaysOption = 365.0,
    json: JsonOption = False,
) -> None:
    """Make new certificates with the same authority; a running program takes them at its next start."""
    from .keys_files import KeyFolder

    _check_days(days)
    names = [member.name for member in KeyFolder.load(folder).renew(days, tuple(name or ()))]
    if json:
        emit_json({"folder": str(folder), "renewed": names, "days": days})
    else:
        emit(f"renewed for {days:g} days: {', '.join(names)}")


def _check_days(days: float) -> None:
    from .keys_files import LONGEST_DAYS

    if not 0.0 < days <= LONGEST_DAYS:
        raise ConfigError("--days", "", days, f"above 0, at most {LONGEST_DAYS:g}")


def _described(name: str, path: Path) -> dict[str, Any]:
    from .keys_certificates import EXPIRES_SOON_DAYS, read_certificate

    found = read_certificate(path)
    left = found.days_left()
    state = "expired" if left <= 0 else "soon" if left < EXPIRES_SOON_DAYS else "valid"
    return {
        "name": name,
        "common_name": found.name,
        "hosts": found.hosts,
        "ends": f"{found.ends:%Y-%m-%d %H:%M} UTC",
        "days_left": left,
        "state": state,
    }


def _next(made: KeyFolder) -> list[str]:
    """Return the commands that use the keys."""
    commands = {
        "router": "python docker/router.py {file}",
        "service": "ssm run --robot {robot} --name {robot} --zenoh-config {file}",
        "simulation": "ssm sim --robot {robot} --name {robot} --zenoh-config {file}",
        "driver": "ssm check {file}          # for your driver: zenoh.Config.from_file",
        "commander": "ssm zone --name {robot} --zenoh-config {file}",
        "viewer": "ssm watch --name {robot} --zenoh-config {file}",
    }
    return [
        commands[member.role].format(robot=member.robots[0], file=made.config_of(member))
        for member in made.network.members()
    ]

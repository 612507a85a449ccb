"""``ssm sim``: a simulated robot to talk to."""

from __future__ import annotations

from typing import Annotated

import typer

from ..errors import NoServiceError
from .options import (
    ConnectOption,
    JsonOption,
    NameOption,
    RobotOption,
    SecondsOption,
    ZenohConfigOption,
    checked_seconds,
    endpoints,
    whole_number,
)
from .output import emit_json, log


def sim(
    robot: RobotOption = "ur3",
    name: NameOption = None,
    scenario: Annotated[
        str,
        typer.Option(
            "--scenario", metavar="NAME|FILE", help="What happens round the robot, by name or path."
        ),
    ] = "crossing",
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    seconds: SecondsOption = None,
    seed: Annotated[
        int, typer.Option("--seed", parser=whole_number, metavar="N", help="Seed of the sensors' errors.")
    ] = 0,
    tracker: Annotated[
        bool, typer.Option(help="Send tracked obstacles; otherwise only the sensor rings see them.")
    ] = True,
    json: JsonOption = False,
) -> None:
    """Simulate a robot, its sensors and its surroundings, which talk to a service as drivers would.

    Waits for the service, `ssm run`, and goes on with a restarted one; Ctrl-C
    ends it.
    """
    checked_seconds("--seconds", seconds)
    from ..simulation import SimulationOptions, run_simulation

    where = endpoints(connect, zenoh_config)
    options = SimulationOptions(
        robot=robot,
        name=name,
        scenario=scenario,
        connect=where,
        zenoh_config=zenoh_config,
        seconds=seconds,
        seed=seed,
        track_obstacles=tracker,
    )
    summary = run_simulation(options, log)
    if not summary["connected"] and seconds is not None:
        raise NoServiceError(
            f"no service answered at {', '.join(where) or zenoh_config} within {seconds:g} s"
        )
    if json:
        emit_json(summary)
    else:
        log(
            f"ended: {summary['simulated_s']:.1f} s simulated, {summary['steps']} steps, "
            f"{summary['watchdog_stops']} watchdog stops"
        )

"""``ssm demo``: service, simulated robot and consumer as three processes on this machine's loopback."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from .._version import __version__
from ..errors import NoServiceError
from .options import JsonOption, ProfileOption, RateOption, RobotOption, checked_rate, checked_seconds, number
from .output import emit, emit_json, log

if TYPE_CHECKING:
    from ..client import Connection, Follower
    from ..model import Robot
    from ..wire import Keys
    from .live import LiveState
    from .processes import Children
    from .recording import Recorder, Recording

START_TIMEOUT_S: Final = 60.0
"""A first start builds caches and reads meshes from a cold disk."""

SETTLING_S: Final = 2.0
POLL_S: Final = 0.001
CHILD_CHECK_S: Final = 0.1
LINE_PERIOD_S: Final = 2.0
ENDING_S: Final = 30.0
"""After this much more than the time asked for, the children end by themselves in any case."""


def demo(
    seconds: Annotated[
        float, typer.Option("--seconds", parser=number, metavar="S", help="How long to record.")
    ] = 20.0,
    scenario: Annotated[
        str, typer.Option("--scenario", metavar="NAME|FILE", help="What happens round the robot.")
    ] = "crossing",
    robot: RobotOption = "ur3",
    profile: ProfileOption = None,
    rate: RateOption = 500.0,
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Where the report goes; made if need be.")
    ] = Path("ssm-report"),
    json: JsonOption = False,
) -> None:
    """Show it all: the service, a simulated robot with its sensors, and a consumer that follows.

    Needs no robot and no network: processes on this machine's loopback, on a
    free port. Ends with a summary, and a folder with summary.json and
    figures. Ctrl-C ends the recording early and still writes the report.
    """
    checked_seconds("--seconds", seconds)
    from .processes import Children, unwinding_on_termination

    with unwinding_on_termination(), Children() as children:
        endpoint = _start(children, robot, profile, scenario, rate, seconds)
        # Imports take their time, also those of a check: they are done while the children do theirs.
        from .figures import prepare
        from .report import SUMMARY, ReportFolder
        from .summary import summarise
        from .summary_words import row_lines, summary_lines

        checked_rate(rate)
        loaded, name = _loaded(robot, profile, scenario)
        log(f"starting service and simulation on {endpoint}")
        prepare()
        with ReportFolder(out) as folder:
            title = f"ssm demo · {loaded.name} · {name}"
            recording = _record(children, endpoint, loaded, title, seconds, json)
            children.stop()
            summary = _labels(name, rate, seconds) | summarise(recording)
            folder.write(summary, recording, loaded)
    if json:
        emit_json(summary, indent=2)
    else:
        files = f"{out}/{SUMMARY}, {', '.join(summary['figures'])}"
        log("")
        for text in (*summary_lines(summary), *row_lines("report", files)):
            emit(text)


def _start(
    children: Children, robot: str, profile: str | None, scenario: str, rate: float, seconds: float
) -> str:
    """Start both other processes and return the service's endpoint."""
    from .processes import free_port

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    common = ["--robot", robot, "--seconds", str(seconds + START_TIMEOUT_S + ENDING_S)]
    service = ["--rate", str(rate), "--listen", endpoint, "--state", str(children.folder)]
    if profile is not None:
        service += ["--profile", profile]
    children.start("service", "run", *common, *service)
    children.start("simulation", "sim", *common, "--scenario", scenario, "--connect", endpoint)
    return endpoint


def _loaded(robot: str, profile: str | None, scenario: str) -> tuple[Robot, str]:
    """Return the robot and the scenario's name.

    Raises:
        ConfigError: One of the three is not there or not right.
    """
    from ..model import Robot
    from ..monitor import zone_profile
    from ..simulation import load_scenario

    loaded = Robot.load(robot)
    zone_profile(loaded, profile)
    return loaded, load_scenario(scenario, loaded).name


def _record(
    children: Children, endpoint: str, robot: Robot, title: str, seconds: float, json: bool
) -> Recording:
    """Follow the service for the time asked for, or until Ctrl-C.

    Raises:
        NoServiceError: There was nothing to record.
        ServiceError: A child ended.
    """
    from ..client import Connection
    from ..wire import Keys
    from .live import LiveState

    keys = Keys(robot.name)
    connection = Connection([endpoint])
    try:
        follower, recorder = _ready(children, connection, keys, robot)
        _settle(follower, recorder)
        try:
            log("ready; following")  # who reads this may send Ctrl-C before it has returned
            _follow(children, follower, recorder, LiveState(title=title, seconds=seconds), quiet=json)
        except KeyboardInterrupt:
            log("ended early")
        recording = recorder.end()
    finally:
        connection.close()
    if not recording.decisions:
        raise NoServiceError("no decision was received")
    return recording


def _ready(children: Children, connection: Connection, keys: Keys, robot: Robot) -> tuple[Follower, Recorder]:
    """Return consumer and recorder as soon as both others speak."""
    from ..client import Follower
    from .recording import Recorder

    deadline = time.monotonic() + START_TIMEOUT_S
    session = _waited(children, deadline, "the service to listen", lambda: connection.session)
    gc.collect()
    gc.freeze()  # a collection would hold this consumer up for longer than a decision is valid
    _waited(children, deadline, "the service to be ready", lambda: _alive(session, keys.alive))
    recorder, follower = Recorder(session, keys, robot.joint_names), Follower(session, keys)

    def everyone_speaks() -> bool:
        recorder.drain()
        heard = recorder.recording
        return bool(heard.decisions and heard.joints) and not follower.poll().stopped_by_consumer

    _waited(children, deadline, "decisions and joint states", everyone_speaks, every_s=POLL_S)
    return follower, recorder


def _settle(follower: Follower, recorder: Recorder) -> None:
    """Let the first `waiting:…` pass; a stop that stays is recorded as what it is."""
    end = time.monotonic() + SETTLING_S
    while follower.poll().zone.word == "stop" and time.monotonic() < end:
        recorder.drain()
        time.sleep(POLL_S)


def _follow(
    children: Children, follower: Follower, recorder: Recorder, state: LiveState, *, quiet: bool
) -> None:
    """Record and show until the time is over."""
    from .display import Display
    from .live import draw, line
    from .meters import Ticker
    from .telling import Telling

    seconds = state.seconds or 0.0
    lines, checks = Ticker(LINE_PERIOD_S), Ticker(CHILD_CHECK_S)
    with Display(lambda size: draw(state, size), quiet=quiet) as display:
        recorder.begin()
        telling = Telling(state, recorder)
        while recorder.elapsed < seconds:
            telling.update(follower.poll())
            if checks.due():
                children.check()
            if not display.shown and lines.due():
                log(line(state))
            time.sleep(POLL_S)


def _waited(
    children: Children, deadline: float, what: str, look: Callable[[], Any], every_s: float = 0.02
) -> Any:
    """Return what ``look`` gives as soon as that is something.

    Raises:
        NoServiceError: Not in time.
        ServiceError: A child ended.
    """
    from .meters import Ticker

    said = Ticker(5.0)
    said.due()  # the first line only after a while
    while not (found := look()):
        children.check()
        if time.monotonic() > deadline:
            words = children.last_words("service")
            raise NoServiceError(f"waited {START_TIMEOUT_S:g} s for {what}; the service said:\n{words}")
        if said.due():
            log(f"waiting for {what} …")
        time.sleep(every_s)
    return found


def _alive(session: Any, key: str) -> bool:
    return any(reply.ok is not None for reply in session.liveliness().get(key, timeout=1.0))


def _labels(scenario: str, rate: float, seconds: float) -> dict[str, Any]:
    return {
        "version": __version__,
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "scenario": scenario,
        "asked_rate_hz": rate,
        "asked_seconds": seconds,
    }

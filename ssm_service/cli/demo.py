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
from ..errors import ConfigError, NoServiceError
from .options import JsonOption, RateOption, RobotOption, checked_rate, checked_seconds, number
from .output import emit, emit_json, log

if TYPE_CHECKING:
    from ..client import Connection, Follower
    from ..model import Robot
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
    rate: RateOption = 500.0,
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Where the report goes; made if need be.")
    ] = Path("ssm-report"),
    json: JsonOption = False,
) -> None:
    """Show the whole of it: the service, a simulated robot with its sensors, and a consumer that follows.

    Three processes on this machine's loopback, on a free port. Ends with a summary, and a folder with
    summary.json and figures. Ctrl-C ends the recording early and still writes the report.
    """
    checked_rate(rate)
    checked_seconds("--seconds", seconds)
    from ..model import Robot
    from ..simulation import load_scenario
    from .processes import Children, unwinding_on_termination
    from .summary import summarise
    from .summary_words import summary_lines

    loaded = Robot.load(robot)
    name = load_scenario(scenario, loaded).name
    _make_folder(out)
    with unwinding_on_termination(), Children() as children:
        connection = _start(children, loaded, scenario, rate, seconds)
        try:
            recording = _record(
                children, connection, loaded, f"ssm demo · {loaded.name} · {name}", seconds, json
            )
        finally:
            connection.close()
    if not recording.decisions:
        raise NoServiceError("no decision was received")
    summary = _labels(name, rate, seconds) | summarise(recording)
    _write(out, summary, recording, loaded)
    if json:
        emit_json(summary, indent=2)
    else:
        for text in summary_lines(summary):
            emit(text)
        emit(f"{'report':<16}{out}/summary.json, {', '.join(summary['figures'])}")


def _start(children: Children, robot: Robot, scenario: str, rate: float, seconds: float) -> Connection:
    """Start both other processes and return a connection to the service."""
    from ..client import Connection
    from .processes import free_port

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    log(f"starting service and simulation on {endpoint}")
    common = ["--robot", robot.config.path, "--name", robot.name]
    common += ["--seconds", str(seconds + START_TIMEOUT_S + ENDING_S)]
    children.start("service", "run", *common, "--rate", str(rate), "--listen", endpoint)
    children.start("simulation", "sim", *common, "--scenario", scenario, "--connect", endpoint)
    from . import figures

    figures.prepare()  # while they start
    return Connection([endpoint])


def _record(
    children: Children, connection: Connection, robot: Robot, title: str, seconds: float, json: bool
) -> Recording:
    from ..client import Follower
    from ..wire import Keys
    from .live import LiveState
    from .recording import Recorder

    keys = Keys(robot.name)
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
    _settle(follower, recorder)
    log("ready; recording")
    try:
        _follow(children, follower, recorder, LiveState(title=title, seconds=seconds), quiet=json)
    except KeyboardInterrupt:
        log("ended early")
    return recorder.end()


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
    from .live import Display, Ticker, draw, line
    from .telling import Telling

    seconds = state.seconds or 0.0
    lines, checks = Ticker(LINE_PERIOD_S), Ticker(CHILD_CHECK_S)
    with Display(lambda: draw(state), quiet=quiet) as display:
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
    from .live import Ticker

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


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "summary.json").unlink(missing_ok=True)  # of an earlier run
    except OSError as error:
        raise ConfigError("--out", "", str(out), f"a folder to write to ({error.strerror})") from error


def _write(out: Path, summary: dict[str, Any], recording: Recording, robot: Robot) -> None:
    import msgspec

    from .figures import write_figures

    summary["figures"] = write_figures(out, recording, robot)
    data = msgspec.json.format(msgspec.json.encode(summary), indent=2)
    (out / "summary.json").write_bytes(data + b"\n")

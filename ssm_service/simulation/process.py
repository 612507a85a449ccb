"""The simulation as a process of its own: it speaks to a service only over the network, as drivers do."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, TypedDict

import zenoh

from ..client import Connection, Follower
from ..model import Robot
from ..service import Beat, FixedRateLoop
from ..service.realtime import SpareTimeCollector, apply_realtime, few_arenas
from ..wire import Keys
from ..wire.session import DEFAULT_ENDPOINT
from .drivers import Drivers
from .load import load_scenario
from .obeying import Obeying
from .scenario import Scenario
from .world import World

PERIOD_NS = 2_000_000
"""Time from step to step [ns]: 500 Hz."""

PATIENCE_S = 0.3
"""Time after which it is said that nobody is there yet [s]."""


class Summary(TypedDict):
    """How a run went.

    ``steps`` were taken; in ``obeyed`` of them a service's decision was valid; it ceased to be so
    ``watchdog_stops`` times; the longest time between two steps was ``longest_gap_s``.
    """

    scenario: str
    connected: bool
    simulated_s: float
    steps: int
    skipped: int
    obeyed: int
    watchdog_stops: int
    limit_hits: int
    longest_gap_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationOptions:
    """How to run the simulation.

    Attributes:
        robot: Name or path of a robot file.
        name: Name of the robot on the network; the file's where left out.
        scenario: Name or path of a scenario.
        connect: Endpoints of the service.
        zenoh_config: Zenoh configuration file to start from.
        seconds: End by itself after this time, waiting for the service included.
        seed: Seed of the sensors' errors.
        track_obstacles: Whether a tracker sends the obstacles; otherwise only the sensor rings see them.
        realtime: Whether to ask the operating system for a steady loop, as a controller has one.
    """

    robot: str | Path = "ur3"
    name: str | None = None
    scenario: str | Path = "crossing"
    connect: Sequence[str] = (DEFAULT_ENDPOINT,)
    zenoh_config: Path | None = None
    seconds: float | None = None
    seed: int = 0
    track_obstacles: bool = True
    realtime: bool = True


class Simulation:
    """One simulated robot on an open session.

    Args:
        session: The session, which finds back to a restarted service by itself; or a ``Connection``, which
            also replaces one that does not.
        options: How to run.
        robot: The robot.
        scenario: The scenario.
        log: Where lines for people go.
        on_step: Called after each step, for tests and displays; it must be quick.
    """

    def __init__(
        self,
        session: zenoh.Session | Connection,
        options: SimulationOptions,
        robot: Robot,
        scenario: Scenario,
        log: Callable[[str], None],
        on_step: Callable[[Simulation], None] | None = None,
    ) -> None:
        keys = Keys(options.name or robot.name)
        self.world = World(robot, scenario, seed=options.seed, track_obstacles=options.track_obstacles)
        self._follower = Follower(session, keys)
        self.obeying = Obeying(self.world, self._follower)
        self._drivers = Drivers(session, keys, robot)
        self._log = log
        self._on_step = on_step
        self._said: object = None
        self._previous_ns: int | None = None
        self._steps = self._skipped = self._longest_gap_ns = 0

    def step(self, beat: Beat) -> None:
        """Take one step; time that was missed is caught up within it, messages are not."""
        if self._previous_ns is not None:
            self._longest_gap_ns = max(self._longest_gap_ns, beat.now_ns - self._previous_ns)
        self._previous_ns = beat.now_ns
        self._steps += 1
        self._skipped += beat.skipped
        self.obeying.step((1 + beat.skipped) * PERIOD_NS * 1e-9, beat.now_ns)
        self._drivers.send(self.world.emit(), self._follower.heard)
        self._tell()
        if self._on_step is not None:
            self._on_step(self)

    def summary(self) -> Summary:
        """Return how the run went so far."""
        return Summary(
            scenario=self.world.scenario.name,
            connected=True,
            simulated_s=self.world.time_s,
            steps=self._steps,
            skipped=self._skipped,
            obeyed=self.obeying.obeyed,
            watchdog_stops=self.obeying.watchdog_stops,
            limit_hits=self.world.plant.limit_hits,
            longest_gap_s=self._longest_gap_ns * 1e-9,
        )

    def close(self) -> None:
        """Stop listening."""
        self._follower.close()

    def _tell(self) -> None:
        """Say when the plant begins or ceases to be commanded, and why."""
        followed = self.obeying.followed
        if followed is None:
            return
        if self.obeying.misfit:
            says = (
                f"the service's joints are not this robot's, so it stands still: {', '.join(followed.name)}"
            )
        elif followed.stopped_by_consumer:
            says = f"stopped by its own watchdog: {', '.join(followed.reasons)}"
        else:
            says = "obeys the service"
        if says != self._said:
            self._said = says
            self._log(says)


def run_simulation(
    options: SimulationOptions,
    log: Callable[[str], None],
    on_step: Callable[[Simulation], None] | None = None,
) -> Summary:
    """Simulate a robot, its sensors and its surroundings until SIGINT, SIGTERM or the end of the time.

    It waits for a service that is not there yet, and goes on by itself when the service is restarted;
    while none speaks, the plant stands still.

    Args:
        options: What to simulate and where the service is.
        log: Where lines for people go.
        on_step: Called after each step.

    Raises:
        ConfigError: The robot file, the scenario or the Zenoh configuration is wrong.
    """
    few_arenas()
    robot = Robot.load(options.robot)
    scenario = load_scenario(options.scenario, robot)
    if scenario.remark:
        log(scenario.remark)
    connection = Connection(options.connect, options.zenoh_config)
    end = None if options.seconds is None else time.monotonic() + options.seconds
    with _until_signal() as flag:

        def running() -> bool:
            """Tell whether neither a signal nor the end of the time has come."""
            return not flag.up and (end is None or time.monotonic() < end)

        try:
            if not _connected(connection, options, running, log):
                return _never_connected(scenario)
            if options.realtime:
                _done, refused = apply_realtime()
                if refused:
                    log(f"not permitted: {'; '.join(refused)}")
            simulation = Simulation(connection, options, robot, scenario, log, on_step)
            try:
                FixedRateLoop(PERIOD_NS, spin_ns=0).run(simulation.step, SpareTimeCollector().work, running)
            finally:
                simulation.close()
            return simulation.summary()
        finally:
            connection.close()


def _connected(
    connection: Connection,
    options: SimulationOptions,
    running: Callable[[], bool],
    log: Callable[[str], None],
) -> bool:
    """Wait until a service is there; ``False`` if the run ended before."""
    begin, waiting = time.monotonic(), False
    while running():
        if connection.session is not None:
            return True
        if not waiting and time.monotonic() - begin > PATIENCE_S:
            log(f"waiting for a service at {', '.join(options.connect) or 'the endpoints of the file'}")
            waiting = True
        time.sleep(0.02)
    return False


def _never_connected(scenario: Scenario) -> Summary:
    return Summary(
        scenario=scenario.name,
        connected=False,
        simulated_s=0.0,
        steps=0,
        skipped=0,
        obeyed=0,
        watchdog_stops=0,
        limit_hits=0,
        longest_gap_s=0.0,
    )


class _Flag:
    """Raised by a signal handler; a ``threading.Event`` would take a lock there, which can block for good."""

    def __init__(self) -> None:
        self.up = False


@contextmanager
def _until_signal() -> Iterator[_Flag]:
    """Give a flag that SIGINT and SIGTERM raise; outside the main thread, one that nobody raises."""
    flag = _Flag()
    if threading.current_thread() is not threading.main_thread():
        yield flag
        return

    def stop(_number: int, _frame: FrameType | None) -> None:
        """Raise the flag."""
        flag.up = True

    before: dict[int, Any] = {
        number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield flag
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

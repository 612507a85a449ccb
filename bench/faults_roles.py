"""The processes of ``bench.faults``, each started as ``python -m bench.faults_roles ROLE OPTIONS``.

They say what happens on stdout, one JSON object a line, with times of the monotonic clock, which Linux keeps
for the whole machine. All of them wait for a line on stdin before they begin, so that the next of a kind can
stand by with everything imported.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from typing import Any

import msgspec
import numpy as np

from ssm_service.client import Client, Connection, Followed, Follower
from ssm_service.model import Robot
from ssm_service.monitor import Target
from ssm_service.safety import Zone
from ssm_service.service import Beat, FixedRateLoop, ServiceOptions, run_service
from ssm_service.simulation.drivers import Drivers
from ssm_service.simulation.load import load_scenario
from ssm_service.simulation.obeying import Obeying
from ssm_service.simulation.world import Emitted, World
from ssm_service.wire import Keys
from ssm_service.wire import messages as m
from ssm_service.wire.integrity import Heard

from .faults_chaos import chaos, say
from .faults_sensors import Sensors

STEP_NS = 4_000_000
LOOK_S = 0.0005
SWING_RAD, SWING_RAD_S = 0.05, 0.1

STANDS_AFTER_NS = 300_000_000
"""After this long in a stop the simulated robot must stand: fifteen time constants of its joints [ns]."""

LATE_NS = 2_000_000
"""From one look at the clock to the next, in a loop that asks and then acts, at most [ns]."""


def serve(*, robot: str, name: str, profile: str, rate_hz: float, endpoint: str) -> None:
    """Run the service as ``ssm run`` does."""
    options = ServiceOptions(robot=robot, name=name, profile=profile, rate_hz=rate_hz, listen=(endpoint,))

    def log(text: str) -> None:
        say({"log": text})
        if text == "ready":
            say({"ready": True})

    run_service(options, log)


def watch(*, name: str, endpoint: str) -> None:
    """Follow zone and command as any consumer does, and say whenever what holds changes."""
    with Client(name, connect=(endpoint,)) as client:
        follower = client.follower()
        teller = Teller(follower)
        say({"ready": True})
        _until_stdin_closes()
        while not _closed.is_set():
            teller.tell(follower.poll())
            time.sleep(LOOK_S)
        follower.close()


class Teller:
    """Says what a consumer holds whenever that changes, and counts what must never be.

    Args:
        follower: The consumer's watchdog.
    """

    def __init__(self, follower: Follower) -> None:
        self._follower = follower
        self._said: tuple[Any, ...] = ()
        self._rejected: dict[str, int] = {}
        self.expired = 0

    def tell(self, followed: Followed) -> None:
        """Take what was just polled."""
        now = time.monotonic_ns()
        stopped = followed.zone is Zone.STOP
        if not stopped and now >= followed.expires_ns + LATE_NS:
            # Between the poll's own look at the clock and this one: only a pause of the process can do that.
            again = self._follower.poll()
            self.expired += again is followed and time.monotonic_ns() >= followed.expires_ns + LATE_NS
        moves = any(abs(value) > 1e-9 for value in followed.velocity)
        believed = _believed(followed)
        held = (followed.zone, followed.reasons, followed.stopped_by_consumer, moves, believed)
        rejected = dict(self._follower.watchdog.rejected)
        key = (*held, self._follower.watchdog.lost, self.expired)
        if key == self._said and rejected == self._rejected:
            return
        self._said, self._rejected = key, rejected
        say(
            {
                "t": now,
                "zone": followed.zone.word,
                "own": followed.stopped_by_consumer,
                "reasons": followed.reasons,
                "moves": moves,
                "believed": believed,
                "rejected": self._rejected,
                "expired": self.expired,
                "lost": self._follower.watchdog.lost,
            }
        )


def _believed(followed: Followed) -> tuple[str, ...]:
    """Return the fresh sources that speak of a clear scene, which is never true here."""
    sources = {} if followed.zone_message is None else followed.zone_message.sources
    if "joints" not in sources or sources["joints"].state != "fresh":
        return ()  # without joints nothing is looked at
    return tuple(
        name
        for name, source in sources.items()
        if name in ("ranges", "obstacles")
        and source.state == "fresh"
        and (source.distance is None or source.distance > 0.4)
    )


def plant(*, robot: str, scenario: str, name: str, endpoint: str, seed: int) -> None:
    """Be the robot with its sensors, obeying the service; do to the sensors what the bench says."""
    loaded = Robot.load(robot)
    keys = Keys(name)
    connection = Connection((endpoint,))
    connection.wait(30.0)
    world = World(loaded, load_scenario(scenario, loaded), seed=seed)
    follower = Follower(connection, keys)
    process = Plant(world, follower, Drivers(connection, keys, loaded))
    say({"ready": True})
    threading.Thread(target=process.listen, daemon=True).start()
    FixedRateLoop(STEP_NS, spin_ns=0).run(process.step, lambda _until: None, lambda: not _closed.is_set())
    follower.close()
    connection.close()


SOURCE_OF = {kind: source for source, kind in m.INPUTS.items()}


class Plant:
    """The robot, its sensors and their faults, step by step.

    Args:
        world: The simulated world.
        follower: The robot's own watchdog.
        drivers: The drivers.
    """

    def __init__(self, world: World, follower: Follower, drivers: Drivers) -> None:
        self.world = world
        self.obeying = Obeying(world, follower)
        self._follower = follower
        self._drivers = drivers
        self._sensors = Sensors(world.robot)
        self._said: tuple[Any, ...] = ()
        self._overdue = self._stopped_ns = 0
        self._lock = threading.Lock()

    def listen(self) -> None:
        """Take faults from stdin until it closes."""
        for line in sys.stdin:
            wish = json.loads(line)
            with self._lock:
                self._sensors.begin(wish)
        _closed.set()

    def step(self, beat: Beat) -> None:
        """Obey for one step, then send what is due."""
        self.obeying.step((1 + beat.skipped) * STEP_NS * 1e-9, beat.now_ns)
        followed = self.obeying.followed
        heard = None
        if followed is not None and followed.zone_message is not None:
            heard = Heard(followed.zone_message.producer, followed.zone_message.seq)
        with self._lock:
            emitted = self._sensors.emitted(_swinging(self.world))
            for message in self._drivers.messages(emitted):
                source = SOURCE_OF[type(message)]
                head, payload = self._sensors.payload(source, message)
                self._drivers.put(source, payload, head, heard)
            self._sensors.sent()
        if followed is not None:
            self._tell(followed)

    def _tell(self, followed: Followed) -> None:
        held = bool(self.obeying.command.any())
        stopped = followed.zone is Zone.STOP
        now = time.monotonic_ns()
        self._stopped_ns = (self._stopped_ns or now) if stopped else 0
        standing = stopped and now - self._stopped_ns > STANDS_AFTER_NS
        self._overdue += stopped and (
            held or (standing and bool(np.abs(self.world.plant.velocity).max() > 1e-4))
        )
        rejected = dict(self._follower.watchdog.rejected)
        key = (stopped, followed.reasons, held, self._overdue, rejected)
        if key != self._said:
            self._said = key
            say(
                {
                    "t": time.monotonic_ns(),
                    "zone": followed.zone.word,
                    "own": followed.stopped_by_consumer,
                    "reasons": followed.reasons,
                    "moves": held,
                    "overdue": self._overdue,
                    "rejected": rejected,
                }
            )


def _swinging(world: World) -> Emitted:
    """Return what is due, with a target that swings the arm about its start, whatever stops it meanwhile."""
    emitted = world.emit()
    if emitted.target is None:
        return emitted
    away = world.plant.position - world.scenario.start
    wanted = -2.0 * away
    # The sign of the last leg, turned at the ends of the swing: no clock, so that stops do not add up.
    forward = world.plant.velocity[0] >= 0.0 if abs(away[0]) < SWING_RAD else away[0] < 0.0
    wanted[0] = SWING_RAD_S if forward else -SWING_RAD_S
    return Emitted(
        joints=emitted.joints,
        ranges=emitted.ranges,
        obstacles=emitted.obstacles,
        target=Target(kind="joint_velocity", value=wanted),
    )


def burn(*, seconds: float) -> None:
    """Use a processor up for a while, at a higher priority than the others where that is permitted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
        raised = "SCHED_FIFO 60"
    except OSError:
        raised = "as the others"
    begun_ns = time.monotonic_ns()
    while time.monotonic_ns() - begun_ns < seconds * 1e9:
        sum(range(2_000))
    # The end of a process this large takes a tenth of a second, at the priority that it then has.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    say({"ready": True, "priority": raised, "begun_ns": begun_ns, "ended_ns": time.monotonic_ns()})


_closed = threading.Event()


def _until_stdin_closes() -> None:
    def wait() -> None:
        sys.stdin.read()
        _closed.set()

    threading.Thread(target=wait, daemon=True).start()


ROLES = {role.__name__: role for role in (serve, watch, plant, chaos, burn)}


def main_of(role: str, options: dict[str, Any]) -> None:
    """Stand by until a line comes, then be the role."""
    say({"standing_by": True})
    if sys.stdin.readline():
        ROLES[role](**options)


if __name__ == "__main__":
    main_of(sys.argv[1], msgspec.json.decode(sys.argv[2]))

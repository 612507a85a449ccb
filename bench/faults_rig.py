"""Starts, stops and listens to the processes of ``bench.faults``."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ssm_service.client import Client
from ssm_service.errors import SsmError
from ssm_service.wire import messages as m

from .latency import free_endpoint

HERE = Path(__file__).parent
ROBOT = HERE / "faults_robot.toml"
SCENARIO = HERE / "faults_scenario.toml"
NAME = "faults"

Event = dict[str, Any]


class Process:
    """One role in a process of its own, and what it has said.

    Args:
        role: The role.
        options: Its arguments.
        environment: Variables beside this process's own.
    """

    def __init__(self, role: str, options: dict[str, Any], environment: dict[str, str]) -> None:
        self.role = role
        self.events: deque[Event] = deque(maxlen=20_000)
        self.changed = threading.Condition()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.faults_roles", role, json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | environment,
            cwd=HERE.parent,
        )
        self.errors: deque[str] = deque(maxlen=50)
        self._threads = [
            threading.Thread(target=self._hear, daemon=True),
            threading.Thread(target=self._hear_errors, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def say(self, **wish: Any) -> None:
        """Send it one line."""
        if self._process.stdin is not None:
            self._process.stdin.write(json.dumps(wish) + "\n")
            self._process.stdin.flush()

    def wait_for(self, found: Callable[[Event], bool], timeout_s: float, start: int = 0) -> Event | None:
        """Return the first event from number ``start`` on that ``found`` likes, or ``None`` in time."""
        deadline = time.monotonic() + timeout_s
        with self.changed:
            place = max(start - self._forgotten, 0)
            while True:
                for event in list(self.events)[place:]:
                    if found(event):
                        return event
                place = len(self.events)
                left = deadline - time.monotonic()
                if left <= 0.0 or (not self.alive and not self._threads[0].is_alive()):
                    return None
                self.changed.wait(min(left, 0.5))

    @property
    def count(self) -> int:
        """How many events it has said so far."""
        with self.changed:
            return self._forgotten + len(self.events)

    def since(self, start: int) -> list[Event]:
        """Return the events from number ``start`` on."""
        with self.changed:
            return list(self.events)[max(start - self._forgotten, 0) :]

    def signal(self, number: int) -> int:
        """Send it a signal; return the time just before [monotonic ns]."""
        now = time.monotonic_ns()
        self._process.send_signal(number)
        return now

    def end(self) -> None:
        """Kill it, if it still runs, and wait for it."""
        if self.alive:
            self._process.send_signal(signal.SIGCONT)
            self._process.kill()
        self._process.wait()
        for thread in self._threads:
            thread.join()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe is not None:
                try:
                    pipe.close()
                except BrokenPipeError:
                    continue

    def end_kindly(self, timeout_s: float = 5.0) -> None:
        """Ask it to end, and kill it if it does not."""
        if self.alive:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout_s)
        self.end()

    _forgotten = 0

    def _hear(self) -> None:
        for line in self._process.stdout or ():
            try:
                event = json.loads(line)
            except ValueError:
                event = {"log": line.rstrip()}
            with self.changed:
                self._forgotten += len(self.events) == self.events.maxlen
                self.events.append(event)
                self.changed.notify_all()

    def _hear_errors(self) -> None:
        for line in self._process.stderr or ():
            self.errors.append(line.rstrip())


class Rig:
    """Service, chaos, plant and consumer; each can be started anew while the others run.

    A context manager: whatever happens, nothing is left running.

    Args:
        profile: Zone profile.
        rate_hz: Ticks per second.
        seed: Of everything drawn.
        state_home: Where the service keeps its state.
        robot: Robot file.
    """

    def __init__(
        self,
        *,
        profile: str = "distances",
        rate_hz: float = 100.0,
        seed: int = 1,
        state_home: Path | None = None,
        robot: Path = ROBOT,
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="ssm-faults-")
        folder = Path(self._folder.name)
        self.clock = folder / "clock"
        self.clock.write_bytes(struct.pack("<q", 0))
        self.state_home = state_home or folder / "state"
        self.state_home.mkdir(exist_ok=True)
        self._environment = {
            "PYTHONPATH": f"{HERE / 'faults_clock'}:{os.environ.get('PYTHONPATH', '')}",
            "SSM_BENCH_CLOCK": str(self.clock),
            "XDG_STATE_HOME": str(self.state_home),
        }
        self.rate_hz = rate_hz
        service, chaos = free_endpoint(), free_endpoint()
        robot_text, scenario = str(robot), str(SCENARIO)
        self._options: dict[str, dict[str, Any]] = {
            "serve": {
                "robot": robot_text,
                "name": NAME,
                "profile": profile,
                "rate_hz": rate_hz,
                "endpoint": service,
            },
            "chaos": {"robot": NAME, "service": service, "listen": chaos, "seed": seed},
            "plant": {
                "robot": robot_text,
                "scenario": scenario,
                "name": NAME,
                "endpoint": chaos,
                "seed": seed,
            },
            "watch": {"name": NAME, "endpoint": chaos},
        }
        self.direct = Client(NAME, connect=(service,), timeout_s=2.0)
        self.processes: dict[str, Process] = {}
        self._spare: dict[str, Process] = {}
        self._burners: list[Process] = []
        self._number = 0

    def __enter__(self) -> Rig:
        for role in ("serve", "chaos", "plant", "watch"):
            self.prepare(role)
        for role in ("serve", "chaos", "plant", "watch"):
            self.start(role)
        return self

    def __exit__(self, *_exception: object) -> None:
        self.direct.close()
        for process in [*self._burners, *self._spare.values()]:
            process.end()
        for role in ("watch", "plant", "chaos"):
            if role in self.processes:
                self.processes[role].end()
        if "serve" in self.processes:
            self.processes["serve"].end_kindly()
        self._folder.cleanup()

    def prepare(self, role: str) -> None:
        """Have the next process of a role stand by."""
        if role not in self._spare:
            self._spare[role] = Process(role, self._options.get(role, {}), self._environment)

    def start(self, role: str) -> None:
        """Start a role, in place of one that has ended, and wait until it says that it is ready.

        Raises:
            RuntimeError: It is not within half a minute.
        """
        if role in self.processes:
            self.processes[role].end()
        self.prepare(role)
        process = self._spare.pop(role)
        self.processes[role] = process
        process.say(go=True)
        if process.wait_for(lambda event: "ready" in event, 120.0) is None:
            raise RuntimeError(
                f"'{role}' is not ready:\n" + "\n".join([*process.errors, *map(str, process.events)])
            )

    def prepare_burning(self, count: int, seconds: float) -> None:
        """Have processes stand by that will use the processors up."""
        self._burners = [Process("burn", {"seconds": seconds}, self._environment) for _ in range(count)]
        for burner in self._burners:
            burner.wait_for(lambda event: "standing_by" in event, 20.0)

    def burn(self) -> list[Event]:
        """Let them, and return what they say of it at their end."""
        for burner in self._burners:
            burner.say(go=True)
        said = [burner.wait_for(lambda event: "ready" in event, 20.0) for burner in self._burners]
        for burner in self._burners:
            burner.end()
        self._burners.clear()
        return [event for event in said if event is not None]

    def shift_clock(self, seconds: float) -> None:
        """Shift the wall clock of all processes of this rig."""
        with self.clock.open("r+b") as file:
            file.write(struct.pack("<q", int(seconds * 1e9)))

    def inject(self, role: str, **wish: Any) -> int:
        """Have ``chaos`` or ``plant`` begin a fault; return its number."""
        self._number += 1
        self.processes[role].say(id=self._number, **wish)
        return self._number

    def done(self, role: str, number: int, timeout_s: float) -> Event | None:
        """Return what a role says of a fault that is over."""
        return self.processes[role].wait_for(lambda event: event.get("done") == number, timeout_s)

    def health(self) -> m.Health | None:
        """Return the service's counters, asked for on the short way; ``None`` while it does not answer."""
        try:
            return self.direct.health()
        except SsmError:
            return None

    def last(self, role: str) -> Event:
        """Return the newest event of a role that says what holds."""
        process = self.processes[role]
        for event in reversed(process.since(process.count - 50)):
            if "zone" in event:
                return event
        return {}

    def calm(self, timeout_s: float, settle_s: float = 0.03) -> bool:
        """Wait until the consumer and the robot are told to go on, and have been for ``settle_s``."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            held = [self.last("watch"), self.last("plant")]
            if all(event.get("zone", "stop") != "stop" and event["moves"] for event in held):
                left = settle_s - (time.monotonic_ns() - max(event["t"] for event in held)) * 1e-9
                if left <= 0.0:
                    return True
                time.sleep(left)
            else:
                time.sleep(0.002)
        return False

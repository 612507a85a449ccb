"""A robot behind mutual TLS, its good company, and attackers, on 127.0.0.1."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import zenoh

from ssm_service.cli.keys_certificates import Pair, make_certificate
from ssm_service.cli.keys_files import KeyFolder
from ssm_service.cli.keys_network import Network

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
RATE_HZ = 200
SEVERITY = {"green": 0, "yellow": 1, "red": 2, "stop": 3}

JOINTS = sorted(
    ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"],
)
POSITION = {"shoulder_lift": -1.0, "elbow": 1.0}
JOINT_FIELDS = {
    "name": [f"{joint}_joint" for joint in JOINTS],
    "position": [POSITION.get(joint, 0.0) for joint in JOINTS],
    "velocity": [0.0] * 6,
}
# A ball that makes the zone yellow; whoever moves it away would make it green.
BALL = {"id": "ball", "shape": "sphere", "size": [0.1], "position": [0.75, 0.0, 0.3]}
MILDER = {
    "joints": JOINT_FIELDS,
    "ranges": {"ranges": [None] * 8},
    "obstacles": {"obstacles": [{**BALL, "position": [3.0, 0.0, 0.3]}]},
    "target": {"kind": "joint_velocity", "value": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]},
}
GOOD = {
    "joints": [0.02, JOINT_FIELDS],
    "ranges": [0.05, {"ranges": [None] * 8}],
    "obstacles": [0.05, {"obstacles": [BALL]}],
}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_for(condition: Callable[[], Any], seconds: float, what: str) -> Any:
    """Return the first true value of ``condition``."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.02)
    raise AssertionError(f"not within {seconds} s: {what}")


class Process:
    """A child process that is ended in every case."""

    def __init__(self, *command: str, state: Path) -> None:
        self._output = os.memfd_create("output")
        self.popen = subprocess.Popen(
            [sys.executable, *command],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._output,
            env={**os.environ, "XDG_STATE_HOME": str(state)},
        )

    def output(self) -> str:
        return os.pread(self._output, 1 << 20, 0).decode()

    def wait_for_line(self, line: str, seconds: float = 90.0) -> None:
        def there() -> bool:
            assert self.popen.poll() is None, self.output()
            return line in self.output()

        try:
            wait_for(there, seconds, line)
        except AssertionError as error:
            raise AssertionError(f"{error}; it said: {self.output()}") from error

    def memory(self) -> int:
        """Return the resident memory [bytes]."""
        pages = Path(f"/proc/{self.popen.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def kill(self) -> None:
        if self.popen.poll() is None:
            self.popen.send_signal(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                self.popen.wait(3)
            self.popen.kill()
        self.popen.wait(10)


@dataclass(frozen=True, slots=True, kw_only=True)
class Robot:
    """A robot's service under test, with everybody's keys."""

    name: str
    keys: KeyFolder
    port: int
    service: Process

    def file(self, member: str) -> str:
        return str(self.keys.path / member / "zenoh.json5")

    def config(self, member: str, **settings: Any) -> zenoh.Config:
        """Return a configuration as an attacker would have it: without the rules on its own side."""
        config = zenoh.Config.from_file(self.file(member))
        config.insert_json5("access_control", "{ enabled: false }")
        for key, value in settings.items():
            config.insert_json5(key.replace("__", "/"), json.dumps(value))
        return config

    def open(self, member: str, **settings: Any) -> zenoh.Session:
        return zenoh.open(self.config(member, **settings))

    def authority(self) -> Pair:
        folder = self.keys.path / "authority"
        return Pair(
            certificate=(folder / "authority.crt").read_bytes(), key=(folder / "authority.key").read_bytes()
        )


@contextmanager
def guarded(folder: Path, *, router: bool = False, robots: Sequence[str] = ("ur3",)) -> Iterator[Robot]:
    """Run a service with keys, and its good driver; with a router between them if wanted."""
    port = free_port()
    network = Network(robots=tuple(robots), port=port, router=router)
    keys = KeyFolder(path=folder, network=network, at=PurePosixPath(folder))
    keys.create(60.0, force=False)
    name = robots[0]
    processes = []
    try:
        if router:
            file = str(folder / "router" / "zenoh.json5")
            processes.append(Process(str(ROOT / "docker" / "router.py"), file, state=folder))
            processes[-1].wait_for_line("routing at")
        file = str(folder / f"service-{name}" / "zenoh.json5")
        service = Process(
            *("-m", "ssm_service.cli", "run", "--robot", "ur3", "--name", name, "--rate", str(RATE_HZ)),
            *("--zenoh-config", file, "--seconds", "600"),
            state=folder,
        )
        processes.append(service)
        service.wait_for_line("\nready\n")
        file = str(folder / f"driver-{name}" / "zenoh.json5")
        processes.append(Process(str(HERE / "secured_driver.py"), file, name, json.dumps(GOOD), state=folder))
        yield Robot(name=name, keys=keys, port=port, service=service)
    finally:
        for process in reversed(processes):
            process.kill()


class Watch:
    """A viewer who keeps to the rules, and sees every zone."""

    def __init__(self, robot: Robot, member: str) -> None:
        self.robot = robot
        self.session = zenoh.open(zenoh.Config.from_file(robot.file(member)))
        self._zones: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._hear, daemon=True)
        self._thread.start()

    def _hear(self) -> None:
        channel = zenoh.handlers.FifoChannel(100_000)
        with self.session.declare_subscriber(f"ssm/{self.robot.name}/zone", channel) as subscriber:
            for sample in subscriber:
                self._zones.append(json.loads(sample.payload.to_bytes()))

    def heard(self) -> list[dict[str, Any]]:
        return list(self._zones)

    def health(self) -> dict[str, Any]:
        """Return the service's health; a link that a busy machine let go is given time to come back."""
        (reply,) = wait_for(lambda: [one for one in self.ask("health") if one.ok is not None], 15.0, "health")
        return json.loads(reply.ok.payload.to_bytes())

    def ask(self, key: str, seconds: float = 5.0) -> list[zenoh.Reply]:
        return list(self.session.get(f"ssm/{self.robot.name}/{key}", timeout=seconds))

    def until_yellow(self, seconds: float = 15.0) -> None:
        """Wait until the zone is what the good driver's obstacle makes it."""

        def right() -> bool:
            last = self._zones[-1:]
            # No one plans a motion here for long, and that alone changes no zone.
            reasons = set(last[0]["reasons"]) if last else set()
            return reasons - {"waiting:target", "stale:target"} == {"distance"}

        try:
            wait_for(right, seconds, "yellow by distance")
        except AssertionError as error:
            raise AssertionError(f"{error}; last: {self._zones[-1:]}") from error

    @contextmanager
    def unmoved(self) -> Iterator[None]:
        """See that nothing in the block makes the zone milder or wrong, and that the loop goes on.

        While it lasts, the zone may be more severe: a machine that is busy with an attack may be late.
        """
        self.until_yellow()
        first, before, begin = len(self._zones), self.health(), time.monotonic()
        yield
        time.sleep(0.2)
        self.until_yellow()
        after, seconds = self.health(), time.monotonic() - begin
        zones = self._zones[first:]
        assert after["producer"] == before["producer"]
        assert {zone["producer"] for zone in zones} == {after["producer"]}
        assert min(SEVERITY[zone["zone"]] for zone in zones) == SEVERITY["yellow"]
        ticks = after["ticks"] - before["ticks"]
        overruns = after["overruns"] - before["overruns"]
        print(f"{ticks} ticks in {seconds:.1f} s, {overruns} overruns, {len(zones)} zones seen")
        assert ticks > 0.2 * RATE_HZ * seconds

    def close(self) -> None:
        self.session.close()
        self._thread.join(5.0)


def sealed(key: str, producer: str, seq: int, fields: dict[str, Any]) -> tuple[bytes, bytes]:
    """Return payload and attachment of a message that is right in all but who sends it."""
    payload = json.dumps({"producer": producer, "seq": seq, "stamp_ns": 0, **fields}).encode()
    covered = f"{key}\n{producer}\n{seq}\n\n".encode() + payload
    return payload, f"crc32={zlib.crc32(covered):08x}".encode()


def answers(
    session: zenoh.Session, key: str, payload: bytes | None = None, seconds: float = 3.0
) -> list[Any]:
    """Return what answers a query, without the error replies that Zenoh itself makes up on a timeout."""
    return [reply.ok for reply in session.get(key, payload=payload, timeout=seconds) if reply.ok is not None]


def send_milder(session: zenoh.Session, robot: str, source: str, count: int = 20) -> None:
    """Send messages that would make the zone milder or the robot move, if they were taken."""
    key = f"ssm/{robot}/in/{source}"
    for seq in range(count):
        payload, attachment = sealed(key, "stranger", 10**9 + seq, MILDER[source])
        session.put(key, payload, attachment=attachment, congestion_control=zenoh.CongestionControl.BLOCK)
        time.sleep(0.002)


def refused_at_the_door(config: zenoh.Config) -> str:
    """Return what Zenoh says to one who is not let in."""
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        return str(error)
    session.close()
    raise AssertionError("it was let in")


def new_pair(folder: Path, pair: Pair) -> dict[str, str]:
    """Write a certificate and its key; return the settings that use them."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "own.crt").write_bytes(pair.certificate)
    (folder / "own.key").write_bytes(pair.key)
    return {
        "transport__link__tls__connect_certificate": str(folder / "own.crt"),
        "transport__link__tls__connect_private_key": str(folder / "own.key"),
    }


def certified(robot: Robot, folder: Path, name: str, *, days: float) -> dict[str, str]:
    return new_pair(folder, make_certificate(robot.authority(), name, days=days))

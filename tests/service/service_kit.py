"""Real processes and a network for the tests of the service; everything on 127.0.0.1."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import tomllib
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

HERE = Path(__file__).parent
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
SEVERITY = {"green": 0, "yellow": 1, "red": 2, "stop": 3}
UR3 = tomllib.loads((HERE.parents[1] / "robots" / "ur3.toml").read_text(encoding="utf-8"))
RECOVERY_TICKS: int = UR3["profiles"]["kang2022"]["recovery_ticks"]

POSITION = [0.0, -1.0, 1.0, 0.0, 0.0, 0.0]
BALL = {"id": "ball", "shape": "sphere", "size": [0.1], "position": [0.75, 0.0, 0.3]}
FAR = {**BALL, "position": [3.0, 0.0, 0.3]}

# What a driver sends, as drivers do: joints by name in alphabetical order.
ALPHABETICAL = sorted(range(6), key=lambda index: JOINTS[index])
JOINT_FIELDS = {
    "name": [JOINTS[index] for index in ALPHABETICAL],
    "position": [POSITION[index] for index in ALPHABETICAL],
    "velocity": [0.0] * 6,
}
RANGE_FIELDS = {"ranges": [None] * 8}
OBSTACLE_FIELDS = {"obstacles": [BALL]}
TARGET_FIELDS = {"kind": "joint_velocity", "value": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]}
HEALTHY = {
    "joints": [0.008, JOINT_FIELDS],
    "ranges": [0.05, RANGE_FIELDS],
    "obstacles": [0.033, OBSTACLE_FIELDS],
    "target": [0.05, TARGET_FIELDS],
}


def head_of(payload: bytes) -> tuple[str, int]:
    """Return producer and seq of a payload; nobody's where it names none."""
    try:
        value = json.loads(payload)
        producer, seq = value["producer"], value["seq"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return "", 0
    good = isinstance(producer, str) and isinstance(seq, int) and not isinstance(seq, bool)
    return (producer, seq) if good else ("", 0)


def crc(key: str, payload: bytes | str, after: str = "") -> bytes:
    """Return the attachment of a message as its documentation describes it."""
    data = payload.encode() if isinstance(payload, str) else payload
    producer, seq = head_of(data)
    covered = f"{key}\n{producer}\n{seq}\n{after}\n".encode() + data
    return f"crc32={zlib.crc32(covered):08x}{f';after={after}' if after else ''}".encode()


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def wait_for(condition: Callable[[], Any], seconds: float = 10.0, what: str = "") -> Any:
    """Return the first true value of ``condition``."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if value := condition():
            return value
        time.sleep(0.01)
    raise AssertionError(f"not within {seconds} s: {what or condition}")


def strictly(text: str | bytes) -> Any:
    """Parse JSON that holds finite numbers only."""

    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} in {text!r}")

    def number(digits: str) -> float:
        value = float(digits)
        assert abs(value) < 1e300
        return value

    return json.loads(text, parse_constant=refuse, parse_float=number)


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


class Process:
    """A child process that is ended in every case."""

    def __init__(self, command: Sequence[str]) -> None:
        self._output = os.memfd_create("output")
        self._last_words: str | None = None
        self.popen = subprocess.Popen(
            list(command), stdin=subprocess.DEVNULL, stdout=self._output, stderr=subprocess.STDOUT
        )
        self.pid = self.popen.pid

    def output(self) -> str:
        if self._last_words is not None:
            return self._last_words
        return os.pread(self._output, 1 << 20, 0).decode()

    def signal(self, number: int) -> None:
        self.popen.send_signal(number)

    def kill(self) -> None:
        """End it: politely, so that it leaves nothing in the temporary folder, and then in any case."""
        if self.popen.poll() is None:
            self.popen.send_signal(signal.SIGCONT)
            self.popen.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.popen.wait(3)
            self.popen.kill()
        self.popen.wait(10)
        if self._last_words is None:
            self._last_words = self.output()
            os.close(self._output)

    def children(self) -> list[int]:
        text = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text()
        return [int(pid) for pid in text.split()]

    def memory(self) -> int:
        """Return the resident memory [bytes]."""
        return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def files(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/fd"))


class ServiceUnderTest(Process):
    """The service on a port of its own."""

    def __init__(self, *, command: Sequence[str] | None = None, **options: Any) -> None:
        self.port = free_port()
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        if command is None:
            fields = {"listen": [self.endpoint], "seconds": 100, **options}
            command = [sys.executable, str(HERE / "service_process.py"), json.dumps(fields)]
        super().__init__([part.replace("ENDPOINT", self.endpoint) for part in command])

    def wait_until_ready(self) -> None:
        def ready() -> bool:
            assert self.popen.poll() is None, self.output()
            return "\nready\n" in self.output()

        wait_for(ready, 40.0, "ready")

    def kill(self) -> None:
        children = [] if self.popen.poll() is not None else self.children()
        super().kill()
        wait_for(lambda: not any(map(alive, children)), 5.0, "no evaluating process left")


@contextmanager
def running(*, ready: bool = True, **options: Any) -> Iterator[ServiceUnderTest]:
    service = ServiceUnderTest(**options)
    try:
        if ready:
            service.wait_until_ready()
        yield service
    finally:
        service.kill()


@contextmanager
def driving(
    endpoint: str, sources: dict[str, Any] | None = None, producer: str = "good driver"
) -> Iterator[Process]:
    wanted = {"endpoint": endpoint, "producer": producer, "sources": HEALTHY if sources is None else sources}
    driver = Process([sys.executable, str(HERE / "foreign_driver.py"), json.dumps(wanted)])
    try:
        yield driver
    finally:
        driver.kill()


@dataclass(frozen=True, slots=True)
class Heard:
    """One message on an output key."""

    at: float
    key: str
    encoding: str
    text: bytes
    attachment: bytes | None = None

    @property
    def value(self) -> dict[str, Any]:
        return strictly(self.text)


class Ear:
    """A plain Zenoh client: hears zone and command, asks, and sends."""

    def __init__(self, endpoint: str, *, listen: bool = True) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        self.session = zenoh.open(config)
        self._lock = threading.Lock()
        self._heard: list[Heard] = []
        self._seq = 0
        # Channels, not callbacks: Zenoh's thread never waits for this process's Python, so nothing is lost.
        self._threads = [
            threading.Thread(target=self._hear, args=(key,), daemon=True)
            for key in (("zone", "command") if listen else ())
        ]
        for thread in self._threads:
            thread.start()

    def _hear(self, key: str) -> None:
        channel = zenoh.handlers.FifoChannel(100_000)
        with self.session.declare_subscriber(f"ssm/ur3/{key}", channel) as subscriber:
            for sample in subscriber:
                attachment = None if sample.attachment is None else sample.attachment.to_bytes()
                text, encoding = sample.payload.to_bytes(), str(sample.encoding)
                heard = Heard(time.monotonic(), key, encoding, text, attachment)
                with self._lock:
                    self._heard.append(heard)

    def heard(self, key: str = "zone", since: float = 0.0) -> list[Heard]:
        with self._lock:
            return [one for one in self._heard if one.key == key and one.at >= since]

    def zones(self, since: float = 0.0) -> list[dict[str, Any]]:
        return [one.value for one in self.heard("zone", since)]

    def forget(self) -> None:
        with self._lock:
            self._heard.clear()

    def next_zone(self, seconds: float = 5.0) -> dict[str, Any]:
        """Return a zone that is decided after this call."""
        since = time.monotonic() + 0.01
        return wait_for(lambda: self.heard("zone", since), seconds, "a zone")[0].value

    def until(self, matches: Callable[[dict[str, Any]], bool], seconds: float = 5.0) -> dict[str, Any]:
        """Return the first zone from now on that matches."""
        since, last = time.monotonic(), []

        def found() -> Any:
            last[:] = self.heard("zone", since)[-1:]
            return [one for one in (heard.value for heard in self.heard("zone", since)[-50:]) if matches(one)]

        try:
            return wait_for(found, seconds)[0]
        except AssertionError as error:
            raise AssertionError(f"last zone: {last[0].value if last else None}") from error

    def ask(self, key: str, payload: bytes | str | None = None, seconds: float = 5.0) -> tuple[str, str, Any]:
        """Return ``("ok" or "error", encoding, value)`` of the only reply."""
        replies = list(self.session.get(f"ssm/ur3/{key}", payload=payload, timeout=seconds))
        assert len(replies) == 1, f"{len(replies)} replies on {key}"
        reply = replies[0]
        kind, content = ("ok", reply.ok) if reply.ok is not None else ("error", reply.err)
        if kind == "ok":
            assert content.attachment.to_bytes() == crc(f"ssm/ur3/{key}", content.payload.to_bytes())
        return kind, str(content.encoding), strictly(content.payload.to_bytes())

    def health(self) -> dict[str, Any]:
        kind, _, value = self.ask("health")
        assert kind == "ok"
        return value

    def send(self, source: str, fields: dict[str, Any], *, producer: str = "ear") -> None:
        self._seq += 1
        head = {"producer": producer, "seq": self._seq, "stamp_ns": 0}
        self.put(f"in/{source}", json.dumps({**head, **fields}))

    def put(self, key: str, payload: bytes | str, **options: Any) -> None:
        """Put without loss on our side; with the right checksum where no other attachment is given."""
        block, where = zenoh.CongestionControl.BLOCK, f"ssm/ur3/{key}"
        options.setdefault("attachment", crc(where, payload))
        self.session.put(where, payload, congestion_control=block, **options)

    def close(self) -> None:
        self.session.close()
        for thread in self._threads:
            thread.join(5.0)


@contextmanager
def listening(endpoint: str, *, listen: bool = True) -> Iterator[Ear]:
    ear = Ear(endpoint, listen=listen)
    try:
        yield ear
    finally:
        ear.close()


def without_gaps(zones: Sequence[dict[str, Any]]) -> bool:
    """Tell whether the messages are those of consecutive ticks of one producer."""
    first = zones[0]
    return all(
        (zone["producer"], zone["seq"]) == (first["producer"], first["seq"] + index)
        for index, zone in enumerate(zones)
    )


@contextmanager
def driving_in_process(ear: Ear, **sources: dict[str, Any]) -> Iterator[Ear]:
    """Send the sources from this process, each every 20 ms, in a thread; fields may be changed meanwhile."""
    ending = threading.Event()
    producer = f"ear {time.monotonic_ns()}"

    def send() -> None:
        while not ending.wait(0.02):
            for source, fields in list(sources.items()):
                ear.send(source, fields, producer=producer)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield ear
    finally:
        ending.set()
        thread.join()

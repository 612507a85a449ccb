"""The README's own arm, as its reader runs it: `ssm run` and `ssm sim` with the file, as processes."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
import zenoh

from ssm_service.client import Client, Connection
from ssm_service.wire import Keys

COMMAND = [sys.executable, "-m", "ssm_service.cli"]
TIME_LIMIT_S = 60

Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start() -> Iterator[Start]:
    """Start a command; each ends by itself, should this process be killed."""
    started: list[subprocess.Popen[str]] = []

    def starter(*arguments: str) -> subprocess.Popen[str]:
        command = [*COMMAND, *arguments, "--seconds", str(TIME_LIMIT_S)]
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        started.append(process)
        return process

    yield starter
    for process in reversed(started):
        process.terminate()
        process.communicate(timeout=20)


def said(process: subprocess.Popen[str], word: str) -> str:
    """Return the first line on a process's stderr that has a word."""
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if word in line:
            return line
    raise AssertionError("".join(lines))


def test_the_arm_of_the_readme_works_at_once(my_arm_file: Path, start: Start) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    service = start("run", "--robot", str(my_arm_file), "--listen", endpoint)
    simulation = start("sim", "--robot", str(my_arm_file), "--connect", endpoint)
    said(service, "ready")
    said(simulation, "my_arm starts at rest and sways its first free joint, panda_joint1")
    said(simulation, "obeys the service")
    connection = Connection([endpoint])
    try:
        session = connection.wait(10.0)
        keys, places, ranges = Keys("my_arm"), list[float](), list[bytes]()

        def heard(sample: zenoh.Sample) -> None:
            message = msgspec.json.decode(sample.payload.to_bytes())
            places.append(message["position"][message["name"].index("panda_joint1")])

        listeners = [
            session.declare_subscriber(keys.input("joints"), heard),
            session.declare_subscriber(keys.input("ranges"), lambda sample: ranges.append(b"")),
        ]
        deadline, zones = time.monotonic() + 30.0, set[str]()
        with Client("my_arm", connect=(endpoint,)) as client:
            while time.monotonic() < deadline:
                zones.add(client.zone().zone)
                if zones & {"green", "yellow", "red"} and len(places) > 1 and max(places) - min(places) > 0.1:
                    break
                time.sleep(0.05)
        for listener in listeners:
            listener.undeclare()
    finally:
        connection.close()
    assert zones & {"green", "yellow", "red"}
    assert max(places) - min(places) > 0.1
    assert not ranges
    assert (service.poll(), simulation.poll()) == (None, None)

"""The simulation against a real service: as processes, over a socket, with kill -9."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from ssm_service.simulation import Simulation, SimulationOptions, run_simulation

SERVICE = """
import sys
from ssm_service.service import ServiceOptions, run_service
run_service(ServiceOptions(listen=[sys.argv[1]]), lambda line: print(line, file=sys.stderr, flush=True))
"""

SIMULATION = """
import json, sys
from ssm_service.simulation import SimulationOptions, run_simulation
options = SimulationOptions(connect=[sys.argv[1]], scenario="empty")
print(json.dumps(run_simulation(options, lambda line: print(line, file=sys.stderr, flush=True))))
"""

VALID_FOR_NS = 20_000_000
"""What a service at 500 Hz says."""

Start = Callable[[str, str], subprocess.Popen[str]]


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


@pytest.fixture
def start(endpoint: str) -> Iterator[Start]:
    """Start a program and wait until it has said a certain line."""
    started: list[subprocess.Popen[str]] = []

    def starter(program: str, line: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", program, endpoint],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stderr is not None
        for said in process.stderr:
            if line in said:
                return process
        raise AssertionError(f"never said: {line}")

    yield starter
    for process in started:
        process.kill()
        process.communicate()


def test_stops_when_the_service_is_killed_and_goes_on_with_the_next(endpoint: str, start: Start) -> None:
    services = [start(SERVICE, "ready")]
    steps: list[tuple[int, bool]] = []
    killed_ns: list[int] = []
    began = time.monotonic()

    def on_step(simulation: Simulation) -> None:
        now_ns = time.monotonic_ns()
        moving = bool(simulation.obeying.command.any())
        steps.append((now_ns, moving))
        assert time.monotonic() - began < 60.0
        if not killed_ns:
            if simulation.world.time_s > 1.0 and moving:
                services[0].kill()
                killed_ns.append(time.monotonic_ns())
        elif len(services) == 1 and now_ns - killed_ns[0] > 300_000_000:
            services.append(start(SERVICE, "ready"))  # holds this loop up for a second or two, too
        elif len(services) == 2 and moving and now_ns - killed_ns[0] > 600_000_000:
            os.kill(os.getpid(), signal.SIGINT)

    options = SimulationOptions(connect=[endpoint], scenario="empty", realtime=False)
    summary = run_simulation(options, lambda line: None, on_step)
    (killed,) = killed_ns
    late = [now - killed for now, moving in steps if moving and killed < now < killed + 290_000_000]
    assert max(late, default=0) <= VALID_FOR_NS + 20_000_000
    assert any(now > killed + 40_000_000 for now, _ in steps)
    assert steps[-1][1]
    assert summary["connected"]
    assert summary["watchdog_stops"] >= 1
    assert summary["steps"] == len(steps)
    assert 0 < summary["obeyed"] < summary["steps"]
    assert summary["skipped"] > 0
    assert summary["longest_gap_s"] > 0.1


def test_waits_for_its_service_and_ends_on_a_signal(start: Start) -> None:
    simulation = start(SIMULATION, "waiting for a service")
    start(SERVICE, "ready")
    assert simulation.stderr is not None
    assert any("obeys the service" in line for line in simulation.stderr)
    time.sleep(0.5)
    simulation.send_signal(signal.SIGTERM)
    sent = time.monotonic()
    out, _ = simulation.communicate(timeout=10)
    assert time.monotonic() - sent < 1.0
    assert simulation.returncode == 0
    summary = json.loads(out)
    assert summary["connected"]
    assert summary["obeyed"] > 50
    assert set(summary) == {
        "scenario",
        "connected",
        "simulated_s",
        "steps",
        "skipped",
        "obeyed",
        "watchdog_stops",
        "limit_hits",
        "longest_gap_s",
    }


def test_ends_by_itself_without_a_service(endpoint: str) -> None:
    began, said = time.monotonic(), list[str]()
    options = SimulationOptions(connect=[endpoint], seconds=0.8, realtime=False)
    summary = run_simulation(options, said.append)
    assert 0.8 <= time.monotonic() - began < 2.5
    assert (summary["connected"], summary["steps"]) == (False, 0)
    assert any(endpoint in line for line in said)

"""The layout of compose.yaml as plain processes: its very commands and files, but for hosts and ports."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from ssm_service.client import Client
from ssm_service.errors import ServiceError

ROOT = Path(__file__).resolve().parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text(encoding="utf-8"))
ROBOTS = ["left", "right"]
PROGRAMS = {"ssm": [sys.executable, "-m", "ssm_service.cli"], "python": [sys.executable]}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def on_this_machine(command: list[str]) -> list[str]:
    return [*PROGRAMS[command[0]], *command[1:]]


class Layout:
    """All processes of compose.yaml, in a folder of their own, with keys made by its command, on one port."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port()
        self.temporary = folder / "tmp"
        self.temporary.mkdir()
        shutil.copytree(ROOT / "docker", folder / "docker")
        self.client_file = folder / "keys" / "viewer" / "zenoh.json5"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def here(self, command: list[str]) -> list[str]:
        """Return a command of the compose file with the folder of its keys and its host on this machine."""
        words = [word.replace("/keys", str(self.folder / "keys")) for word in command]
        return on_this_machine(["127.0.0.1" if word == "router" else word for word in words])

    def make_keys(self) -> None:
        """Run the command that makes the keys, for this machine and the picked port."""
        command = [*self.here(COMPOSE["services"]["keys"]["command"]), "--port", str(self.port)]
        subprocess.run(command, cwd=self.folder, check=True, capture_output=True, timeout=60)

    def start(self) -> None:
        """Start all at once, services before their router: none may need an order."""
        self.make_keys()
        for name in sorted(COMPOSE["services"].keys() - {"keys"}, reverse=True):
            self.start_one(name)

    def start_one(self, name: str) -> None:
        with open(self.folder / f"{name}.log", "ab") as log:
            self.processes[name] = subprocess.Popen(
                self.here(COMPOSE["services"][name]["command"]),
                cwd=self.folder,
                env={
                    **os.environ,
                    "TMPDIR": str(self.temporary),
                    "XDG_STATE_HOME": str(self.folder / "state"),
                },
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def logs(self) -> str:
        return "\n".join(f"{path.name}:\n{path.read_text()}" for path in sorted(self.folder.glob("*.log")))

    def kill(self) -> None:
        """Leave nothing behind, however the test ended."""
        for process in self.processes.values():
            if group_lives(process.pid):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture(scope="module")
def layout(tmp_path_factory):
    """The running layout, once both robots have left `stop`."""
    layout = Layout(tmp_path_factory.mktemp("layout"))
    try:
        layout.start()
        wait_for_motion(layout)
        yield layout
    finally:
        layout.kill()


def wait_for(what, end: float, layout: Layout):
    """Return the first true answer of ``what``; getting none until ``end`` (monotonic) fails the test."""
    while time.monotonic() < end:
        try:
            answer = what()
        except ServiceError:
            answer = None
        if answer:
            return answer
        time.sleep(0.1)
    pytest.fail(f"not in time\n{layout.logs()}")


def wait_for_motion(layout: Layout) -> None:
    """Wait until both robots have left `stop`, which takes at most 60 s."""
    end = time.monotonic() + 60.0
    for robot in ROBOTS:
        with client(layout, robot) as one:
            wait_for(lambda one=one: one.zone().zone != "stop", end, layout)


def client(layout: Layout, robot: str) -> Client:
    return Client(robot, connect=(), zenoh_config=layout.client_file, timeout_s=2.0)


def test_one_client_sees_both_robots(layout):
    with client(layout, "left") as left:
        assert sorted(left.robots()) == ROBOTS


@pytest.mark.parametrize("robot", ROBOTS)
def test_each_service_answers_for_its_own_robot(layout, robot):
    with client(layout, robot) as one:
        zone = one.zone()
        assert zone.robot == robot
        assert zone.sources["joints"].state == zone.sources["ranges"].state == "fresh"
        assert one.command().robot == robot
        assert one.config()["robot"] == robot


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_evaluating_process_answers_through_the_router(layout, robot):
    with client(layout, robot) as one:
        frames = one.frames(position=[0.0, -1.2, 1.4, 0.0, 0.0, 0.0])
        assert frames.robot == robot


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_health_check_succeeds(layout, robot):
    check, *command = COMPOSE["services"][f"service-{robot}"]["healthcheck"]["test"]
    assert check == "CMD"
    done = subprocess.run(layout.here(command), cwd=layout.folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr + layout.logs()


def test_each_robot_hears_its_own_simulation_only(layout):
    producers = {}
    for robot in ROBOTS:
        with client(layout, robot) as one:
            health = one.health()
            assert health.robot == robot
            assert health.accepted["joints"] > 0
            assert health.rejected == {}
            assert not [text for text in health.warnings if "insecure" in text or "access_control" in text]
            producers[robot] = health.producer
    assert producers["left"] != producers["right"]


def test_all_come_back_with_the_router(layout):
    router = layout.processes["router"]
    router.kill()
    router.wait()
    time.sleep(0.5)
    layout.start_one("router")
    wait_for_motion(layout)
    for robot in ROBOTS:
        with client(layout, robot) as one:
            health = one.health()
            assert health.uptime_s > 0.5
            assert sorted(one.robots()) == ROBOTS


def test_all_end_on_sigterm_within_seconds_and_leave_nothing(layout):
    assert [name for name, process in layout.processes.items() if process.poll() is not None] == []
    begin = time.monotonic()
    for process in layout.processes.values():
        process.terminate()
    for process in layout.processes.values():
        process.wait(timeout=10.0)
    assert time.monotonic() - begin < 5.0
    status = {name: process.returncode for name, process in layout.processes.items()}
    assert status == dict.fromkeys(layout.processes, 0), layout.logs()
    assert not [name for name, process in layout.processes.items() if group_lives(process.pid)]
    assert list(layout.temporary.iterdir()) == []
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", layout.port)) != 0

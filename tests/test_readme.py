"""The README's commands and snippets are run, not only read."""

import json
import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import Inputs, JointSample, Monitor, Received
from ssm_service.safety import Zone

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(marker: str) -> str:
    found = re.search(rf"<!-- {marker} -->\n```\w+\n(.*?)```", README, flags=re.DOTALL)
    assert found, f"README.md has no block marked {marker}"
    return found[1]


@pytest.fixture(scope="module")
def endpoint():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    command = [sys.executable, "-m", "ssm_service.cli", "run", "--listen", endpoint, "--seconds", "90"]
    service = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert any("ready" in line for line in service.stderr)
        yield endpoint
    finally:
        service.terminate()
        service.communicate(timeout=10)


def run_snippet(code: str) -> str:
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.parametrize("marker", ["demo-command", "test-command"])
def test_the_two_commands_are_one_line_and_need_only_python_and_pip(marker):
    (line,) = block(marker).strip().splitlines()
    steps = [step.split()[0] for step in line.split(" && ")]
    assert steps[:2] == ["python3", ".venv/bin/pip"]
    assert all(step.startswith(".venv/bin/") for step in steps[1:])


def test_a_plain_zenoh_program_asks_for_the_zone(endpoint):
    code = block("plain-zenoh")
    assert "ssm_service" not in code
    said = run_snippet(code.replace("tcp/127.0.0.1:7447", endpoint))
    assert said.startswith("stop None [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]")
    assert "waiting:joints" in said


def test_the_python_client_follows(endpoint):
    code = block("python-client").replace('Client("ur3")', f'Client("ur3", connect=["{endpoint}"])')
    lines = run_snippet(code).splitlines()
    assert lines[0] == "stop None"
    assert lines[1:2] == ["stop () ('waiting:service',)"]
    assert len(lines) == 101
    assert lines[-1].startswith("stop (0.0, 0.0, 0.0, 0.0, 0.0, 0.0) ('waiting:joints'")


def test_the_evaluate_line(tmp_path):
    line = next(line for line in README.splitlines() if line.endswith("| ssm evaluate"))
    command = line.replace("| ssm evaluate", f"| {sys.executable} -m ssm_service.cli evaluate")
    result = subprocess.run(
        ["sh", "-c", command], capture_output=True, text=True, timeout=60, cwd=tmp_path, check=True
    )
    answer = json.loads(result.stdout)
    assert answer["zone"] in ("red", "yellow", "green")
    assert len(answer["pairs"]) == 8


def test_the_seven_joint_arm_of_the_readme(tmp_path):
    path = tmp_path / "my_arm.toml"
    path.write_text(block("own-robot"), encoding="utf-8")
    robot = Robot.load(path)
    assert len(robot.joint_names) == 7
    monitor = Monitor(robot)
    x, y, z = robot.kinematics(robot.rest_position).transform_end_effector_to_base[:3, 3]
    near = Obstacle(id="near", shape="sphere", size=(0.05,), position=(x, y, z + 0.6))
    joints = JointSample(position=robot.rest_position, velocity=np.zeros(7))
    for _ in range(40):
        decision = monitor.step(
            Inputs(
                joints=Received(value=joints, age_s=0.0),
                obstacles=Received(value=(near,), age_s=0.0),
            )
        )
    assert decision.zone is Zone.YELLOW
    check = [sys.executable, "-m", "ssm_service.cli", "check", str(path)]
    result = subprocess.run(check, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode in (0, 1), result.stderr


def test_every_reason_word_is_explained():
    code = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "ssm_service").rglob("*.py"))
    words = set(re.findall(r'(?:reasons\.append\(|yield )\s*"([a-z:]+)"', code))
    words |= set(re.findall(r'^[A-Z]+ = "([a-z]+:[a-z]+)"', code, flags=re.MULTILINE))
    known = {
        "frozen:ranges",
        "implausible:joints",
        "latched",
        "separation",
        "contact",
        "distance",
        "overrun",
        "recovering",
        "duplicate:service",
        "disagree",
        "uncovered",
    }
    assert known <= words
    for word in words:
        assert f"`{word}`" in README


def test_a_plain_driver_is_heard(endpoint):
    code = block("plain-driver")
    assert "ssm_service" not in code
    run_snippet(code.replace("tcp/127.0.0.1:7447", endpoint))
    command = [sys.executable, "-m", "ssm_service.cli", "zone", "--connect", endpoint, "--json"]
    zone = json.loads(subprocess.run(command, capture_output=True, timeout=30, check=True).stdout)
    assert zone["sources"]["joints"]["state"] != "absent"
    assert "invalid:joints" not in zone["reasons"]


def test_nothing_is_left_behind(endpoint):
    """The service of this module still answers, so nothing above has ended or blocked it."""
    time.sleep(0.1)
    command = [sys.executable, "-m", "ssm_service.cli", "zone", "--connect", endpoint, "--json"]
    result = subprocess.run(
        command, capture_output=True, text=True, timeout=30, check=True, env=dict(os.environ)
    )
    assert json.loads(result.stdout)["robot"] == "ur3"

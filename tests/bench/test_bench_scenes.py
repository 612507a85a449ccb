"""Scenes: the same for the same seed, clear of the robot, and acceptable as messages."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench.latency import latencies
from bench.loop import Recording, spin
from bench.scenes import FARTHEST_M, NEAREST_M, draw_scenes
from ssm_service.model import DistanceModel, Robot
from ssm_service.service import Beat
from ssm_service.wire import VALUES, Decoder
from ssm_service.wire.messages import INPUTS


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


def payloads(robot, seed):
    return [scene.payloads(robot, 1) for scene in draw_scenes(robot, 10, 3, seed)]


def test_the_same_seed_gives_the_same_scenes(robot):
    assert payloads(robot, 5) == payloads(robot, 5)
    assert payloads(robot, 5) != payloads(robot, 6)


@pytest.mark.parametrize("farthest", [FARTHEST_M, 0.25])
def test_obstacles_are_near_and_clear(robot, farthest):
    distances = DistanceModel(robot)
    for scene in draw_scenes(robot, 10, 3, 2, farthest):
        assert len(scene.obstacles) == 10
        distances.set_obstacles(scene.obstacles)
        nearest = distances.bounds(scene.position).min(axis=0)
        assert np.all((nearest >= NEAREST_M) & (nearest <= farthest))


def test_payloads_say_what_the_inputs_say(robot):
    (scene,) = draw_scenes(robot, 3, 1, seed=4)
    inputs = scene.inputs(robot)
    values = {
        name: VALUES[name](robot, Decoder(INPUTS[name]).decode(payload))
        for name, payload in scene.payloads(robot, 1).items()
    }
    np.testing.assert_array_equal(values["joints"].position, inputs.joints.value.position)
    np.testing.assert_array_equal(values["ranges"], inputs.ranges.value)
    assert values["obstacles"] == inputs.obstacles.value
    np.testing.assert_array_equal(values["target"].value, inputs.target.value.value)


def test_latency_ends_with_the_first_command_that_knew_the_scan_or_a_later_one():
    noted = {
        "sent_ns": [100, 200, 300, 400],
        "zones": [(7, 0, 150), (8, 0, 160), (9, 2, 350)],
        "commands": [(7, 155), (8, 165), (9, 356)],
    }
    found = latencies(noted)
    assert found["zone"] == [50, 150, 50]
    assert found["command"] == [55, 156, 56]
    assert found["superseded"] == 1
    assert found["unanswered"] == 1


def test_lateness_counts_from_the_first_deadline_missed():
    recording = Recording(1000)
    recording.tick(Beat(10_000, 10_007, 0, 0))
    recording.tick(Beat(13_000, 13_200, 1200, 2))
    recording.end_segment()
    result = recording.to_builtins()
    assert recording.lateness_ns == [7, 2200]
    assert result["skipped"] == 2
    assert result["rate_error_percent"] == pytest.approx(100.0 * (1000 / 3193 - 1.0))


def test_the_spin_keeps_to_its_grid():
    recording = Recording(1_000_000)
    spin(1_000_000, recording, time.monotonic_ns() + 20_000_000)
    assert 1 <= len(recording.lateness_ns) + recording.skipped <= 20
    assert min(recording.lateness_ns) >= 0

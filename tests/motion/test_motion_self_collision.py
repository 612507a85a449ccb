"""The arm against itself: rows for a filter, and which of them need not be looked at."""

import math

import numpy as np
import pytest

from ssm_service.model import Robot
from ssm_service.motion import VelocityFilter
from ssm_service.motion import self_collision as module
from ssm_service.motion.self_collision import SelfCollision

START = np.array([0.3, -1.2, 1.0, 0.0, 0.0, 0.0])
MARGIN_M, GAIN, DT = 0.01, 10.0, 0.008


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


def rows(itself, robot, position, speeds):
    spatial = robot.kinematics(position).spatial_jacobian
    return itself.rows(position, spatial, speeds, MARGIN_M, GAIN)


def all_rows(itself, robot, position):
    """Every pair, measured now: with a margin that is wider than the arm is long."""
    return itself.rows(position, robot.kinematics(position).spatial_jacobian, np.zeros(6), 9.0, GAIN)


def test_no_row_that_could_bind_is_left_out_whatever_was_measured_before(robot):
    """Beside all distances, measured anew: a random walk with jumps, at speeds that change."""
    rng = np.random.default_rng(2)
    itself, every = SelfCollision(robot), SelfCollision(robot, START)
    position, velocity, seen, told = START.copy(), np.zeros(6), 0, 0
    for step in range(400):
        if step % 50 == 0:
            velocity, speeds = rng.uniform(-1.5, 1.5, 6), rng.uniform(0.0, 2.0, 6)
        position = rng.uniform(-2.5, 2.5, 6) if step % 90 == 89 else np.clip(position + velocity * DT, -3, 3)
        distance, gradients = rows(itself, robot, position, speeds)
        exact, slopes = all_rows(every, robot, position)
        could = np.abs(slopes) @ speeds > GAIN * (exact - MARGIN_M)
        for value, slope in zip(exact[could], slopes[could], strict=True):
            off = np.abs(distance - value) + np.abs(gradients - slope).max(axis=1)
            assert off.min() < 1e-6
        seen, told = seen + int(could.sum()), told + len(distance)
    assert 100 < seen <= told < 0.5 * 400 * len(exact)


def test_a_pair_far_apart_rests(robot, monkeypatch):
    itself, calls = SelfCollision(robot), []
    measure = module.pin.computeDistance

    def counted(*arguments):
        calls.append(arguments[-1])
        return measure(*arguments)

    monkeypatch.setattr(module.pin, "computeDistance", counted)
    slow = np.full(6, 0.1)
    rows(itself, robot, START, slow)
    first = len(calls)
    for _ in range(20):
        rows(itself, robot, START, slow)
    assert len(calls) - first < 20 * first / 4


def test_folding_stops_before_the_links_touch(robot):
    position, command = START.copy(), np.zeros(6)
    itself, watch = SelfCollision(robot), SelfCollision(robot, START)
    wanted, box = np.array([0.0, 0.0, 0.8, 0.0, 0.0, 0.0]), (np.full(6, -1.0), np.full(6, 1.0))
    least = math.inf
    for _ in range(400):
        distance, gradients = rows(itself, robot, position, np.ones(6))
        bounds = np.maximum(GAIN * (distance - MARGIN_M), 0.0)
        command = VelocityFilter().solve(wanted, gradients, bounds, box).velocity
        position = position + DT * command
        assert not watch.touches(position)
        least = min(least, float(all_rows(watch, robot, position)[0].min()))
    assert MARGIN_M - 1e-3 < least < MARGIN_M + 5e-3


def test_a_distance_that_fails_is_the_worst_and_has_a_direction(robot, monkeypatch):
    class Failed:
        min_distance = math.nan

    itself = SelfCollision(robot)
    monkeypatch.setattr(module.pin, "computeDistance", lambda *_: Failed())
    distance, gradients = rows(itself, robot, START, np.ones(6))
    assert len(distance) > 10
    assert (distance == -math.inf).all()
    assert np.isfinite(gradients).all()


def test_hulls_that_always_overlap_are_left_out(robot, monkeypatch):
    assert len(rows(SelfCollision(robot), robot, START, np.full(6, 1e3))[0]) > 10
    monkeypatch.setattr(module, "_left_out", module.WeakKeyDictionary())
    monkeypatch.setattr(module, "ALWAYS", 0.0)  # what touches at none of them touches at a share of 0
    none, gradients = rows(SelfCollision(robot), robot, START, np.full(6, 1e3))
    assert none.shape == (0,)
    assert gradients.shape == (0, 6)

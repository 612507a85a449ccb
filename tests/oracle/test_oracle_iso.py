"""``bench.iso``: what it says of a run is right, and ``iso`` keeps what it must in a few variants."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench.iso import broken, table
from bench.iso_run import PERIOD_S, Piece, Result, pieces, plain_distance, robots, run
from bench.iso_scenes import FASTEST_M_S, SCENARIOS, variant
from ssm_service.model import DistanceModel, Obstacle

T_S, GAIN, FIXED = 0.159, 0.20 / 3.194, 0.05 + 0.005


@pytest.fixture(scope="module")
def robot():
    return robots()[0][0]


def looked_at(robot, distance, velocity, obstacle_velocity, command, reaction_s=0.1):
    """Look once at a ball ``distance`` beside the forearm, which turns towards it at ``velocity`` [rad/s]."""
    position = np.array([0.0, -0.3, 0.3, 0.0, 0.0, 0.0])
    ball = {"id": "ball", "shape": "sphere", "size": (0.05,), "velocity": obstacle_velocity}
    model = DistanceModel(robot)

    def gap(y):
        model.set_obstacles([Obstacle(position=(0.33, -y, 0.224), **ball)])
        return model.nearest(position).distance

    low, high = 0.02, 3.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gap(middle) < distance else (low, middle)
    ball = Obstacle(position=(0.33, -high, 0.224), **ball)
    world = SimpleNamespace(
        plant=SimpleNamespace(position=position, velocity=np.array([-velocity, 0, 0, 0, 0, 0.0])),
        obstacles=lambda: (ball,),
    )
    model.set_obstacles([ball])
    pair = model.nearest(position)
    speed = -pair.normal @ robot.point_velocity(position, world.plant.velocity, pair.link, pair.point_on_link)
    result = Result(piece=Piece(scenario="crossing", number=0, profile="iso", seed=0))
    watch = robots()[0][1]
    watch.begin()
    watch.look(1.0, world, np.array([-command, 0, 0, 0, 0, 0.0]), reaction_s, result)
    return result, speed


@pytest.mark.parametrize("human", [0.0, 0.8, 1.6])
def test_short_begins_where_the_distance_is_the_separation(robot, human):
    _, speed = looked_at(robot, 0.3, 0.4, (0.0, human, 0.0), 0.4)
    assert speed > 0.1
    S_p = human * (0.1 + T_S) + speed * (0.1 + GAIN) + FIXED
    enough, _ = looked_at(robot, S_p + 0.01, 0.4, (0.0, human, 0.0), 0.4)
    short, near = looked_at(robot, S_p - 0.01, 0.4, (0.0, human, 0.0), 0.4)
    assert (enough.short, enough.apart, short.short, short.apart) == (0, 0, 1, 0)
    # The nearest point, and with it its speed, is another one there.
    demanded = human * (0.1 + T_S) + near * (0.1 + GAIN) + FIXED
    assert short.worst_m == pytest.approx(demanded - (S_p - 0.01), abs=1e-6)
    assert short.worst_s == pytest.approx(short.worst_m / (human + near), rel=1e-6)


def test_an_arm_that_stands_or_retreats_is_counted_apart(robot):
    for velocity in (0.0, -0.5):
        result, speed = looked_at(robot, 0.1, velocity, (0.0, 1.0, 0.0), velocity)
        assert speed <= 0.0
        assert (result.short, result.apart, result.spent) == (0, 1, 0)


def test_the_reaction_is_spent_where_a_stop_at_once_comes_too_late(robot):
    _, speed = looked_at(robot, 0.3, 0.4, (0.0, 1.0, 0.0), 0.4)
    least = T_S + speed * GAIN + FIXED
    for distance, command, spent in ((least + 0.01, 0.4, 0), (least - 0.01, 0.4, 1), (least - 0.01, 0.0, 0)):
        result, _ = looked_at(robot, distance, 0.4, (0.0, 1.0, 0.0), command)
        assert (result.short, result.spent) == (1, spent)
        assert bool(result.example) == bool(spent)


def test_contacts_are_told_apart_by_who_comes(robot):
    result, _ = looked_at(robot, -0.005, 0.4, (0.0, 0.0, 0.0), 0.4)
    assert (result.contacts > 0, result.least_m < 0.0) == (True, True)
    result, _ = looked_at(robot, -0.005, 0.0, (0.0, 1.0, 0.0), 0.0)
    assert (result.contacts, result.touched > 0) == (0, True)


def test_the_plain_stop_is_safe_at_the_fastest_speed(robot):
    reaction = 2.0 * (1.0 / 30.0 + PERIOD_S) + PERIOD_S + 0.02 + 0.016
    expected = 1.6 * (reaction + T_S) + 0.6 * (reaction + GAIN) + FIXED
    assert plain_distance(robot) == pytest.approx(expected)


@pytest.mark.parametrize("name", SCENARIOS)
def test_variants_differ_stay_walkable_and_come_again_for_the_same_seed(robot, name):
    drawn = [variant(robot, name, np.random.default_rng([3, number])) for number in (0, 1, 0)]
    at = [[one.obstacles_at(t)[0] for t in np.linspace(0.0, 20.0, 200)] for one in drawn]
    assert [one.position for one in at[0]] == [one.position for one in at[2]]
    assert at[0][0].position != at[1][0].position
    speeds = [math.hypot(*one.velocity) for run in at for one in run]
    assert 0.05 < max(speeds) <= FASTEST_M_S + 1e-9


def test_iso_keeps_its_distance_in_a_few_variants():
    todo = [piece for piece in pieces(11, 1, horizon_s=6.0) if piece.profile == "iso"]
    results = [run(piece) for piece in todo]
    rows = table(results)
    assert [row["scenario"] for row in rows] == list(SCENARIOS)
    assert not broken(rows)
    for row in rows:
        assert row["green"] + row["yellow"] + row["red"] + row["stop"] == pytest.approx(1.0)
    assert broken([{**rows[0], "contacts": 1}])

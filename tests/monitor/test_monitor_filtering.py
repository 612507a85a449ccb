"""The rows of ``filter``: which are looked at, and that those left out would change nothing."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bench.scenes import draw_scenes
from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.monitor import JointSample, Target, filtering
from ssm_service.monitor.filter_rows import MOST_EXACT, RowMaker
from ssm_service.monitor.filtering import Filtering
from ssm_service.monitor.snapshot import Snapshot

DT = 0.008
FILE = Path(__file__).parents[2] / "bench" / "avoidance_robot.toml"


@pytest.fixture(scope="module")
def arm():
    return Robot.load(FILE)


class Case:
    """Random arms among ten balls; a target of the joints' velocity."""

    def __init__(self, arm, seed, *, farthest=0.3, fastest=0.3):
        self.arm, rng = arm, np.random.default_rng(seed)
        (scene,) = draw_scenes(arm, 10, 1, seed, farthest)
        self.position = scene.position
        self.obstacles = tuple(
            Obstacle(
                id=one.id,
                shape=one.shape,
                size=one.size,
                position=one.position,
                velocity=tuple(rng.uniform(-fastest, fastest, 3)),
            )
            for one in scene.obstacles
        )
        self.distances = DistanceModel(arm)
        self.distances.set_obstacles(self.obstacles)
        self.wanted = rng.uniform(-0.5, 0.5, 6)
        self.previous = self.wanted + rng.uniform(-0.03, 0.03, 6)

    def snapshot(self, **changes):
        values = {
            "kinematics": self.arm.kinematics(self.position),
            "joints": JointSample(position=self.position, velocity=np.zeros(6)),
            "target": Target(kind="twist", value=np.zeros(6)),
            "nearest": None,
            "obstacles": self.obstacles,
            "pairs": self.distances.pairs(self.position, 0.6, located=False),
        }
        return Snapshot(**(values | changes))

    def step(self, limit=2.0):
        it = Filtering(self.arm, DT)
        velocity = it.step(self.snapshot(), self.wanted, self.previous, np.full(6, limit), self.distances)
        return velocity, it.last


@pytest.mark.parametrize("seed", range(24))
def test_rows_that_are_left_out_change_nothing(arm, monkeypatch, seed):
    case = Case(arm, seed, fastest=0.3 if seed % 2 else 0.0)
    few, told = case.step()
    monkeypatch.setattr(filtering, "ROOM", 1e9)  # no less than the box from the beginning
    most, _ = case.step()
    np.testing.assert_allclose(few, most, atol=1e-6)
    monkeypatch.setattr(RowMaker, "_tracked", _every)
    every, of_every = case.step()
    np.testing.assert_allclose(few, every, atol=1e-6)
    assert told.retreating == of_every.retreating


@pytest.mark.parametrize("seed", [10, 12, 19, 28])
def test_a_solution_faster_than_was_wanted_is_looked_at_again(arm, monkeypatch, seed):
    """What stands lets some joints give way at more than the wanted speed."""
    case = Case(arm, seed, fastest=0.0, farthest=0.2)
    case.wanted *= 0.1
    case.previous = case.wanted * 10.0
    made, speeds = RowMaker.rows, []

    def counted(self, snapshot, greatest, distances):
        speeds.append(float(greatest.max()))
        return made(self, snapshot, greatest, distances)

    monkeypatch.setattr(RowMaker, "rows", counted)
    twice, told = case.step()
    assert len(speeds) == 2
    assert speeds[0] < np.abs(twice).max() <= speeds[1]
    assert not told.retreating
    monkeypatch.setattr(filtering, "ROOM", 1e9)
    np.testing.assert_allclose(twice, case.step()[0], atol=1e-6)
    assert len(speeds) == 3


def _every(self, snapshot, pairs, speeds, distances):
    """Give a row to each pair, in another order, measured as the others are."""
    rows = np.arange(len(pairs))[::-1]
    self._measure(pairs, rows, distances)
    velocities = np.array([one.velocity for one in snapshot.obstacles])
    approach = np.einsum("ij,ij->i", pairs.normal, velocities[pairs.obstacle])[rows]
    moved = self._moved_rows[pairs.link[rows]]
    return self._made(
        snapshot, moved, pairs.distance[rows], pairs.point_on_link[rows], pairs.normal[rows], approach
    )


def test_few_rows_are_looked_at_where_little_is_wanted(arm):
    case = Case(arm, 5, farthest=0.5, fastest=0.0)
    maker, counts = RowMaker(arm), []
    for speed in (0.0, 0.05, 0.5, 50.0):
        snapshot = case.snapshot()
        rows = maker.rows(snapshot, np.full(6, speed), case.distances)
        counts.append(len(rows.bounds))
        known = int(snapshot.pairs.located.sum())
        assert known <= len(rows.bounds)
        assert np.isfinite(rows.gradients).all()
    assert counts == sorted(counts)
    assert counts[0] < 0.2 * counts[-1]


def test_only_the_nearest_are_measured_to_the_triangles(arm):
    case = Case(arm, 1)
    ball = Obstacle(id="ball", shape="sphere", size=(0.5,), position=(0.0, 0.0, 0.5))
    case.obstacles = (ball,)
    case.distances.set_obstacles(case.obstacles)
    snapshot = case.snapshot()
    RowMaker(arm).rows(snapshot, np.ones(6), case.distances)
    exact = snapshot.pairs.exact
    assert exact.sum() == MOST_EXACT
    assert snapshot.pairs.distance[exact].max() < snapshot.pairs.distance[~exact].min() + 0.02


def test_without_pairs_there_are_the_links_against_each_other(arm):
    case = Case(arm, 2)
    maker = RowMaker(arm)
    for changes in ({"pairs": None}, {"pairs": DistanceModel(arm).pairs(case.position), "obstacles": ()}):
        snapshot = case.snapshot(**changes)
        assert len(maker.rows(snapshot, np.zeros(6), case.distances).bounds) == 0
        rows = maker.rows(snapshot, np.full(6, 3.0), case.distances)
        assert len(rows.bounds) > 0
        np.testing.assert_array_equal(rows.bounds, rows.ceilings)
        assert not rows.normals.any()


@pytest.mark.parametrize("seed", range(6))
def test_what_is_asked_of_pairs_later_is_what_they_would_have_said(arm, seed):
    case = Case(arm, seed)
    every = case.distances.pairs(case.position)
    least = case.distances.nearest(case.position)
    some = case.distances.pairs(case.position, 0.3, located=False)
    assert np.isnan(some.normal).all()
    nearest = case.distances.nearest_of(some)
    assert (nearest.link, nearest.obstacle) == (least.link, least.obstacle)
    assert nearest.distance == pytest.approx(least.distance, abs=5e-6)
    row = int(some.exact.nonzero()[0][0])
    np.testing.assert_array_equal(some.normal[row], nearest.normal)
    assert some.distance[row] == nearest.distance
    case.distances.locate(some, np.arange(len(some)))
    assert some.located.all()
    for a in range(len(some)):
        if a != row:
            b = int(((every.link == some.link[a]) & (every.obstacle == some.obstacle[a])).nonzero()[0][0])
            assert some.distance[a] == pytest.approx(every.distance[b], abs=5e-6)  # GJK starts anew
            between = some.point_on_link[a] - some.point_on_obstacle[a]
            np.testing.assert_allclose(between, some.distance[a] * some.normal[a], atol=5e-5)
    case.distances.set_obstacles(())
    assert case.distances.nearest_of(case.distances.pairs(case.position)) is None


def test_a_ball_that_comes_goes_before_the_margin_from_a_plate(arm):
    """A ball from above onto the hand, a plate just beyond the margin below it: the hand goes down."""
    position = np.array([0.3, -1.3, 1.4, -0.6, -1.2, 0.4])
    case = Case(arm, 3)
    distances, itself, command = DistanceModel(arm), Filtering(arm, DT), np.zeros(6)
    hand = arm.kinematics(position).transform_end_effector_to_base[:3, 3]
    size = (0.6, 0.6, 0.02)
    low = 0.0
    while True:  # lower the plate until the arm is clear of it by a little more than the margin
        plate = Obstacle(
            id="plate", shape="box", size=size, position=(hand[0] + 0.25, hand[1], hand[2] - low),
            velocity=(0.0, 0.0, 0.0),
        )  # fmt: skip
        distances.set_obstacles((plate,))
        if distances.nearest(position).distance > 0.032:
            break
        low += 0.002
    least, comes, previous = math.inf, -math.inf, command
    for tick in range(250):
        height = hand[2] + 0.2 - 0.1 * tick * DT
        ball = Obstacle(
            id="ball", shape="sphere", size=(0.04,), position=(hand[0], hand[1], height),
            velocity=(0.0, 0.0, -0.1),
        )  # fmt: skip
        case.obstacles, case.position, case.distances = (plate, ball), position, distances
        distances.set_obstacles(case.obstacles)
        snapshot = case.snapshot()
        previous = itself.step(snapshot, np.zeros(6), previous, np.full(6, 1.0), distances)
        position = position + DT * previous
        pair = distances.pairs(position)
        least = min(least, float(pair.distance[pair.obstacle == 0].min()))
        comes = max(comes, -float(pair.distance[pair.obstacle == 1].min()))
    assert 0.0 < least < 0.03
    assert comes < 0.0

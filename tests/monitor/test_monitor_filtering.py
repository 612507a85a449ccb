"""The rows of ``filter``: which are looked at, and that those left out would change nothing."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bench.scenes import draw_scenes
from ssm_service.model import DistanceModel, Obstacle, Robot, moved_by
from ssm_service.model.hulls import build_parts
from ssm_service.monitor import JointSample, Target, filter_rows, filtering
from ssm_service.monitor.filter_rows import MOST_EXACT, RowMaker
from ssm_service.monitor.filtering import Filtering
from ssm_service.monitor.snapshot import Snapshot
from ssm_service.motion.self_collision import link_levers

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
        }
        return Snapshot(**(values | changes))

    def step(self, limit=2.0):
        it = Filtering(self.arm, DT)
        velocity = it.step(self.snapshot(), self.wanted, self.previous, np.full(6, limit), self.distances)
        return velocity, it.last


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("seed", range(24))
def test_rows_that_are_left_out_change_nothing(arm, monkeypatch, seed, cut):
    case, limit = Case(arm, seed, fastest=0.3 if seed % 2 else 0.0), 2.0
    if cut:
        case.previous, limit = 0.2 * case.wanted, 0.3
    few, told = case.step(limit)
    monkeypatch.setattr(Filtering, "_alone", lambda *_: None)  # no less than the box from the beginning
    most, _ = case.step(limit)
    np.testing.assert_allclose(few, most, atol=1e-5)
    monkeypatch.setattr(RowMaker, "_tracked", _every)
    every, of_every = case.step(limit)
    np.testing.assert_allclose(few, every, atol=1e-5)
    assert told.retreating == of_every.retreating


def _every(self, snapshot, speeds, velocity, distances):
    """Give a row to each pair, in another order, measured as the others are."""
    del speeds, velocity
    pairs = distances.pairs(snapshot.joints.position)
    self._measure(pairs, distances)
    rows = np.arange(len(pairs))[::-1]
    velocities = np.array([one.velocity for one in snapshot.obstacles])
    approach = np.einsum("ij,ij->i", pairs.normal, velocities[pairs.obstacle])[rows]
    moved = self._moved_rows[pairs.link[rows]]
    return self._made(
        snapshot, moved, pairs.distance[rows], pairs.point_on_link[rows], pairs.normal[rows], approach
    )


@pytest.mark.parametrize("seed", range(12))
def test_it_is_solved_once_where_nothing_objects(arm, monkeypatch, seed):
    """What all pairs leave alone is not looked at twice, and what one does not is."""
    case = Case(arm, seed, fastest=0.0, farthest=0.6)
    calls, made = [], RowMaker._rows

    def counted(self, snapshot, speeds, velocity, distances):
        found = made(self, snapshot, speeds, velocity, distances)
        calls.append((speeds, velocity, found))
        return found

    monkeypatch.setattr(RowMaker, "_rows", counted)
    velocity, told = case.step()
    (slow, at, near), *second = calls
    np.testing.assert_array_equal(at, case.wanted)
    closing = near.gradients @ at
    free = bool((closing <= np.minimum(near.bounds, near.ceilings)).all()) and bool((near.bounds >= 0).all())
    assert len(second) == (not free)
    if free:
        np.testing.assert_array_equal(velocity, case.wanted)
        assert (told.status, told.active) == ("free", ())
    else:
        ((fast, nowhere, every),) = second
        assert nowhere is None
        assert (fast >= slow).all()
        assert len(every.bounds) >= len(near.bounds)


def test_there_are_both_kinds(arm):
    told = [Case(arm, seed, fastest=0.0, farthest=0.6).step()[1].status for seed in range(12)]
    assert 2 < told.count("free") < 10


@pytest.mark.parametrize("seed", [0, 1, 4, 8, 14])
def test_what_was_before_changes_nothing(arm, seed):
    case = Case(arm, seed, farthest=0.07, fastest=0.0)
    wild = Case(arm, seed, farthest=0.07, fastest=0.0)
    wild.wanted = -4.0 * case.wanted
    it = Filtering(arm, DT)

    def step(case):
        return it.step(case.snapshot(), case.wanted, case.previous, np.full(6, 2.0), case.distances)

    fresh = step(case)
    for _ in range(3):
        step(wild)
    np.testing.assert_allclose(step(case), fresh, atol=1e-9)


def test_what_no_joint_moves_asks_for_nothing_and_costs_nothing(arm, monkeypatch):
    """A table just below the base is within the margin of a link that nobody can move away."""
    case = Case(arm, 5, farthest=0.6, fastest=0.0)
    table = Obstacle(id="table", shape="box", size=(1.0, 1.0, 0.1), position=(0.0, 0.0, -0.055))
    case.obstacles = (table,)
    case.distances.set_obstacles(case.obstacles)
    assert case.distances.pairs(case.position).distance.min() < 0.03
    calls, made = [], RowMaker._rows
    monkeypatch.setattr(RowMaker, "_rows", lambda *given: calls.append(1) or made(*given))
    case.position = np.array([0.3, -1.3, 1.0, -0.6, -1.2, 0.4])
    case.wanted = np.full(6, 0.05)
    case.previous = case.wanted
    velocity, told = case.step()
    np.testing.assert_array_equal(velocity, case.wanted)
    assert (told.status, len(calls)) == ("free", 1)


def test_a_solver_that_fails_alone_is_asked_with_all_pairs(arm, monkeypatch):
    case = Case(arm, 5, farthest=0.6, fastest=0.0)
    expected, told = case.step()
    monkeypatch.setattr(filtering, "in_box", lambda *_: None)
    found, again = case.step()
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert again.active == told.active


def test_few_rows_are_looked_at_where_little_is_wanted(arm):
    case = Case(arm, 5, farthest=0.5, fastest=0.0)
    maker, counts = RowMaker(arm), []
    for speed in (0.0, 0.05, 0.5, 50.0):
        rows = maker.within(case.snapshot(), np.full(6, speed), case.distances)
        counts.append(len(rows.bounds))
        assert np.isfinite(rows.gradients).all()
    assert counts == sorted(counts)
    assert counts[0] < 0.2 * counts[-1]


@pytest.mark.parametrize("seed", range(8))
def test_no_link_is_faster_than_is_said(arm, seed):
    """Corners of the hulls, their speeds by differences of their places."""
    case, rng = Case(arm, seed), np.random.default_rng(seed)
    velocity = rng.uniform(-1.0, 1.0, 6)
    moved = np.array([moved_by(arm, link) for link in arm.monitored_links])
    spatial = arm.kinematics(case.position).spatial_jacobian
    said = case.distances.link_speeds(case.position, spatial, moved, velocity)
    by_levers = link_levers(arm) @ np.abs(velocity)
    assert said.sum() < 0.9 * by_levers.sum()
    step = 1e-6
    here, there = (_corners(arm, case.position + sign * step * velocity) for sign in (-0.5, 0.5))
    for index, link in enumerate(arm.monitored_links):
        speeds = np.linalg.norm(there[link] - here[link], axis=1) / step
        assert speeds.max() <= said[index] + 1e-6
        assert speeds.max() <= by_levers[index] + 1e-6


@pytest.mark.parametrize("seed", range(12))
def test_whatever_links_are_asked_the_rows_that_could_be_offended_are_there(arm, monkeypatch, seed):
    case = Case(arm, seed)
    maker, snapshot = RowMaker(arm), case.snapshot()
    every = maker.within(snapshot, np.full(6, 50.0), case.distances)
    offended = every.gradients @ case.wanted > np.minimum(every.bounds, every.ceilings)
    expected = {tuple(row) for row in np.round(every.gradients[offended], 6)}
    counts = []
    for most in (0, 6, 10_000):
        monkeypatch.setattr(filter_rows, "MOST_LOOSE", most)
        found = maker.at(snapshot, case.wanted, case.distances)
        counts.append(len(found.bounds))
        assert expected <= {tuple(row) for row in np.round(found.gradients, 6)}
    assert counts[0] <= counts[2] < len(every.bounds)


def _corners(arm, position):
    """Return the corners of all hull pieces of each link, (c, 3), base frame."""
    found = {link: [] for link in arm.monitored_links}
    transforms = arm.link_transforms(position)
    frames = {frame.name: frame.placement.homogeneous for frame in arm.model.frames}
    for part in build_parts(arm):
        T_link_part = np.linalg.inv(frames[part.link]) @ part.source.placement.homogeneous
        T = transforms[part.link] @ T_link_part
        for piece in part.pieces:
            points = np.array(piece.points()) if hasattr(piece, "points") else _box_corners(piece)
            found[part.link].extend(points @ T[:3, :3].T + T[:3, 3])
    return {link: np.array(points) for link, points in found.items()}


def _box_corners(piece):
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    return signs * np.array(piece.halfSide)


def test_only_the_nearest_are_measured_to_the_triangles(arm, monkeypatch):
    case = Case(arm, 1)
    ball = Obstacle(id="ball", shape="sphere", size=(0.5,), position=(0.0, 0.0, 0.5))
    case.obstacles = (ball,)
    case.distances.set_obstacles(case.obstacles)
    seen, below = [], DistanceModel.below
    monkeypatch.setattr(
        DistanceModel, "below", lambda *given, **more: seen.append(below(*given, **more)) or seen[-1]
    )
    maker = RowMaker(arm)
    maker.within(case.snapshot(), np.ones(6), case.distances)
    (pairs,) = seen
    assert pairs.exact.sum() == MOST_EXACT
    assert pairs.distance[pairs.exact].max() < pairs.distance[~pairs.exact].min() + 0.02


def test_without_obstacles_there_are_the_links_against_each_other(arm):
    case = Case(arm, 2)
    maker, snapshot = RowMaker(arm), case.snapshot(obstacles=())
    assert len(maker.within(snapshot, np.zeros(6), case.distances).bounds) == 0
    rows = maker.within(snapshot, np.full(6, 3.0), case.distances)
    assert len(rows.bounds) > 0
    np.testing.assert_array_equal(rows.bounds, rows.ceilings)
    assert not rows.normals.any()


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

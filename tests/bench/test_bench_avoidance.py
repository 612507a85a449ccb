"""The scenes of ``bench.avoidance`` are what they say, and its judge sees contacts and their fault."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from bench import avoidance_methods as methods
from bench import avoidance_scenes as scenes
from bench.avoidance_draw import MOST, draw, straight_motion
from bench.avoidance_judge import Contact, Judge
from bench.avoidance_outcome import Outcome
from bench.avoidance_run import ARRIVED_M, STILL_RAD, STILL_S, Piece, Progress, run, simulate
from bench.avoidance_scenes import KINDS, Mover, Scene, World, end_effector
from bench.avoidance_things import CLEAR_M
from ssm_service.model import DistanceModel, Obstacle, closing_gradients, moved_by
from ssm_service.motion import linear_approach, linear_to_joints

START = np.array([-0.8, -1.2, 1.2, -1.6, -1.57, 0.0])
GOAL = end_effector(np.array([0.2, -1.2, 1.2, -1.6, -1.57, 0.0]))
NUMBERS = range(3)


def scene(
    *, fixed: tuple[Obstacle, ...] = (), movers: tuple[Mover, ...] = (), goal: np.ndarray = GOAL
) -> Scene:
    return Scene(number=0, kind="static", start=START, goal=goal, fixed=fixed, movers=movers, blocked=False)


def flying(towards: np.ndarray, velocity: tuple[float, float, float], away_m: float = 0.25) -> Mover:
    speed = np.array(velocity)
    begin = towards - speed * (away_m / np.linalg.norm(speed))
    ball = Obstacle(id="ball", shape="sphere", size=(0.05,), position=tuple(begin.tolist()))
    return Mover(obstacle=ball, velocity=speed)


@pytest.fixture(scope="module")
def drawn() -> list[Scene]:
    return [draw(1, number) for number in NUMBERS]


def test_the_same_number_is_the_same_scene_and_kinds_take_turns(drawn):
    again = draw(1, 2)
    np.testing.assert_array_equal(again.start, drawn[2].start)
    assert again.fixed == drawn[2].fixed
    assert [one.obstacle for one in again.movers] == [one.obstacle for one in drawn[2].movers]
    assert [one.kind for one in drawn] == [KINDS[number % 3] for number in NUMBERS]
    assert not np.array_equal(draw(2, 2).start, drawn[2].start)


def test_start_is_clear_the_goal_can_be_reached_and_something_moves(drawn):
    distance = DistanceModel(scenes.robot())
    for one in drawn:
        assert 1 <= len(one.fixed) + len(one.movers) <= MOST
        assert bool(one.movers) == (one.kind != "static")
        distance.set_obstacles([*one.fixed, *(mover.obstacle for mover in one.movers)])
        assert float(distance.bounds(one.start).min()) >= CLEAR_M
        way = straight_motion(one.start, one.goal)
        assert way is not None
        assert np.linalg.norm(end_effector(way[-1]) - one.goal) < 0.005
        distance.set_obstacles(one.fixed)
        touched = bool(one.fixed) and any(float(distance.bounds(q).min()) <= 0.0 for q in way)
        assert one.blocked == touched
    assert any(one.blocked for one in drawn)


def test_everything_that_moves_is_gone_in_the_end_and_stays_off_the_base(drawn):
    for one in drawn:
        world, hand = World(one), end_effector(one.start)
        for _ in range(5000):
            if world.still:
                break
            for obstacle in world.obstacles()[len(one.fixed) :]:
                assert math.hypot(*obstacle.position[:2]) > scenes.BASE_M
            world.step(hand, 0.008)
        assert world.still
        assert len(world.obstacles()) == len(one.fixed)


def test_what_crosses_flies_straight_at_its_speed():
    mover = flying(GOAL, (0.0, 0.2, 0.1))
    world = World(scene(movers=(mover,)))
    before = np.array(world.obstacles()[0].position)
    for _ in range(100):
        world.step(GOAL, 0.01)
    (after,) = world.obstacles()
    np.testing.assert_allclose(np.array(after.position) - before, [0.0, 0.2, 0.1], atol=1e-9)
    assert after.velocity == (0.0, 0.2, 0.1)


def test_what_chases_comes_nearer_and_then_leaves():
    ball = Obstacle(id="ball", shape="sphere", size=(0.05,), position=(0.7, -0.3, 0.3))
    world = World(scene(movers=(Mover(obstacle=ball, velocity=np.zeros(3), speed_m_s=0.1, until_s=3.0),)))
    hand, distances = end_effector(START), []
    while not world.still:
        distances.append(float(np.linalg.norm(np.array(world.obstacles()[0].position) - hand)))
        world.step(hand, 0.01)
    assert np.all(np.diff(distances[:250]) < 0.0)
    assert distances[-1] > 0.8
    assert world.time_s < 8.0


@pytest.mark.parametrize("name", methods.METHODS)
def test_every_method_arrives_where_nothing_is_in_the_way(name):
    far = Obstacle(id="far", shape="sphere", size=(0.05,), position=(-0.9, 0.0, 0.9))
    found = simulate(scene(fixed=(far,)), name, planned=1.0, horizon_s=8.0)
    assert found.end == "arrived"
    assert found.goal_m <= ARRIVED_M
    assert found.least_m > 0.3
    assert found.path > 0.5
    assert found.solve_us.total() == found.instants


class Straight:
    """Goes straight to the goal whatever is there."""

    def velocity(self, state):
        config = state.robot.config.file.motion
        linear = linear_approach(state.end_effector, state.goal, config)
        return linear_to_joints(state.kinematics.jacobian, state.robot.free, linear, config, 6)


class Standing:
    """Does nothing."""

    def velocity(self, state):
        return np.zeros(6)


class Fleeing:
    """Turns the point that is nearest at first away as fast as the zone allows."""

    def __init__(self):
        self._signs = None

    def velocity(self, state):
        if self._signs is None:
            nearest = state.nearest
            moved = moved_by(state.robot, nearest.link)[np.newaxis]
            points, normals = nearest.point_on_link[np.newaxis], nearest.normal[np.newaxis]
            spatial = state.kinematics.spatial_jacobian
            gradient = closing_gradients(spatial, moved, points, normals)[0]
            self._signs = np.where(np.abs(gradient) > 1e-3, -np.sign(gradient), 0.0)
        return self._signs * state.speed_limit


@pytest.fixture
def fakes(monkeypatch):
    for name, made in (("straight", Straight), ("standing", Standing), ("fleeing", Fleeing)):
        monkeypatch.setitem(methods.METHODS, name, lambda robot, made=made: made())


def test_arm_that_drives_into_something_is_at_fault(fakes):
    place = 0.5 * (end_effector(START) + GOAL)
    block = Obstacle(id="block", shape="sphere", size=(0.08,), position=tuple(place.tolist()))
    found = simulate(scene(fixed=(block,)), "straight", planned=1.0, horizon_s=8.0)
    assert (found.end, found.contact, found.apart) == ("contact", "drove", 0)
    assert found.least_m <= 0.0
    assert "block" in found.where
    assert found.arrived_s is None


def test_arm_that_stands_in_the_way_is_at_fault_as_well(fakes):
    ball = flying(end_effector(START), (0.0, -0.2, 0.0))
    found = simulate(scene(movers=(ball,)), "standing", planned=1.0, horizon_s=4.0)
    assert (found.end, found.contact) == ("contact", "yielding")


def test_arm_that_flees_as_fast_as_it_may_is_run_into(fakes):
    small = flying(end_effector(START), (0.0, -0.8, 0.0), away_m=0.6)
    ball = replace(small, obstacle=replace(small.obstacle, size=(0.2,)))
    found = simulate(scene(movers=(ball,)), "fleeing", planned=1.0, horizon_s=1.5)
    assert found.retreating >= 1
    assert found.contact == ""


def test_base_cannot_flee(fakes):
    ball = flying(np.array([0.0, 0.0, 0.06]), (-0.5, 0.0, 0.0), away_m=0.3)
    found = simulate(scene(movers=(ball,)), "standing", planned=1.0, horizon_s=0.6)
    assert found.helpless >= 1
    assert found.contact == ""


def test_filter_lets_a_ball_pass_that_would_have_touched_it(fakes):
    ball = flying(end_effector(START), (0.0, -0.15, 0.0))
    found = simulate(scene(movers=(ball,), goal=end_effector(START)), "filter", planned=1.0, horizon_s=15.0)
    assert (found.end, found.contact, found.apart) == ("arrived", "", 0)
    assert found.least_m > 0.0


def test_arm_that_stands_still_short_of_its_goal_is_stuck(fakes):
    found = simulate(scene(), "standing", planned=None, horizon_s=20.0)
    assert found.end == "stuck"
    assert found.goal_m == pytest.approx(float(np.linalg.norm(GOAL - end_effector(START))))
    assert not found.possible


def test_arm_that_swings_to_and_fro_makes_no_progress_and_one_on_its_way_round_does():
    watched, place = Progress(START), START.copy()
    for tick in range(1000):
        place[0] = START[0] + 0.5 * STILL_RAD * math.sin(0.1 * tick)
        idle = watched.step(0.008 * tick, place, 0.3, waiting=False)
    assert idle > STILL_S
    for tick in range(1000, 2000):
        place[0] += 0.002
        idle = watched.step(0.008 * tick, place, 0.4, waiting=False)
    assert idle < 1.0
    left = 0.3
    for tick in range(2000, 3000):
        left *= 0.999
        idle = watched.step(0.008 * tick, place, left, waiting=False)
    assert idle < STILL_S
    assert watched.step(80.0, place, left, waiting=True) == 0.0


def test_arm_that_closes_itself_is_at_fault_though_it_could_not_retreat():
    def judged(**changes: float) -> Outcome:
        found = Outcome(number=0, kind="static", method="field", possible=True, blocked=False, planned=1.0)
        contact = {"closing": 0.0, "might": 0.0, "comes": 0.2} | changes
        Judge._judge(Contact(link="a", obstacle="b", **contact), 1.0, found)
        return found

    assert (judged().helpless, judged().contact) == (1, "")
    assert judged(closing=0.1).contact == "drove"
    assert judged(comes=0.0).contact == "yielding"
    fleeing = judged(might=0.2, closing=-0.17)
    assert (fleeing.retreating, fleeing.contact) == (1, "")
    assert judged(might=0.2, closing=-0.15).contact == "yielding"
    assert "might retreat at 0.200" in fleeing.info["apart"]


def test_runs_depend_on_their_scene_alone_but_for_times():
    scene = {"scene": draw(1, 3).to_builtins(), "planned": 1.0}
    kept = json.loads(json.dumps(scene))
    for method in ("field", "filter"):
        first = run(Piece(scene=scene, method=method, horizon_s=2.0))
        run(Piece(scene=scene, method="pink", horizon_s=0.1))
        again = run(Piece(scene=kept, method=method, horizon_s=2.0))
        assert replace(first, solve_us={}) == replace(again, solve_us={})


def test_a_scene_comes_back_from_its_json(drawn):
    for one in drawn:
        back = Scene.of(json.loads(json.dumps(one.to_builtins())))
        np.testing.assert_array_equal(back.start, one.start)
        np.testing.assert_array_equal(back.goal, one.goal)
        assert (back.number, back.kind, back.blocked) == (one.number, one.kind, one.blocked)
        pairs = [*zip(back.fixed, one.fixed, strict=True)]
        for mover, other in zip(back.movers, one.movers, strict=True):
            np.testing.assert_array_equal(mover.velocity, other.velocity)
            assert (mover.speed_m_s, mover.until_s) == (other.speed_m_s, other.until_s)
            pairs.append((mover.obstacle, other.obstacle))
        for obstacle, other in pairs:
            # An orientation is normalised anew.
            assert obstacle.quaternion_xyzw == pytest.approx(other.quaternion_xyzw, abs=1e-15)
            level = {"quaternion_xyzw": (0.0, 0.0, 0.0, 1.0)}
            assert replace(obstacle, **level) == replace(other, **level)

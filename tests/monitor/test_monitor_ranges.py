"""What the profile makes of the rings: the estimator that it names, uncovered sectors, contradictions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.monitor import EvaluationInput, JointSample, Monitor
from ssm_service.perception import scan
from ssm_service.safety import Zone

UR3 = (Path(__file__).parents[2] / "robots" / "ur3.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def robot_with(tmp_path_factory):
    """Return the UR3 with other keys in its profile, or with lines of its file replaced."""
    made: dict[tuple, Robot] = {}

    def make(profile: str = "", *replaced: tuple[str, str]) -> Robot:
        if (profile, replaced) not in made:
            text = UR3
            for old, new in (
                ("[profiles.kang2022]\nuncovered", f"[profiles.kang2022]\n{profile}\nuncovered"),
                *replaced,
            ):
                assert old in text
                text = text.replace(old, new)
            path = tmp_path_factory.mktemp("robots") / "arm.toml"
            path.write_text(text, encoding="utf-8")
            made[profile, replaced] = Robot.load(path)
        return made[profile, replaced]

    return make


UNCOVERED = 'uncovered = "off"'
MANY = ('obstacles = "one"', 'obstacles = "many"')


def settle(monitor, scene, ticks=110):
    for _ in range(ticks):
        decision = monitor.step(scene.inputs())
    return decision


@pytest.mark.parametrize(("worth", "zone"), [("yellow", Zone.YELLOW), ("red", Zone.RED), ("stop", Zone.STOP)])
def test_an_uncovered_sector_is_a_reason_as_configured(robot_with, scene, sphere, worth, zone):
    """Eight cones of 20° leave most directions unseen: silence proves nothing."""
    monitor = Monitor(robot_with("", (UNCOVERED, f'uncovered = "{worth}"')))
    decision = settle(monitor, scene)
    assert decision.zone is zone
    assert "uncovered" in decision.reasons
    # A tracker looks everywhere.
    scene.obstacles = (sphere(3.0),)
    decision = settle(monitor, scene)
    assert decision.zone is Zone.GREEN
    assert "uncovered" not in decision.reasons


def test_the_paper_takes_silence_as_clear(robot_with, scene):
    decision = settle(Monitor(robot_with()), scene)
    assert decision.zone is Zone.GREEN
    assert "uncovered" not in decision.reasons


def test_the_zone_follows_the_estimator_that_the_profile_names(robot_with, scene):
    scene.ranges = np.full(8, np.inf)
    scene.ranges[2] = 0.5
    nearest = settle(Monitor(robot_with()), scene)
    assert nearest.zone is Zone.GREEN
    assert nearest.distance == 0.5
    robot = robot_with('range_estimator = "lower_bound"')
    bound = settle(Monitor(robot), scene)
    # ε is 6 cm and the ball may only graze the cone, so it is far below the reading.
    assert 0.2 < bound.distance < 0.5 - 0.06
    assert bound.nearest.source == "ranges"
    assert bound.nearest.link == "forearm_link"
    ball = bound.nearest.point_on_obstacle - bound.nearest.point_on_link
    assert np.linalg.norm(ball) == pytest.approx(bound.distance, abs=1e-3)
    assert bound.nearest.normal @ ball == pytest.approx(-bound.distance, abs=2e-3)


def test_where_another_ball_may_hide_the_bound_is_no_distance_and_the_zone_is_stop(robot_with, scene):
    robot = robot_with('range_estimator = "lower_bound"', MANY)
    decision = settle(Monitor(robot), scene)
    assert decision.zone is Zone.STOP
    assert decision.distance == 0.0
    assert decision.reasons[0] == "uncovered"
    assert "contact" not in decision.reasons


def test_readings_that_no_ball_explains_break_the_promise(robot_with, scene):
    """Opposite sensors that see something near: no one ball of at most 15 cm reaches round the arm."""
    robot = robot_with('range_estimator = "lower_bound"')
    scene.ranges = np.full(8, np.inf)
    scene.ranges[[0, 4]] = 0.3
    decision = settle(Monitor(robot), scene)
    assert decision.zone is Zone.STOP
    assert "disagree" in decision.reasons


def test_the_comparison_is_there_whenever_both_sources_are(robot_with, scene, sphere):
    robot = robot_with()
    monitor, exact = Monitor(robot), DistanceModel(robot)
    assert settle(monitor, scene, 1).comparison is None
    rng = np.random.default_rng(5)
    compared = 0
    for _ in range(30):
        scene.position = np.array([*rng.uniform(-1.5, 1.5, 3), 0.0, 0.0, 0.0])
        kinematics = robot.kinematics(scene.position)
        middle = kinematics.transform_rings_to_base[0][:3, 3]
        step = rng.normal(size=3)
        scene.obstacles = (sphere(*(middle + 0.3 * step / np.linalg.norm(step))), sphere(2.0, id="far"))
        ring = robot.rings[0]
        scene.ranges = scan(
            scene.obstacles, kinematics.transform_sensors_to_base, ring.half_angle, ring.range_max
        )
        found = monitor.step(scene.inputs()).comparison
        exact.set_obstacles(scene.obstacles)
        truth = min(p.distance for p in exact.all_pairs(scene.position) if p.link == "forearm_link")
        assert found.link == "forearm_link"
        assert found.estimator == "nearest"
        assert found.exact == pytest.approx(truth, abs=2e-6)
        if np.isfinite(scene.ranges).any():
            compared += 1
            assert found.estimate == scene.ranges.min()
            assert found.difference == pytest.approx(scene.ranges.min() - truth, abs=2e-6)
        else:
            assert (found.estimate, found.difference) == (None, None)
        assert not found.disagrees
    assert compared >= 5


SENSOR = 4  # in this pose it looks away from the rest of the arm


def beside_forearm(robot, scene, gap, sensor=SENSOR):
    """Return a ball ``gap`` in front of a sensor, and its reading."""
    T_base_sensor = robot.kinematics(scene.position).transform_sensors_to_base[sensor]
    centre = T_base_sensor[:3, 3] + (gap + 0.05) * T_base_sensor[:3, 0]
    return Obstacle(id="ball", shape="sphere", size=(0.05,), position=tuple(centre))


@pytest.mark.parametrize(
    ("reading", "tracked", "disagrees"),
    [
        (0.6, 0.6, False),
        (0.6, 0.68, False),
        (0.6, 0.75, True),  # the tracker misses what the sensor sees
        (0.75, 0.6, True),  # the sensor misses what the tracker sees
        (0.6, None, True),  # the tracker says that nothing is there
        (np.inf, 0.6, False),  # the sensors cannot see everything
    ],
)
def test_sources_that_contradict_each_other_are_said(robot_with, scene, reading, tracked, disagrees):
    robot = robot_with('disagree_margin_m = 0.1\ndisagree_zone = "red"')
    scene.ranges = np.full(8, np.inf)
    scene.ranges[SENSOR] = reading
    scene.obstacles = () if tracked is None else (beside_forearm(robot, scene, tracked),)
    decision = settle(Monitor(robot), scene)
    assert ("disagree" in decision.reasons) is disagrees
    assert decision.zone is (Zone.RED if disagrees else Zone.GREEN)
    # The same without a margin: nobody minds.
    assert "disagree" not in settle(Monitor(robot_with()), scene).reasons


def test_a_bound_disagrees_only_where_it_is_broken(robot_with, scene):
    robot = robot_with('range_estimator = "lower_bound"\ndisagree_margin_m = 0.1')
    monitor = Monitor(robot)
    scene.ranges = np.full(8, np.inf)
    scene.ranges[SENSOR] = 0.8
    scene.obstacles = (beside_forearm(robot, scene, 0.8),)
    decision = settle(monitor, scene)
    assert decision.comparison.estimator == "lower_bound"
    assert decision.comparison.difference < 0.0  # the price of the ring is no contradiction
    assert "disagree" not in decision.reasons
    scene.obstacles = (beside_forearm(robot, scene, 0.3),)
    assert "disagree" in settle(monitor, scene).reasons


def test_evaluate_says_the_same_as_the_monitor(robot_with, scene, sphere):
    for robot in (
        robot_with('disagree_margin_m = 0.1\ndisagree_zone = "red"'),
        robot_with('range_estimator = "lower_bound"'),
        robot_with("", (UNCOVERED, 'uncovered = "red"')),
    ):
        monitor = Monitor(robot)
        for reading, obstacles in ((0.6, ()), (0.6, (sphere(3.0),)), (0.3, None), (np.inf, None)):
            scene.ranges = np.full(8, np.inf)
            scene.ranges[0], scene.obstacles = reading, obstacles
            decision = monitor.step(scene.inputs())
            answer = monitor.evaluate(
                EvaluationInput(
                    joints=JointSample(position=scene.position, velocity=np.zeros(6)),
                    ranges=scene.ranges,
                    obstacles=obstacles,
                )
            )
            assert answer.zone is decision.momentary_zone
            assert answer.distance == decision.distance
            assert set(answer.reasons) == set(decision.reasons) - {"waiting:target", "recovering"}


def test_all_five_estimators_answer(robot_with, scene):
    robot = robot_with()
    scene.ranges = np.full(8, np.inf)
    scene.ranges[[0, 1]] = 0.1, 0.12
    joints = JointSample(position=scene.position, velocity=np.zeros(6))
    found = Monitor(robot).evaluate(EvaluationInput(joints=joints, ranges=scene.ranges)).estimates
    assert found.reasons == {}
    assert found.lower_bound.distance < found.nearest.distance
    assert found.sphere_fit.sensors == (1, 2)
    assert 0.0 < found.sphere_fit.std < 0.2
    assert 0.0 < found.sphere_fit.bearing < np.pi / 4


def test_the_same_inputs_give_the_same_decisions_to_the_last_bit(robot_with, scene):
    robot = robot_with('range_estimator = "lower_bound"')
    rng = np.random.default_rng(8)
    scans = [np.where(rng.random(8) < 0.8, np.inf, rng.uniform(0.0, 1.2, 8)) for _ in range(25)]

    def run():
        monitor, decisions = Monitor(robot), []
        for readings in scans:
            scene.ranges = readings.copy()
            decisions.append(monitor.step(scene.inputs()))
        return [(d.zone, d.distance, d.reasons, d.velocity.tolist()) for d in decisions]

    assert run() == run()

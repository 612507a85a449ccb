import numpy as np
import pytest

from ssm_service.monitor import EvaluationInput, Monitor, Target, joint_sample
from ssm_service.perception import OwnLinks
from ssm_service.safety import Zone

POSE = [0.4, -1.1, 1.0, 0.3, -0.2, 0.1]


@pytest.fixture
def ask(robot):
    monitor = Monitor(robot)

    def evaluate(**known):
        velocity = known.pop("velocity", None)
        joints = joint_sample(robot, known.pop("position", POSE), velocity)
        return monitor.evaluate(EvaluationInput(joints=joints, velocity_known=velocity is not None, **known))

    return evaluate


def test_without_perception_it_is_a_stop(ask):
    answer = ask()
    assert answer.zone is Zone.STOP
    assert answer.reasons == ("waiting:ranges",)
    assert answer.velocity is None


def test_a_source_that_is_left_out_is_not_configured(ask):
    assert ask(obstacles=()).zone is Zone.GREEN
    assert ask(ranges=np.full(8, np.inf)).zone is Zone.GREEN


def test_zone_edges_by_readings(ask):
    for reading, zone in (
        (0.1775, Zone.RED),
        (0.17750001, Zone.YELLOW),
        (0.355, Zone.YELLOW),
        (0.35500001, Zone.GREEN),
    ):
        assert ask(ranges=np.array([reading] + [np.inf] * 7)).zone is zone


def test_every_link_and_obstacle_has_a_pair(ask, robot, sphere):
    answer = ask(obstacles=(sphere(0.5, id="a"), sphere(0.9, id="b")))
    pairs = [(entry.pair.link, entry.pair.obstacle) for entry in answer.pairs]
    assert pairs == [(link, obstacle) for link in robot.monitored_links for obstacle in ("a", "b")]
    assert answer.distance == min(entry.pair.distance for entry in answer.pairs)


def test_closing_speed_is_the_rate_of_the_distance(ask, sphere):
    """The distance to a fixed sphere falls at exactly the closing speed: checked by finite differences."""
    rng = np.random.default_rng(5)
    step = 1e-6
    for _ in range(20):
        q = rng.uniform(-1.5, 1.5, 6)
        v = rng.uniform(-1, 1, 6)
        obstacles = (sphere(*rng.uniform(0.35, 0.8, 3)),)
        now = ask(position=q.tolist(), velocity=v.tolist(), obstacles=obstacles)
        ahead = ask(position=(q + step * v).tolist(), obstacles=obstacles)
        behind = ask(position=(q - step * v).tolist(), obstacles=obstacles)
        for entry, after, before in zip(now.pairs, ahead.pairs, behind.pairs, strict=True):
            rate = (after.pair.distance - before.pair.distance) / (2 * step)
            assert entry.closing_speed == pytest.approx(-rate, abs=2e-3)
    assert ask(obstacles=obstacles).pairs[0].closing_speed is None


def test_a_target_gives_a_limited_command(ask):
    target = Target(kind="joint_velocity", value=np.array([2.0, 1.0, 0, 0, 0, 0]))
    red = ask(ranges=np.array([0.1] + [np.inf] * 7), target=target)
    assert red.velocity.tolist() == pytest.approx([0.18, 0.09, 0, 0, 0, 0])
    contact = ask(ranges=np.array([0.0] + [np.inf] * 7), target=target)
    assert contact.zone is Zone.STOP
    assert not contact.velocity.any()


def test_the_rings_field_is_not_repelled_by_own_links(ask, robot):
    folded = [1.18, -0.7, -2.29, 1.39, 0.16, -1.19]
    readings = OwnLinks(robot).readings(np.array(folded))
    assert readings.min() < robot.config.file.motion.influence_distance_m
    place = robot.kinematics(folded).transform_end_effector_to_base[:3, 3]
    target = Target(kind="position", value=place + np.array([0.05, -0.05, 0.05]), controller="field3d")
    directions = []
    for ranges in (readings, np.full(8, np.inf), np.where(np.isinf(readings), 0.15, readings)):
        velocity = ask(position=folded, ranges=ranges, target=target).velocity
        directions.append(velocity / np.linalg.norm(velocity))
    np.testing.assert_allclose(directions[0], directions[1], atol=1e-9)
    assert np.abs(directions[2] - directions[1]).max() > 0.05  # an obstacle where no own link is seen


def test_it_leaves_the_running_monitor_alone(robot, scene, sphere):
    monitor, twin = Monitor(robot), Monitor(robot)
    scene.obstacles = (sphere(0.7),)
    for tick in range(40):
        if tick == 20:
            monitor.evaluate(
                EvaluationInput(
                    joints=joint_sample(robot, [0.0] * 6), obstacles=(sphere(0.1), sphere(0.3, id="x"))
                )
            )
        a, b = monitor.step(scene.inputs()), twin.step(scene.inputs())
        assert (a.zone, a.distance) == (b.zone, b.distance)

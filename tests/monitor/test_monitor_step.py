import math

import numpy as np
import pytest

from ssm_service.errors import ConfigError
from ssm_service.model import DistanceModel
from ssm_service.monitor import Monitor, Target, default_valid_for
from ssm_service.safety import Zone

FAR, NEAR = 3.0, 0.6


def settle(monitor, scene, ticks=130):
    for _ in range(ticks):
        decision = monitor.step(scene.inputs())
    return decision


def test_it_starts_in_stop_and_needs_its_good_ticks(monitor, scene):
    needed = monitor.profile.config.recovery_ticks
    zones = [monitor.step(scene.inputs()).zone for _ in range(needed + 1)]
    assert zones[: needed - 1] == [Zone.STOP] * (needed - 1)
    assert zones[needed - 1 :] == [Zone.GREEN] * 2


@pytest.mark.parametrize("missing", ["position", "ranges"])
def test_stop_until_everything_required_has_arrived(monitor, scene, missing):
    setattr(scene, missing, None)
    decision = settle(monitor, scene)
    assert decision.zone is Zone.STOP
    assert f"waiting:{'joints' if missing == 'position' else missing}" in decision.reasons
    assert not decision.velocity.any()
    assert not decision.speed_limit.any()


@pytest.mark.parametrize("name", ["joints", "ranges", "obstacles"])
@pytest.mark.parametrize("fault", ["stale", "invalid"])
def test_every_fault_of_a_source_stops_in_the_same_tick(monitor, scene, sphere, name, fault):
    scene.obstacles = (sphere(FAR),)
    assert settle(monitor, scene).zone is Zone.GREEN
    if fault == "stale":
        scene.age[name] = 1.0
    else:
        scene.invalid.add(name)
    decision = monitor.step(scene.inputs())
    assert decision.zone is Zone.STOP
    assert f"{fault}:{name}" in decision.reasons


def test_an_optional_source_may_be_absent_but_not_vanish(monitor, scene, sphere):
    assert settle(monitor, scene).zone is Zone.GREEN
    scene.obstacles = (sphere(FAR),)
    assert settle(monitor, scene).zone is Zone.GREEN
    scene.age["obstacles"] = 10.0
    assert monitor.step(scene.inputs()).zone is Zone.STOP


def test_the_nearest_source_decides(monitor, scene, sphere):
    scene.obstacles = (sphere(FAR),)
    scene.ranges = np.array([np.inf, 0.3, np.inf, np.inf, 0.25, np.inf, np.inf, np.inf])
    decision = settle(monitor, scene)
    assert decision.distance == 0.25
    assert decision.nearest.source == "ranges"
    assert decision.zone is Zone.YELLOW
    assert decision.reasons[0] == "distance"
    assert decision.sources["ranges"].distance == 0.25
    assert decision.sources["obstacles"].distance == pytest.approx(2.6, abs=0.5)
    # The reading's point lies on the sensor's axis, and the normal points back to the link.
    step = decision.nearest.point_on_obstacle - decision.nearest.point_on_link
    assert np.linalg.norm(step) == pytest.approx(0.25, abs=1e-12)
    assert step / 0.25 == pytest.approx(-decision.nearest.normal, abs=1e-12)


def test_contact_is_a_stop(monitor, scene, sphere, robot):
    frames = robot.kinematics(scene.position)
    scene.obstacles = (sphere(*frames.transform_end_effector_to_base[:3, 3]),)
    decision = settle(monitor, scene)
    assert decision.zone is Zone.STOP
    assert "contact" in decision.reasons
    assert decision.distance < 0.0
    scene.obstacles = ()
    scene.ranges = np.array([0.0] + [np.inf] * 7)
    assert "contact" in settle(monitor, scene).reasons


def test_distance_is_that_of_the_exact_model(monitor, scene, sphere, robot):
    rng = np.random.default_rng(7)
    exact = DistanceModel(robot)
    for _ in range(30):
        scene.obstacles = tuple(sphere(*rng.uniform(-0.8, 0.8, 3), id=f"b{i}") for i in range(4))
        scene.position = rng.uniform(-2, 2, 6)
        decision = monitor.step(scene.inputs())
        exact.set_obstacles(scene.obstacles)
        least = min(pair.distance for pair in exact.all_pairs(scene.position))
        assert decision.distance == pytest.approx(least, abs=1e-9)
        assert decision.momentary_zone is monitor.profile.zone_at(decision.distance)


def test_an_empty_list_is_clear_and_a_missing_one_is_not_needed(monitor, scene):
    scene.obstacles = ()
    decision = settle(monitor, scene)
    assert decision.zone is Zone.GREEN
    assert decision.distance is None
    assert decision.nearest is None


def test_overrun_is_a_reason(monitor, scene):
    assert settle(monitor, scene).zone is Zone.GREEN
    scene.overrun_s = 0.001
    decision = monitor.step(scene.inputs())
    assert decision.zone is Zone.YELLOW
    assert "overrun" in decision.reasons
    scene.overrun_s = monitor.valid_for_s + 1e-6
    assert monitor.step(scene.inputs()).zone is Zone.STOP
    scene.overrun_s = 0.0
    assert "recovering" in monitor.step(scene.inputs()).reasons


def test_a_second_service_is_a_stop(monitor, scene):
    settle(monitor, scene)
    scene.duplicate = True
    decision = monitor.step(scene.inputs())
    assert decision.zone is Zone.STOP
    assert "duplicate:service" in decision.reasons


def test_without_a_target_the_command_is_zero_and_says_so(monitor, scene):
    decision = settle(monitor, scene)
    assert decision.zone is Zone.GREEN
    assert decision.reasons == ("waiting:target",)
    assert not decision.velocity.any()
    scene.target = Target(kind="joint_velocity", value=np.full(6, 0.1))
    assert settle(monitor, scene).velocity[:3] == pytest.approx([0.1] * 3)
    scene.age["target"] = 9.0
    decision = monitor.step(scene.inputs())
    assert decision.reasons == ("stale:target",)
    assert decision.zone is Zone.GREEN
    assert not decision.velocity.any()


def test_zone_limits_hold_and_keep_the_direction(monitor, scene, sphere):
    wanted = np.array([1.0, -0.5, 0.25, 0.0, 0.0, 0.0])
    scene.target = Target(kind="joint_velocity", value=wanted)
    for reading, limit in ((0.3, 0.24), (0.1, 0.18)):
        scene.ranges = np.array([reading] + [np.inf] * 7)
        decision = settle(monitor, scene, 500)
        assert np.abs(decision.velocity).max() == pytest.approx(limit, abs=1e-12)
        assert decision.velocity == pytest.approx(wanted * limit, abs=1e-12)
        assert (decision.speed_limit == limit).all()


def test_a_stop_is_not_ramped(monitor, scene):
    scene.target = Target(kind="joint_velocity", value=np.array([1.0, 0, 0, 0, 0, 0]))
    assert settle(monitor, scene, 800).velocity[0] == pytest.approx(1.0)
    scene.ranges = np.array([0.0] + [np.inf] * 7)
    assert not monitor.step(scene.inputs()).velocity.any()


def test_locked_joints_never_move(monitor, scene):
    scene.target = Target(kind="joint_velocity", value=np.ones(6))
    assert not settle(monitor, scene, 500).velocity[3:].any()


@pytest.mark.parametrize("kind", ["twist", "position"])
def test_task_targets_move_the_end_effector_where_they_say(monitor, scene, robot, kind):
    frames = robot.kinematics(scene.position)
    here = frames.transform_end_effector_to_base[:3, 3]
    along = np.array([0.0, 0.6, 0.8])
    value = np.concatenate((0.05 * along, np.zeros(3))) if kind == "twist" else here + 0.2 * along
    scene.target = Target(kind=kind, value=value)
    moved = frames.jacobian @ settle(monitor, scene, 500).velocity[:3]
    assert moved / np.linalg.norm(moved) == pytest.approx(along, abs=1e-6)


def test_the_same_inputs_give_the_same_decisions(robot, scene, sphere):
    rng = np.random.default_rng(3)
    inputs = []
    for _ in range(80):
        scene.position = scene.position + rng.normal(0, 0.01, 6)
        scene.obstacles = tuple(sphere(*rng.uniform(0.2, 1.0, 3), id=f"b{i}") for i in range(3))
        scene.ranges = np.where(rng.random(8) < 0.5, np.inf, rng.uniform(0.05, 1.2, 8))
        scene.target = Target(kind="position", value=rng.uniform(0.1, 0.4, 3))
        scene.age["ranges"] = float(rng.uniform(0.0, 0.45))
        inputs.append(scene.inputs())
    runs = []
    for _ in range(2):
        monitor = Monitor(robot)
        runs.append([monitor.step(one) for one in inputs])
    for a, b in zip(*runs, strict=True):
        assert (a.tick, a.zone, a.distance, a.reasons) == (b.tick, b.zone, b.distance, b.reasons)
        assert a.velocity.tobytes() == b.velocity.tobytes()
        assert a.speed_limit.tobytes() == b.speed_limit.tobytes()


def test_unknown_profile_is_refused_with_the_valid_names(robot):
    with pytest.raises(ConfigError, match=r"did you mean 'kang2022'"):
        Monitor(robot, profile="kang2020")


def test_validity_is_the_greater_of_20_ms_and_three_periods():
    assert default_valid_for(0.002) == 0.020
    assert math.isclose(default_valid_for(0.02), 0.06)

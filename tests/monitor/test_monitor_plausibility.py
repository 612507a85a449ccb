"""Inputs that cannot be true: by closed forms, and by motions that can be."""

import math
from functools import cache

import numpy as np
import pytest

from ssm_service.config import RobotConfig, load_robot_config
from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import Inputs, JointSample, Monitor, Received, Target
from ssm_service.monitor.plausibility import FROZEN, JOINTS, MISSING, Plausibility
from ssm_service.safety import Zone

PERIOD = 0.01
REST = np.array([0.0, -1.2, 1.2, 0.0, 0.0, 0.0])
ALL = {"joints", "ranges", "obstacles", "target"}


@cache
def robot_with(**keys):
    """The UR3 with a ``plausibility`` of its own."""
    config = load_robot_config("ur3")
    file = config.file
    plausibility = type(file.plausibility)(**keys)
    changed = type(file)(
        **{name: getattr(file, name) for name in file.__struct_fields__} | {"plausibility": plausibility}
    )
    return Robot(RobotConfig(name=config.name, path=config.path, file=changed))


def joints(position, velocity=None):
    return JointSample(position=np.array(position), velocity=np.zeros(6) if velocity is None else velocity)


def inputs(*, position=None, age=0.004, ranges=None, obstacles=None, overrun=0.0):
    return Inputs(
        joints=Received() if position is None else Received(value=joints(position), age_s=age),
        ranges=Received() if ranges is None else Received(value=np.array(ranges), age_s=0.01),
        obstacles=Received() if obstacles is None else Received(value=obstacles, age_s=0.01),
        overrun_s=overrun,
    )


def checks(**keys):
    return Plausibility.of(robot_with(**keys), PERIOD, 0.03)


def words(check, *, fresh=ALL, velocity=0.0, robot=None, **what):
    kinematics = None if robot is None else robot.kinematics(REST)
    commanded = np.array([velocity, 0.0, 0.0, 0.0, 0.0, 0.0])
    return check.step(inputs(**what), set(fresh), commanded, kinematics)


def test_nothing_is_looked_at_where_nothing_is_configured():
    assert checks() is None
    assert checks(hold_s=1.0, joint_tolerance_rad=0.1) is None


# Jumps


@pytest.mark.parametrize("factor", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("ticks", [1, 4])
@pytest.mark.parametrize("beyond", [-1e-6, 1e-6])
def test_a_joint_may_move_as_far_as_its_speed_allows_and_no_farther(factor, ticks, beyond):
    robot = robot_with(joint_speed_factor=factor, joint_tolerance_rad=0.01)
    check = Plausibility.of(robot, PERIOD, 0.03)
    assert words(check, position=REST, age=0.004) == ()
    for _ in range(ticks - 1):
        assert words(check, fresh=set()) == ()
    # The ticks between them, and the age of the first.
    farthest = factor * robot.velocity_limit[1] * (ticks * PERIOD + 0.004) + 0.01
    moved = REST + np.array([0.0, farthest + beyond, 0.0, 0.0, 0.0, 0.0])
    assert words(check, position=moved) == ((JOINTS,) if beyond > 0.0 else ())


def test_a_tick_that_came_late_gives_the_joints_its_time():
    robot = robot_with(joint_speed_factor=1.0, joint_tolerance_rad=0.0)
    jump = REST + np.array([robot.velocity_limit[0] * 0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    for overrun, found in ((0.0, (JOINTS,)), (0.1, ())):
        check = Plausibility.of(robot, PERIOD, 0.03)
        words(check, position=REST)
        assert words(check, position=jump, overrun=overrun) == found


def test_the_same_message_is_not_compared_with_itself():
    check = checks(joint_speed_factor=1.0)
    sample = joints(REST)
    for age in (0.004, 0.014, 0.024):
        given = Inputs(joints=Received(value=sample, age_s=age))
        assert check.step(given, ALL, np.zeros(6), None) == ()


def test_a_finding_holds_for_a_while_and_then_passes():
    check = checks(joint_speed_factor=1.0, hold_s=0.1)
    jumped = REST + 0.5
    words(check, position=REST)
    held = [words(check, position=jumped) for _ in range(15)]
    assert held[:10] == [(JOINTS,)] * 10
    assert held[11:] == [()] * 4


# Following the commands


def follow(motion, *, seconds=2.0, window=0.3, delay=0.2, tolerance=0.01, speed=0.2, period=0.7):
    """Tell when a motion, as a function of all commanded positions so far, is found out [s]; or None."""
    robot = robot_with(follow_window_s=window, follow_delay_s=delay, joint_tolerance_rad=tolerance)
    check = Plausibility.of(robot, PERIOD, 0.03)
    commanded, past, velocity = 0.0, [], 0.0
    for tick in range(round(seconds / PERIOD)):
        commanded += velocity * PERIOD
        past.append(commanded)
        position = REST + np.array([motion(past), 0.0, 0.0, 0.0, 0.0, 0.0])
        if words(check, position=position, age=0.0, velocity=velocity):
            return tick * PERIOD
        velocity = speed if math.sin(2.0 * math.pi * tick * PERIOD / period) >= 0.0 else -speed
    return None


def lag(time_constant):
    state = {"x": 0.0}

    def motion(past):
        state["x"] += (past[-1] - state["x"]) * (1.0 - math.exp(-PERIOD / time_constant))
        return state["x"]

    return motion


@pytest.mark.parametrize("ticks", [0, 3, 10, 20])
def test_a_robot_that_is_late_by_less_than_the_delay_follows(ticks):
    assert follow(lambda past: past[max(len(past) - 1 - ticks, 0)]) is None


@pytest.mark.parametrize("time_constant", [0.005, 0.02, 0.05])
def test_a_robot_that_lags_follows(time_constant):
    assert follow(lag(time_constant)) is None


def test_joints_that_stand_still_under_a_command_are_found_out():
    found = follow(lambda past: 0.0, period=100.0)
    # The history must be full: window and delay. Then the least commanded is far above nothing.
    assert found == pytest.approx(0.3 + 0.2, abs=0.03)


def test_joints_that_move_the_other_way_are_found_out():
    assert follow(lambda past: -past[-1], period=100.0) == pytest.approx(0.5, abs=0.03)


def test_joints_that_move_without_a_command_are_found_out():
    found = follow(lambda past: 0.1 * PERIOD * len(past), speed=0.0, tolerance=0.01)
    assert found == pytest.approx(0.5, abs=0.03)


def test_a_locked_joint_is_not_compared_with_commands():
    robot = robot_with(follow_window_s=0.1, follow_delay_s=0.1)
    check = Plausibility.of(robot, PERIOD, 0.03)
    for tick in range(50):
        moved = REST + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1 * tick * PERIOD])
        assert words(check, position=moved) == ()


def test_a_silence_of_the_joints_begins_the_history_anew():
    robot = robot_with(follow_window_s=0.1, follow_delay_s=0.1)
    check = Plausibility.of(robot, PERIOD, 0.03)
    for tick in range(100):
        fresh = ALL if tick % 15 else set()
        moved = REST + np.array([0.5 * tick * PERIOD, 0.0, 0.0, 0.0, 0.0, 0.0])
        assert words(check, position=moved, fresh=fresh) == ()


def test_a_command_counts_no_longer_than_it_is_valid():
    robot = robot_with(follow_window_s=0.1, follow_delay_s=0.1, joint_tolerance_rad=0.01)
    check = Plausibility.of(robot, PERIOD, 0.03)
    position = REST.copy()
    for tick in range(60):
        late = tick == 40
        position[0] += 0.3 * (0.03 if late else PERIOD)  # it stood still for the rest of the second
        assert words(check, position=position, velocity=0.3, overrun=1.0 if late else 0.0) == ()


# Readings


def test_readings_that_never_change_are_frozen():
    robot = robot_with(frozen_scans=5, hold_s=0.0)
    check = Plausibility.of(robot, PERIOD, 0.03)
    rng = np.random.default_rng(1)
    for scans in range(1, 9):
        scan = rng.uniform(0.2, 0.5, 8)
        scan[3] = 0.3
        assert words(check, ranges=scan) == ((FROZEN,) if scans >= 5 else ())


def test_silence_and_the_same_scan_seen_twice_are_not_frozen():
    check = checks(frozen_scans=2)
    given = Received(value=np.full(8, 0.3), age_s=0.01)
    for _ in range(10):
        assert words(check, ranges=np.full(8, math.inf)) == ()
    for _ in range(10):
        assert check.step(Inputs(ranges=given), ALL, np.zeros(6), None) == ()


def test_a_reading_that_changes_begins_the_count_anew():
    check = checks(frozen_scans=3)
    for number in range(12):
        assert words(check, ranges=np.full(8, 0.3 + 0.01 * (number // 2))) == ()


def test_scans_that_are_not_fresh_say_nothing():
    check = checks(frozen_scans=2)
    for _ in range(5):
        assert words(check, ranges=np.full(8, 0.3), fresh={"joints"}) == ()


def before_sensor(robot, index, distance, shape="sphere", size=(0.06,), reach=0.06):
    T = robot.kinematics(REST).transform_sensors_to_base[index]
    place = T[:3, 3] + (distance + reach) * T[:3, 0]
    return (Obstacle(id="thing", shape=shape, size=size, position=tuple(place), velocity=(0.0, 0.0, 0.0)),)


SHAPES = [
    ("sphere", (0.06,), 0.06),
    ("capsule", (0.06, 0.3), 0.06),
    ("cylinder", (0.1, 0.12), 0.06),
    ("cylinder", (0.06, 0.4), 0.06),
    ("box", (0.12, 0.3, 0.2), 0.06),
]


@pytest.mark.parametrize(("shape", "size", "reach"), SHAPES)
@pytest.mark.parametrize("sensor", [0, 4])
def test_a_sensor_must_read_what_is_tracked_before_it(shape, size, reach, sensor):
    robot = robot_with(echo_margin_m=0.1, hold_s=0.0)
    check = Plausibility.of(robot, PERIOD, 0.03)
    obstacles = before_sensor(robot, sensor, 0.3, shape, size, reach)
    for reading, found in ((0.3, ()), (0.399, ()), (0.401, (MISSING,)), (math.inf, (MISSING,)), (0.1, ())):
        scan = np.full(8, math.inf)
        scan[sensor] = reading
        assert words(check, robot=robot, position=REST, ranges=scan, obstacles=obstacles) == found


def test_what_stands_beside_the_axis_or_beyond_the_range_need_not_be_read():
    robot = robot_with(echo_margin_m=0.1)
    check = Plausibility.of(robot, PERIOD, 0.03)
    silence = np.full(8, math.inf)
    beyond = before_sensor(robot, 4, robot.rings[0].range_max - 0.05)
    T = robot.kinematics(REST).transform_sensors_to_base
    between = T[3, :3, 0] + T[4, :3, 0]
    place = T[:, :3, 3].mean(axis=0) + 0.5 * between / np.linalg.norm(between)
    beside = (Obstacle(id="thing", shape="sphere", size=(0.02,), position=tuple(place)),)
    for obstacles in (beyond, beside, ()):
        assert words(check, robot=robot, position=REST, ranges=silence, obstacles=obstacles) == ()


def test_without_joints_or_a_tracker_nothing_is_expected():
    robot = robot_with(echo_margin_m=0.1)
    obstacles = before_sensor(robot, 4, 0.3)
    silence = np.full(8, math.inf)
    check = Plausibility.of(robot, PERIOD, 0.03)
    assert words(check, ranges=silence, obstacles=obstacles) == ()
    only = {"joints", "ranges"}
    assert words(check, robot=robot, position=REST, ranges=silence, obstacles=obstacles, fresh=only) == ()


def test_the_same_scan_and_obstacles_are_looked_at_once():
    robot = robot_with(echo_margin_m=0.1, hold_s=0.0)
    check = Plausibility.of(robot, PERIOD, 0.03)
    given = inputs(position=REST, ranges=np.full(8, math.inf), obstacles=before_sensor(robot, 4, 0.3))
    kinematics = robot.kinematics(REST)
    assert [check.step(given, ALL, np.zeros(6), kinematics) for _ in range(3)] == [(MISSING,)] * 3


# In the monitor


def test_the_monitor_stops_for_it_and_comes_back():
    robot = robot_with(joint_speed_factor=1.0, hold_s=0.05)
    monitor = Monitor(robot, period_s=PERIOD)
    far = np.full(8, 1.0)

    def step(position):
        return monitor.step(
            Inputs(
                joints=Received(value=joints(position), age_s=0.004),
                ranges=Received(value=far, age_s=0.01),
                target=Received(value=Target(kind="joint_velocity", value=np.full(6, 0.1)), age_s=0.0),
            )
        )

    for _ in range(120):
        decision = step(REST)
    assert decision.zone is Zone.GREEN
    decision = step(REST + 0.5)
    assert decision.zone is Zone.STOP
    assert JOINTS in decision.reasons
    assert not decision.velocity.any()
    for _ in range(120):
        decision = step(REST + 0.5)
    assert decision.zone is Zone.GREEN
    assert decision.velocity.any()

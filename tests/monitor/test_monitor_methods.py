"""Every method through the real monitor: it arrives, it retreats, it never jumps."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from ssm_service.errors import InputError
from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.monitor import (
    Decision,
    EvaluationInput,
    Inputs,
    JointSample,
    Monitor,
    Received,
    Target,
    checked_target,
)
from ssm_service.monitor.commander import Commander
from ssm_service.perception import OwnLinks, scan

ROBOTS = Path(__file__).parents[2] / "robots"
DT = 0.004
METHODS = ("field", "clik-1", "clik-2", "clik-3", "filter")
SCAN = 40  # ticks to a scan
SEEING = 0  # the sensor before which a ball is
FOLDED = np.array([1.18, -0.7, -2.29, 1.39, 0.16, -1.19])
START = np.array([0.3, -1.3, 1.4, -0.6, -1.2, 0.4])


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Robot:
    """The UR3 with six free joints and a tracker instead of rings."""
    return free_arm(tmp_path_factory.mktemp("robots") / "arm.toml", "# Terabee")


@pytest.fixture(scope="module")
def ringed(tmp_path_factory) -> Robot:
    """The same with a tracker and the ring."""
    return free_arm(tmp_path_factory.mktemp("robots") / "ringed.toml", "# The paper's scene")


def free_arm(file: Path, until: str) -> Robot:
    """Return the UR3 with six free joints and with what its file says up to some words."""
    text = (ROBOTS / "ur3.toml").read_text()
    top, _, rest = text.partition("[joints.locked]")
    hulls = rest[rest.index("[hull_pieces]") : rest.index(until)]
    own = """
[limits]
acceleration_rad_s2 = 4.0
[sources]
joints = { required = true, timeout_s = 0.1 }
ranges = { required = false, timeout_s = 0.4 }
obstacles = { required = true, timeout_s = 0.25 }
target = { required = false, timeout_s = 0.5 }
[motion]
speed_m_s = 0.25
[profiles.kang2022]
uncovered = "off"
recovery_ticks = 20
red = { distance_m = 0.01, joint_speed_rad_s = 2.5, speed_scaling = 0.25 }
yellow = { distance_m = 0.02, joint_speed_rad_s = 3.0, speed_scaling = 0.5 }
"""
    top = top.replace('"wrist_1_joint"     #', '"ee_link"           #')
    file.write_text(top + hulls + own)
    return Robot.load(file)


class Run:
    """An arm that obeys at once, and a monitor that commands it."""

    def __init__(self, robot: Robot, position=START, obstacles: tuple[Obstacle, ...] = (), dt=DT) -> None:
        self.monitor, self.dt = Monitor(robot, period_s=dt), dt
        self.position = np.array(position, dtype=np.float64)
        self.velocity = np.zeros(6)
        self.obstacles = obstacles
        self.decision = None
        self.robot, self.own = robot, OwnLinks(robot) if robot.rings else None
        self.scanned = Received()
        self.ticks = 0

    def tick(self, target: Target | None) -> np.ndarray:
        """Let one period pass; return the command."""
        sample = JointSample(position=self.position.copy(), velocity=self.velocity)
        inputs = Inputs(
            joints=Received(value=sample, age_s=0.0),
            obstacles=Received(value=self.obstacles, age_s=0.0),
            ranges=self.scan(),
            target=Received(value=target, age_s=None if target is None else 0.0),
        )
        self.ticks += 1
        self.decision = self.monitor.step(inputs)
        self.velocity = self.decision.velocity
        self.position = self.position + self.velocity * self.dt
        return self.velocity

    def scan(self) -> Received:
        """Return what the ring saw last, of obstacles and of the arm itself; nothing without a ring."""
        if self.own is not None and self.ticks % SCAN == 0:
            (ring,) = self.robot.rings
            transforms = self.robot.kinematics(self.position).transform_sensors_to_base
            seen = scan(self.obstacles, transforms, ring.half_angle, ring.range_max, ring.range_min)
            seen = np.minimum(seen, self.own.readings(self.position))
            self.scanned = Received(value=seen, age_s=0.0)
        return self.scanned

    def settle(self) -> None:
        """Let the zone recover from the start."""
        for _ in range(25):
            self.tick(None)


def end(robot: Robot, position) -> np.ndarray:
    return robot.kinematics(position).transform_end_effector_to_base


def pose_of(robot: Robot, position) -> list[float]:
    from scipy.spatial.transform import Rotation

    T = end(robot, position)
    return [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()]


@pytest.mark.parametrize("method", METHODS)
def test_a_pose_is_reached_and_held(arm, method):
    goal = START + np.array([0.3, 0.2, -0.2, 0.3, 0.2, -0.4])
    target = checked_target(arm, "pose", pose_of(arm, goal), method)
    run = Run(arm)
    run.settle()
    for _ in range(1500):
        run.tick(target)
    here, there = end(arm, run.position), end(arm, goal)
    assert np.linalg.norm(here[:3, 3] - there[:3, 3]) < 2e-3
    assert math.acos(min(1.0, (np.trace(here[:3, :3].T @ there[:3, :3]) - 1.0) / 2.0)) < 5e-3


@pytest.mark.parametrize("method", ["clik-1", "clik-2", "clik-3"])
def test_a_position_is_reached_without_turning_under_clik(arm, method):
    goal = end(arm, START)[:3, 3] + [0.05, -0.1, 0.08]
    run = Run(arm)
    run.settle()
    for _ in range(700):
        run.tick(checked_target(arm, "position", goal.tolist(), method))
    here = end(arm, run.position)
    assert np.linalg.norm(here[:3, 3] - goal) < 2e-3
    np.testing.assert_allclose(here[:3, :3], end(arm, START)[:3, :3], atol=2e-3)


def changed_over(robot: Robot, obstacles: tuple[Obstacle, ...], first: str, second: str) -> Run:
    """Change from one method to another in full motion, with another goal; the command must not jump."""
    here = end(robot, START)[:3, 3]
    run = Run(robot, obstacles=obstacles)
    run.settle()
    before = np.zeros(6)
    greatest = robot.config.file.limits.acceleration_rad_s2 * DT
    targets = [
        checked_target(robot, "position", (here + np.array([0.15, 0.0, 0.05])).tolist(), first),
        checked_target(robot, "position", (here + np.array([-0.1, 0.15, 0.0])).tolist(), second),
    ]
    changes, moved = [], []
    for tick in range(85):
        velocity = run.tick(targets[tick >= 60])
        changes.append(np.abs(velocity - before).max())
        moved.append(np.abs(velocity).max())
        before = velocity
    assert max(changes[60:]) <= greatest * (1 + 1e-9)
    assert moved[59] > 10 * greatest
    return run


def ball_at(place: np.ndarray) -> Obstacle:
    return Obstacle(id="ball", shape="sphere", size=(0.05,), position=tuple(place.tolist()))


@pytest.mark.parametrize(("first", "second"), list(itertools.permutations(METHODS, 2)))
def test_a_changeover_makes_no_command_jump(arm, first, second):
    changed_over(arm, (ball_at(end(arm, START)[:3, 3] + [0.1, 0.05, 0.14]),), first, second)


@pytest.mark.parametrize(
    ("first", "second"), [pair for name in METHODS for pair in ((name, "field3d"), ("field3d", name))]
)
def test_a_changeover_from_and_to_the_rings_field_makes_no_command_jump(ringed, first, second):
    sensor = ringed.kinematics(START).transform_sensors_to_base[SEEING]
    ball = ball_at(sensor[:3, 3] + 0.25 * sensor[:3, 0])
    run = changed_over(ringed, (ball,), first, second)
    others = run.monitor.range_reader._prepared.masked.ranges
    assert others.min() < ringed.config.file.motion.influence_distance_m


def folded_inputs(robot: Robot, ranges: np.ndarray, target: Target, *, tracked: bool) -> Inputs:
    return Inputs(
        joints=Received(value=JointSample(position=FOLDED, velocity=np.zeros(6)), age_s=0.0),
        obstacles=Received(value=(), age_s=0.0) if tracked else Received(),
        ranges=Received(value=ranges, age_s=0.0),
        target=Received(value=target, age_s=0.0),
    )


@pytest.fixture(scope="module")
def own_echoes() -> tuple[Robot, np.ndarray, Target]:
    """The shipped UR3 where its ring sees its own links near, what it reads, and a goal in reach."""
    robot = Robot.load("ur3")
    readings = OwnLinks(robot).readings(FOLDED)
    assert readings.min() < 0.7 * robot.config.file.motion.influence_distance_m
    goal = end(robot, FOLDED)[:3, 3] + [0.05, -0.05, 0.05]
    return robot, readings, checked_target(robot, "position", goal.tolist(), "field3d")


def commands(own_echoes, ranges: np.ndarray, *, tracked: bool) -> tuple[np.ndarray, Decision]:
    """Return what the monitor commands while joints and scan stay as they are, (150, n), and its last say."""
    robot, _, target = own_echoes
    monitor = Monitor(robot)
    decisions = [monitor.step(folded_inputs(robot, ranges, target, tracked=tracked)) for _ in range(150)]
    return np.array([decision.velocity for decision in decisions]), decisions[-1]


def test_the_rings_field_is_not_repelled_by_the_arms_own_links(own_echoes):
    readings = own_echoes[1]
    alone, _ = commands(own_echoes, readings, tracked=True)
    silent, _ = commands(own_echoes, np.full(8, math.inf), tracked=True)
    assert np.abs(silent[-1]).max() > 0.05
    np.testing.assert_array_equal(alone, silent)
    # an obstacle where no own link is seen
    other, _ = commands(own_echoes, np.where(np.isinf(readings), 0.15, readings), tracked=True)
    assert np.abs(other[-1] - silent[-1]).max() > 0.02


def test_own_links_do_not_repel_where_they_count_for_the_zone_either(own_echoes):
    readings = own_echoes[1]
    alone, decision = commands(own_echoes, readings, tracked=False)
    silent, free = commands(own_echoes, np.full(8, math.inf), tracked=False)
    assert decision.zone > free.zone  # nobody answers for what the own link hides
    assert decision.distance == pytest.approx(readings.min())
    directions = [v[-1] / np.linalg.norm(v[-1]) for v in (alone, silent)]
    np.testing.assert_allclose(directions[0], directions[1], atol=1e-9)


@pytest.mark.parametrize("tracked", [True, False])
def test_for_motion_the_rings_see_what_is_no_own_link(own_echoes, monkeypatch, tracked):
    readings = own_echoes[1]
    found, seen, step = [], [], Commander.step

    def watched(self, snapshot, keeping, distances, *, settled=False):
        seen.append(snapshot)
        return step(self, snapshot, keeping, distances, settled=settled)

    monkeypatch.setattr(Commander, "step", watched)
    another = np.where(np.isinf(readings), 0.3, readings)
    for ranges in (readings, another):
        seen.clear()
        _, decision = commands(own_echoes, ranges, tracked=tracked)
        found.append(seen[-1])
        assert (decision.distance == readings.min()) == (not tracked)
    own, ball = found
    assert own.echo is None
    assert ball.echo.distance == pytest.approx(0.3)
    assert np.isinf(own.ranges).all()


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)])
def test_an_arm_at_rest_retreats_from_what_comes(arm, direction):
    """Within the limits: at 0.1 m/s the arm can give way, so it is never touched."""
    away = np.array(direction)
    run = Run(arm)
    hand = end(arm, START)[:3, 3]
    distances, least = DistanceModel(arm), math.inf
    stay = checked_target(arm, "joint_velocity", [0.0] * 6, "filter")
    for tick in range(900):
        centre = hand + away * (0.25 - 0.1 * tick * DT)
        ball = Obstacle(
            id="ball", shape="sphere", size=(0.04,), position=tuple(centre), velocity=tuple(-0.1 * away)
        )
        run.obstacles = (ball,)
        run.tick(stay)
        distances.set_obstacles(run.obstacles)
        least = min(least, distances.nearest(run.position).distance)
    assert least > 0.0
    assert np.abs(run.position - START).max() > 0.02
    assert (run.position > arm.position_lower).all()


def test_no_method_drives_through_a_joint_limit(arm):
    margin = arm.config.file.limits.position_margin_rad
    for method, sign in itertools.product(METHODS, (-1.0, 1.0)):
        near = np.clip(START + sign * 10.0, arm.position_lower + 0.1, arm.position_upper - 0.1)
        run = Run(arm, near)
        for _ in range(400):
            run.tick(checked_target(arm, "joint_velocity", [sign * 2.0] * 6, method))
        assert (run.position <= arm.position_upper - margin + 1e-12).all()
        assert (run.position >= arm.position_lower + margin - 1e-12).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_singularity_makes_no_command_jump(arm, method):
    """The stretched arm is driven outward through the end of its reach: half the tick, half the change."""
    changes = []
    for dt in (DT, DT / 4.0):
        run = Run(arm, np.array([0.2, -1.0, 0.25, -1.2, -1.0, 0.3]), dt=dt)
        run.settle()
        outward = end(arm, run.position)[:3, 3]
        twist = checked_target(
            arm, "twist", [*(0.1 * outward / np.linalg.norm(outward)), 0.0, 0.0, 0.0], method
        )
        found = np.array([run.tick(twist) for _ in range(round(0.6 / dt))])
        assert np.abs(found[-1]).max() < 0.5 * np.abs(found).max()
        changes.append(np.abs(np.diff(found, axis=0)).max())
    assert changes[1] < 0.3 * changes[0]


def test_the_targets_method_goes_before_the_files(arm):
    ball = Obstacle(
        id="ball", shape="sphere", size=(0.05,), position=tuple(end(arm, START)[:3, 3] + [0.0, 0.12, 0.16])
    )
    goal = (end(arm, START)[:3, 3] + [0.1, 0.1, 0.2]).tolist()
    found = []
    for method in (None, "field", "filter"):
        run = Run(arm, obstacles=(ball,))
        run.settle()
        for _ in range(30):
            run.tick(checked_target(arm, "position", goal, method))
        found.append(run.velocity)
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[0] - found[2]).max() > 1e-3


@pytest.mark.parametrize(
    ("kind", "value", "controller", "cause"),
    [
        ("pose", [0.2, 0.1, 0.3, 0.0, 0.0, 0.0, 1.0], None, "unsupported_kind"),
        ("position", [0.2, 0.1, 0.3], "clik-2", "unsupported_controller"),
        ("position", [0.2, 0.1, 0.3], "clik-3", "unsupported_controller"),
    ],
)
def test_three_joints_cannot_hold_an_orientation(robot, kind, value, controller, cause):
    with pytest.raises(InputError) as error:
        checked_target(robot, kind, value, controller)
    assert error.value.cause == cause


def test_without_rings_there_is_no_field3d(arm):
    with pytest.raises(InputError, match="ring"):
        checked_target(arm, "position", [0.2, 0.1, 0.3], "field3d")


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.01)])
def test_a_quaternion_must_have_unit_length(arm, quaternion):
    with pytest.raises(InputError, match="unit quaternion"):
        checked_target(arm, "pose", [0.2, 0.1, 0.3, *quaternion])


def test_a_kind_that_nobody_knows_is_refused(arm):
    with pytest.raises(InputError, match="joint_velocity"):
        checked_target(arm, "speed", [0.0] * 6)


@pytest.mark.parametrize("tracked", [False, True])
def test_the_filter_keeps_clear_of_what_the_ring_sees(robot, scene, sphere, tracked):
    """A joint velocity that closes in on an echo at the margin is taken away; the opposite one stays."""
    monitor = Monitor(robot, period_s=DT)
    scene.ranges = np.array([0.026, *[np.inf] * 7])
    scene.obstacles = (sphere(1.5),) if tracked else None
    found = {}
    for sign in (-1.0, 1.0):
        scene.target = checked_target(
            robot, "joint_velocity", [0.0, sign * 0.1, 0.0, 0.0, 0.0, 0.0], "filter"
        )
        for _ in range(120):
            decision = monitor.step(scene.inputs())
        found[sign] = decision.velocity
        nearest = decision.nearest
        assert nearest.source == "ranges"
        velocity = robot.point_velocity(
            scene.position, decision.velocity, nearest.link, nearest.point_on_link
        )
        bound = max(robot.config.file.motion.filter.approach_gain * (nearest.distance - 0.03), 0.0)
        assert -float(nearest.normal @ velocity) <= bound + 2e-6
    assert np.abs(found[1.0] + found[-1.0]).max() > 0.01


@pytest.mark.parametrize("method", ["clik-1", "filter"])
def test_evaluate_says_what_the_monitor_comes_to(arm, method):
    hand = end(arm, START)[:3, 3]
    ball = Obstacle(
        id="ball", shape="sphere", size=(0.05,), position=tuple(hand + np.array([0.05, 0.1, 0.05]))
    )
    target = checked_target(arm, "joint_velocity", [0.8, 0.3, -0.2, 0.1, 0.5, 0.2], method)
    run = Run(arm, obstacles=(ball,))
    run.settle()
    for _ in range(300):
        run.position = START.copy()
        run.tick(target)
    said = run.monitor.evaluate(
        EvaluationInput(
            joints=JointSample(position=START, velocity=np.zeros(6)), obstacles=(ball,), target=target
        )
    )
    assert np.abs(said.velocity).max() > 0.01
    np.testing.assert_allclose(said.velocity, run.velocity, atol=1e-6)


@pytest.mark.parametrize("known", [False, True])
def test_the_radius_of_a_slow_obstacle_is_the_lesser_one(arm, known):
    """At 0.17 m only an obstacle whose speed is not known, or high, repels."""
    rest = np.array(START)
    distances = DistanceModel(arm)
    centre = end(arm, rest)[:3, 3] + np.array([0.0, 0.0, 0.5])
    for _ in range(60):
        far = Obstacle(id="far", shape="sphere", size=(0.05,), position=(2.0, 2.0, 2.0))
        ball = Obstacle(
            id="ball",
            shape="sphere",
            size=(0.05,),
            position=tuple(centre),
            velocity=(0.0, 0.0, 0.0) if known else None,
        )
        distances.set_obstacles((ball,))
        pair = distances.nearest(rest)
        centre = centre + pair.normal * (pair.distance - 0.17)
    run = Run(arm, rest, obstacles=(far, ball))
    run.settle()
    for _ in range(60):
        run.position = rest.copy()
        run.tick(checked_target(arm, "joint_velocity", [0.0] * 6, "clik-1"))
    assert run.decision.distance == pytest.approx(0.17, abs=1e-3)
    assert (np.abs(run.velocity).max() > 1e-3) == (not known)

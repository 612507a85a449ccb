"""The profile ``iso`` in the monitor and in ``evaluate``: limits, commands, reaction time, recovery."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from ssm_service.config import robots_directory
from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.monitor import (
    Decision,
    EvaluationInput,
    Evaluator,
    Inputs,
    JointSample,
    Monitor,
    Received,
    Separated,
    Target,
    configured_reaction,
    standstill_distance,
    stopping_levels,
    zone_profile,
)
from ssm_service.monitor.separation import MOST_EXACT
from ssm_service.safety import SeparationLaw, Zone

POSE = np.array([0.4, -1.1, 1.0, 0.0, 0.0, 0.0])
TICKS = 100  # of recovery, in the shipped files


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.load("ur3")


KEEN = (
    ("recovery_ticks = 100\n\n[profiles.iso", "recovery_ticks = 1\n\n[profiles.iso"),
    ("acceleration_rad_s2 = 4.0", "acceleration_rad_s2 = 1000.0"),
)
"""Neither recovery nor acceleration hides what one tick alone would do."""


@pytest.fixture(scope="module")
def shipped(robot: Robot) -> Monitor:
    """Return a monitor that several tests step; it takes a second to build."""
    return Monitor(robot, profile="iso")


@pytest.fixture(scope="module")
def iso(keen: Robot) -> Monitor:
    return Monitor(keen, profile="iso")


@pytest.fixture(scope="module")
def keen(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return changed(tmp_path_factory.mktemp("keen"))


def changed(tmp_path: Path, *pairs: tuple[str, str]) -> Robot:
    """Return the shipped UR3 with some of its text replaced."""
    text = (robots_directory() / "ur3.toml").read_text()
    for old, new in (*KEEN, *pairs):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = tmp_path / "ur3.toml"
    path.write_text(text)
    return Robot.load(path)


def ball(x: float, y: float = 0.0, z: float = 0.4, **more: object) -> Obstacle:
    return Obstacle(id="ball", shape="sphere", size=(0.05,), position=(x, y, z), **more)  # type: ignore[arg-type]


def snapshot(
    obstacles: tuple[Obstacle, ...] | None = (),
    *,
    position: np.ndarray = POSE,
    velocity: np.ndarray | None = None,
    ranges: np.ndarray | None = None,
    wanted: np.ndarray | None = None,
    age: float = 0.01,
    **more: object,
) -> Inputs:
    joints = JointSample(position=position, velocity=np.zeros(6) if velocity is None else velocity)
    scan = np.full(8, np.inf) if ranges is None else ranges
    return Inputs(
        joints=Received(value=joints, age_s=0.001),
        ranges=Received(value=scan, age_s=age),
        obstacles=Received() if obstacles is None else Received(value=obstacles, age_s=age),
        target=Received()
        if wanted is None
        else Received(value=Target(kind="joint_velocity", value=wanted), age_s=0.01),
        **more,  # type: ignore[arg-type]
    )


def settled(monitor: Monitor, inputs: Inputs, ticks: int = 4) -> Decision:
    """Return the decision after some ticks; few are enough for an arm that recovers and speeds up at once."""
    for _ in range(ticks):
        decision = monitor.step(inputs)
    return decision


def separated(decision: Decision) -> Separated:
    assert decision.separation is not None
    return decision.separation


def worst_terms(found: Separated, robot: Robot, velocity: np.ndarray) -> np.ndarray:
    """Return distance less S_p of each pair at a joint velocity, by the scalar law."""
    levels, spare = stopping_levels(robot), []
    speeds = found.limit.closing.at(velocity)
    share = float(np.abs(velocity[robot.free] / robot.velocity_limit[robot.free]).max())
    level = levels.level_at(share)
    for pair in range(len(found)):
        law = SeparationLaw(
            human_speed=float(found.table.human_speed[pair]),
            reaction_time=found.reactions[found.source(pair)].total,
            stopping_time=float(levels.times[level]),
            stopping_gain=float(levels.gains[level]),
            intrusion=found.intrusion,
            human_uncertainty=float(found.table.uncertainty[pair]),
            robot_uncertainty=found.robot_uncertainty,
        )
        spare.append(float(found.table.distance[pair]) - law.terms(float(speeds[pair])).S_p)
    return np.array(spare)


def test_zones_come_with_the_distance(keen: Robot, iso: Monitor) -> None:
    zones, scalings = [], []
    for x in (2.5, 1.2, 1.0, 0.95, 0.9, 0.7, 0.5):
        decision = settled(iso, snapshot((ball(x),)))
        zones.append(decision.zone)
        scalings.append(decision.speed_scaling)
        if decision.zone is Zone.STOP:
            assert not decision.speed_limit.any()
        else:
            assert decision.speed_limit == pytest.approx(decision.speed_scaling * keen.velocity_limit)
        assert ("separation" in decision.reasons) == (decision.zone is not Zone.GREEN)
    assert zones == sorted(zones)
    assert scalings == sorted(scalings, reverse=True)
    assert (zones[0], zones[-1]) == (Zone.GREEN, Zone.STOP)
    assert {Zone.YELLOW, Zone.RED} & set(zones)


def test_the_box_of_speed_limits_keeps_every_pair_admissible(keen: Robot, iso: Monitor) -> None:
    random, tried = np.random.default_rng(1), 0
    for _ in range(25):
        things = tuple(
            replace_id(ball(*random.uniform((-1.2, -1.2, 0.0), (1.2, 1.2, 1.2))), str(k)) for k in range(3)
        )
        decision = settled(
            iso,
            snapshot(things, position=POSE + random.uniform(-0.5, 0.5, 6)),
        )
        if decision.zone is Zone.STOP:
            continue
        tried += 1
        for _ in range(10):
            velocity = np.zeros(6)
            velocity[keen.free] = random.uniform(-1.0, 1.0, 3) * decision.speed_limit[keen.free]
            assert (worst_terms(separated(decision), keen, velocity) >= -1e-9).all()
    assert tried > 5


def replace_id(obstacle: Obstacle, name: str) -> Obstacle:
    return Obstacle(
        id=name,
        shape=obstacle.shape,
        size=obstacle.size,
        position=obstacle.position,
        velocity=obstacle.velocity,
    )


def test_the_command_is_the_greatest_admissible_scaling(keen: Robot, iso: Monitor) -> None:
    random, limited, free = np.random.default_rng(2), 0, 0
    for _ in range(150):
        wanted = np.zeros(6)
        wanted[keen.free] = random.uniform(-1.0, 1.0, 3) * keen.velocity_limit[keen.free]
        place = ball(*random.uniform((0.7, -0.4, 0.1), (0.95, 0.6, 0.7)))
        decision = settled(iso, snapshot((place,), wanted=wanted))
        if decision.zone is Zone.STOP:
            assert not decision.velocity.any()
            continue
        found = separated(decision)
        assert (worst_terms(found, keen, decision.velocity) >= -1e-9).all()
        scaling = float(decision.velocity @ wanted / (wanted @ wanted))
        assert decision.velocity == pytest.approx(scaling * wanted)
        if not (found.limit.closing.at(wanted) > 0.0).any():
            free += 1
            assert scaling == 1.0
        elif scaling < 1.0 - 1e-9:
            limited += 1
            assert (worst_terms(found, keen, 1.001 * decision.velocity) < 0.0).any()
    assert limited > 5


def test_retreat_may_be_faster_than_any_other_direction(keen: Robot, iso: Monitor) -> None:
    thing = (ball(0.835, 0.315),)
    first = settled(iso, snapshot(thing))
    assert first.zone in (Zone.YELLOW, Zone.RED)
    found = separated(first)
    assert found.limiting is not None
    towards = np.zeros(6)
    towards[keen.free] = np.sign(found.table.closing.gradients[found.limiting])[keen.free]
    assert (found.table.closing.at(-towards) <= 0.0).all()
    towards *= 0.95 * keen.velocity_limit.min()
    away = settled(iso, snapshot(thing, wanted=-towards))
    there = settled(iso, snapshot(thing, wanted=towards))
    assert away.velocity == pytest.approx(-towards)
    assert np.abs(away.velocity).max() > 1.5 * away.speed_limit[0]
    assert np.abs(there.velocity).max() < 0.9 * np.abs(away.velocity).max()


def test_a_pair_without_any_speed_is_a_protective_stop(iso: Monitor) -> None:
    monitor = iso
    settled(monitor, snapshot(()))
    decision = monitor.step(snapshot((ball(0.6),), wanted=np.ones(6)))
    assert decision.distance is not None
    assert decision.distance > 0.0
    assert (decision.zone, decision.reasons) == (Zone.STOP, ("separation",))
    found = separated(decision)
    assert found.limiting is not None
    assert found.max_closing_speed[found.limiting] == 0.0
    assert not decision.velocity.any()


def test_contact_stays_contact(robot: Robot, shipped: Monitor) -> None:
    tip = robot.kinematics(POSE).transform_end_effector_to_base[:3, 3]
    decision = shipped.step(snapshot((ball(*tip),)))
    assert decision.zone is Zone.STOP
    assert {"contact", "separation"} <= set(decision.reasons)
    assert (separated(decision).table.distance <= 0.0).any()


def test_terms_of_the_reaction_time_by_source(robot: Robot, shipped: Monitor) -> None:
    scan = np.full(8, np.inf)
    scan[0] = 1.1
    inputs = snapshot((ball(1.2),), ranges=scan, age=0.02, tick_s=0.005, transport_s=0.03)
    inputs = replace(inputs, obstacles=replace(inputs.obstacles, period_s=0.05))
    decision = shipped.step(inputs)
    reactions = separated(decision).reactions
    shared = {"tick": 0.005, "transport": 0.03, "robot": 0.016, "input_age": 0.02}
    for source, period in (("ranges", 0.16), ("obstacles", 0.05)):
        terms = reactions[source].terms()
        total = terms.pop("total")
        assert terms == {**shared, "sensor_period": period}
        assert total == pytest.approx(sum(terms.values()))
    old_joints = replace(inputs, joints=replace(inputs.joints, age_s=0.09))
    decision = shipped.step(old_joints)
    assert separated(decision).reactions["ranges"].input_age == 0.09


def test_what_is_measured_only_lengthens_what_is_configured(robot: Robot) -> None:
    inputs = snapshot((ball(1.2),), tick_s=0.0001, transport_s=0.001)
    inputs = replace(inputs, obstacles=replace(inputs.obstacles, period_s=0.001))
    terms = separated(Monitor(robot, profile="iso", period_s=0.004).step(inputs)).reactions["obstacles"]
    assert (terms.sensor_period, terms.tick, terms.transport) == (0.033, 0.004, 0.02)


@pytest.mark.parametrize("cause", ["transport_s", "tick_s", "age", "period_s"])
def test_a_longer_reaction_is_a_longer_separation_in_the_next_tick(shipped: Monitor, cause: str) -> None:
    monitor = shipped
    before = monitor.step(snapshot((ball(1.0),)))
    if cause == "period_s":
        inputs = snapshot((ball(1.0),))
        inputs = replace(inputs, obstacles=replace(inputs.obstacles, period_s=0.2))
    else:
        inputs = snapshot((ball(1.0),), **{cause: 0.2})
    after = monitor.step(inputs)
    for pair in range(len(separated(before))):
        assert separated(after).terms(pair).S_p > separated(before).terms(pair).S_p + 0.2
    assert (separated(after).max_closing_speed <= separated(before).max_closing_speed).all()
    assert separated(after).scaling < separated(before).scaling


def test_the_persons_speed(tmp_path: Path, shipped: Monitor) -> None:
    tracked = changed(tmp_path, ("tracked_velocity = false", "tracked_velocity = true "))
    cases = {
        None: 1.6,
        (0.0, 0.0, 0.0): 0.25,
        (0.1, 0.0, 0.0): 0.25,
        (0.3, -0.4, 0.0): 0.5,
        (0.0, 0.0, 2.5): 2.5,
    }
    for monitor, trusted in ((Monitor(tracked, profile="iso"), True), (shipped, False)):
        for velocity, expected in cases.items():
            found = separated(monitor.step(snapshot((ball(1.0, velocity=velocity),))))
            assert set(found.table.human_speed.tolist()) == {expected if trusted else 1.6}


def test_measured_speeds_are_directed_and_terms_follow_them(robot: Robot, shipped: Monitor) -> None:
    velocity = np.array([0.5, 0.1, -0.3, 0.2, 0.0, 0.1])
    found = separated(shipped.step(snapshot((ball(0.9, 0.3),), velocity=velocity)))
    for pair in range(len(found)):
        point = found.table.point_on_link[pair]
        moving = robot.point_velocity(POSE, velocity, found.link(pair), point)
        assert found.closing_speed[pair] == pytest.approx(-found.table.normal[pair] @ moving, abs=1e-12)
        terms, towards = found.terms(pair), max(float(found.closing_speed[pair]), 0.0)
        reaction = found.reactions["obstacles"].total
        assert terms.S_r == pytest.approx(towards * reaction)
        assert terms.S_s == pytest.approx(towards * 0.20 / 3.194)
        assert terms.S_h == pytest.approx(1.6 * (reaction + 0.159))
        assert found.obstacle(pair) == "ball"
    assert found.stopping_time == 0.159


def test_an_echo_is_a_pair_in_the_direction_of_its_sensor(robot: Robot, shipped: Monitor) -> None:
    scan = np.full(8, np.inf)
    scan[2], scan[5] = 0.9, 1.1
    velocity = np.array([0.5, 0.1, -0.3, 0.0, 0.0, 0.0])
    found = separated(shipped.step(snapshot((), ranges=scan, velocity=velocity)))
    kinematics = robot.kinematics(POSE)
    assert len(found) == 2
    for pair, sensor in enumerate((2, 5)):
        T = kinematics.transform_sensor_to_base(sensor)
        assert (found.source(pair), found.link(pair), found.obstacle(pair)) == (
            "ranges",
            "forearm_link",
            None,
        )
        assert found.table.distance[pair] == scan[sensor]
        assert found.table.normal[pair] == pytest.approx(-T[:3, 0])
        assert found.table.point_on_obstacle[pair] == pytest.approx(T[:3, 3] + scan[sensor] * T[:3, 0])
        moving = robot.point_velocity(POSE, velocity, "forearm_link", T[:3, 3])
        assert found.closing_speed[pair] == pytest.approx(T[:3, 0] @ moving)
        assert found.terms(pair).Z_d == 0.06  # of the ring, above the tracker's
        assert not found.table.exact[pair]


def test_silence_is_an_obstacle_of_any_direction_where_nobody_else_looks(
    tmp_path: Path, shipped: Monitor
) -> None:
    """With ``uncovered`` off, silence proves as much as the sensors reach; else what they could miss."""
    off = changed(tmp_path, ('uncovered = "stop"', 'uncovered = "off"'))
    monitor, velocity = Monitor(off, profile="iso"), np.array([0.5, 0.1, -0.3, 0.0, 0.0, 0.0])
    alone = separated(monitor.step(snapshot(None, velocity=velocity)))
    assert len(alone) == 1
    assert alone.table.distance.tolist() == [1.2]
    assert alone.source(0) == "ranges"
    random = np.random.default_rng(3)
    T = off.link_transforms(POSE)["forearm_link"]
    mesh = off.collision.geometryObjects[off.geometry_of_link["forearm_link"][0]]
    points = np.array(mesh.geometry.vertices())[random.integers(0, 400, 60)]
    speeds = [
        np.linalg.norm(off.point_velocity(POSE, velocity, "forearm_link", T[:3, :3] @ p + T[:3, 3]))
        for p in points
    ]
    assert max(speeds) <= alone.closing_speed[0] <= 1.3 * max(speeds)
    retreat = separated(monitor.step(snapshot(None, velocity=-velocity)))
    assert retreat.closing_speed[0] == pytest.approx(alone.closing_speed[0])  # no direction is a retreat
    blind = shipped.step(snapshot(None))
    assert separated(blind).table.distance.tolist() == [0.0]
    assert (blind.zone, "uncovered" in blind.reasons) == (Zone.STOP, True)


def test_an_echo_never_loosens_what_silence_leaves(tmp_path: Path) -> None:
    robot = changed(tmp_path, ('uncovered = "stop"', 'uncovered = "off"'))
    monitor, scan = Monitor(robot, profile="iso"), np.full(8, np.inf)
    wanted = np.array([1.0, 0.5, -0.5, 0.0, 0.0, 0.0])
    silent = settled(monitor, snapshot(None, ranges=scan, wanted=wanted))
    for sensor in range(8):
        echo = scan.copy()
        echo[sensor] = 1.1
        seen = settled(monitor, snapshot(None, ranges=echo, wanted=wanted))
        assert seen.speed_scaling <= silent.speed_scaling
        assert np.abs(seen.velocity).max() <= np.abs(silent.velocity).max() + 1e-12
        assert (worst_terms(separated(seen), robot, seen.velocity) >= -1e-9).all()


def test_the_lower_bound_is_an_obstacle_of_any_direction(tmp_path: Path) -> None:
    robot = changed(
        tmp_path,
        ('uncovered = "stop"', 'uncovered = "off"\nrange_estimator = "lower_bound"'),
    )
    monitor = Monitor(robot, profile="iso")
    scan = np.full(8, np.inf)
    beside = monitor.step(snapshot((), ranges=scan))
    assert len(separated(beside)) == 0  # a tracker looks where the ring is silent
    alone = separated(monitor.step(snapshot(None, ranges=scan.copy())))
    assert alone.table.distance == pytest.approx([0.0])
    echo = scan.copy()
    echo[1] = 0.8
    found = monitor.step(snapshot((), ranges=echo))
    assert len(separated(found)) == 1
    assert found.distance is not None
    assert separated(found).table.distance[0] == found.distance < 0.8
    assert separated(found).table.closing.undirected.all()
    # Half the sensors at contact and the others far off: no one ball explains that.
    odd = np.array([0.1, 1.0] * 4)
    none = monitor.step(snapshot((), ranges=odd))
    assert "disagree" in none.reasons
    assert len(separated(none)) == 0


def test_exact_distances_where_they_could_limit(robot: Robot, shipped: Monitor) -> None:
    touching = tuple(replace_id(ball(0.55 + 0.01 * k, 0.02 * k, 0.3), str(k)) for k in range(4))
    stopped = separated(shipped.step(snapshot(touching)))
    assert stopped.zone is Zone.STOP
    assert stopped.table.exact.sum() == 1  # no other pair can change a stop
    assert stopped.limiting == stopped.table.exact.argmax()
    near = tuple(replace_id(ball(0.95 + 0.01 * k, 0.02 * k, 0.3), str(k)) for k in range(4))
    found = separated(shipped.step(snapshot(near)))
    assert found.zone not in (Zone.STOP, Zone.GREEN)
    assert found.table.exact.sum() == MOST_EXACT
    assert found.limiting is not None
    assert found.table.exact[found.limiting]
    model = DistanceModel(robot)
    model.set_obstacles(near)
    true = np.array([pair.distance for pair in model.all_pairs(POSE)])
    exact = found.table.exact
    assert found.table.distance[exact] == pytest.approx(true[exact], abs=1e-9)
    assert (found.table.distance <= true + 1e-9).all()
    far = separated(shipped.step(snapshot((ball(4.0),))))
    # Nothing could limit; the nearest pair alone was measured, as every decision tells it.
    assert far.table.exact.nonzero()[0].tolist() == [int(far.table.distance.argmin())]
    assert far.scaling == 1.0


def test_without_anything_near_the_longest_reaction_time_is_said(iso: Monitor) -> None:
    decision = settled(iso, snapshot(()))
    found = separated(decision)
    assert (len(found), found.limiting, found.zone, decision.zone) == (0, None, Zone.GREEN, Zone.GREEN)
    assert found.reaction is found.reactions["ranges"]  # 0.16 s a scan
    nothing = replace(snapshot(None), ranges=Received())
    blind = iso.step(nothing)
    assert separated(blind).reaction is None
    assert blind.zone is Zone.STOP


def test_recovery_holds_the_least_share_and_what_limited_it(shipped: Monitor) -> None:
    wanted, thing = np.zeros(6), (ball(0.835, 0.315),)
    found = separated(shipped.step(snapshot(thing)))
    assert found.limiting is not None
    g = found.table.closing.gradients[found.limiting]
    wanted[:3] = 2.0 * np.sign(g[:3])  # more than the ball allows
    clear, near = snapshot((), wanted=wanted), snapshot(thing, wanted=wanted)
    monitor = shipped
    fast = settled(monitor, clear, 5 * TICKS)
    assert fast.velocity == pytest.approx(wanted)
    slow = monitor.step(near)
    assert slow.zone in (Zone.YELLOW, Zone.RED)
    for _ in range(TICKS - 1):
        held = monitor.step(clear)
        assert (held.zone, held.momentary_zone) == (slow.zone, Zone.GREEN)
        assert held.speed_scaling == slow.speed_scaling
        assert "recovering" in held.reasons
        assert g @ held.velocity <= found.max_closing_speed[found.limiting] + 1e-12
    assert g @ wanted > 1.1 * found.max_closing_speed[found.limiting]
    free = monitor.step(clear)
    assert (free.zone, free.speed_scaling) == (Zone.GREEN, 1.0)
    assert g @ settled(monitor, clear, 20).velocity > found.max_closing_speed[found.limiting]


def test_nothing_is_admissible_while_nobody_knows_where_the_robot_is(shipped: Monitor) -> None:
    monitor = shipped
    settled(monitor, snapshot(()), TICKS)
    lost = monitor.step(replace(snapshot(()), joints=Received()))
    assert (lost.zone, lost.separation, lost.speed_scaling) == (Zone.STOP, None, 0.0)
    back = settled(monitor, snapshot(()), TICKS - 1)
    assert (back.zone, back.speed_scaling) == (Zone.STOP, 0.0)
    assert settled(monitor, snapshot(()), 1).zone is Zone.GREEN


@pytest.mark.parametrize("profile", ["iso", "kang2022"])
def test_a_latched_network_is_a_stop(robot: Robot, profile: str) -> None:
    monitor = Monitor(robot, profile=profile)
    assert settled(monitor, snapshot(()), TICKS).zone is Zone.GREEN
    decision = monitor.step(snapshot((), latched=True))
    assert decision.zone is Zone.STOP
    assert "latched" in decision.reasons
    assert not decision.speed_limit.any()


def test_doubts_slow_all_directions_alike(tmp_path: Path) -> None:
    for word, scaling in (("yellow", 0.5), ("red", 0.25)):
        robot = changed(
            tmp_path,
            ('uncovered = "stop"', f'uncovered = "off"\ndisagree_margin_m = 0.01\ndisagree_zone = "{word}"'),
        )
        echo = np.full(8, np.inf)
        echo[3] = 1.15  # of something that the tracker does not have
        wanted = np.zeros(6)
        wanted[0] = 2.0
        monitor = Monitor(robot, profile="iso")
        decision = settled(monitor, snapshot((), ranges=echo, wanted=wanted))
        assert (decision.zone.word, decision.reasons) == (word, ("disagree",))
        assert decision.speed_scaling == scaling
        assert decision.speed_limit == pytest.approx(scaling * robot.velocity_limit)
        assert decision.velocity[0] == pytest.approx(scaling * robot.velocity_limit[0])


def test_steps_by_distance_and_separation_together_are_the_more_severe(tmp_path: Path, iso: Monitor) -> None:
    both = changed(
        tmp_path,
        (
            'uncovered = "stop"',
            (
                'uncovered = "off"\n'
                "red = { distance_m = 0.7, joint_speed_rad_s = 0.18, speed_scaling = 0.25 }\n"
                "yellow = { distance_m = 0.9, joint_speed_rad_s = 0.24, speed_scaling = 0.5 }"
            ),
        ),
    )
    monitor = Monitor(both, profile="iso")
    for x in np.linspace(0.6, 1.6, 11).tolist():
        inputs = snapshot((ball(x),))
        decision = settled(monitor, inputs)
        alone = settled(iso, inputs)
        assert decision.distance is not None
        step = zone_profile(both, "iso").zone_at(decision.distance)
        assert decision.zone is max(alone.zone, step)
        assert decision.speed_scaling <= alone.speed_scaling
        assert (decision.speed_limit <= alone.speed_limit + 1e-12).all()
        if step is Zone.RED:
            assert decision.speed_limit.max() <= 0.18


def test_how_far_a_profile_looks(robot: Robot) -> None:
    iso, paper = zone_profile(robot, "iso"), zone_profile(robot, "kang2022")
    reaction = configured_reaction(robot, "ranges", 0.002).total
    assert reaction == pytest.approx(0.16 + 0.002 + 0.02 + 0.016)
    assert standstill_distance(robot, iso, 0.002) == pytest.approx(0.06 + 0.005 + 1.6 * (reaction + 0.159))
    assert standstill_distance(robot, paper, 0.002) == 0.0


def test_evaluate_says_what_the_next_tick_does(keen: Robot, iso: Monitor) -> None:
    random = np.random.default_rng(5)
    evaluator = Evaluator(keen, zone_profile(keen, "iso"))
    for case in range(12):
        things = tuple(
            replace_id(ball(*random.uniform((0.5, -0.9, 0.0), (1.5, 0.9, 0.9))), str(k)) for k in range(3)
        )
        position, velocity = POSE + random.uniform(-0.3, 0.3, 6), random.uniform(-0.3, 0.3, 6)
        echo = np.full(8, np.inf)
        echo[case % 8] = 1.0 if case % 2 else np.inf
        wanted = np.zeros(6)
        wanted[keen.free] = random.uniform(-0.5, 0.5, 3)
        inputs = snapshot(things, position=position, velocity=velocity, ranges=echo, wanted=wanted, age=0.0)
        inputs = replace(inputs, joints=replace(inputs.joints, age_s=0.0))
        decision = settled(iso, inputs)
        answer = evaluator.evaluate(
            EvaluationInput(
                joints=JointSample(position=position, velocity=velocity),
                velocity_known=True,
                ranges=echo,
                obstacles=things,
                target=Target(kind="joint_velocity", value=wanted),
            )
        )
        assert answer.zone is decision.zone
        assert answer.speed_scaling == pytest.approx(decision.speed_scaling, abs=1e-9)
        assert answer.speed_limit == pytest.approx(decision.speed_limit, abs=1e-9)
        assert answer.velocity == pytest.approx(decision.velocity, abs=1e-9)
        assert len(answer.pairs) == 24
        for entry in answer.pairs:
            assert entry.separation is not None
            assert entry.max_closing_speed is not None
            if entry.max_closing_speed > 0.0:
                at_most = SeparationLaw(
                    reaction_time=0.033 + 0.002 + 0.02 + 0.016,
                    stopping_time=0.159,
                    stopping_gain=0.20 / 3.194,
                    human_uncertainty=0.05,
                    robot_uncertainty=0.005,
                ).terms(entry.max_closing_speed)
                assert at_most.S_p == pytest.approx(entry.pair.distance, abs=1e-9)


def test_evaluate_without_velocities_gives_the_terms_of_standing_still(robot: Robot) -> None:
    evaluator = Evaluator(robot, zone_profile(robot, "iso"))
    joints = JointSample(position=POSE, velocity=np.zeros(6))
    answer = evaluator.evaluate(EvaluationInput(joints=joints, obstacles=(ball(1.2),)))
    for entry in answer.pairs:
        assert entry.closing_speed is None
        assert entry.separation is not None
        assert (entry.separation.S_r, entry.separation.S_s) == (0.0, 0.0)
    nothing = evaluator.evaluate(EvaluationInput(joints=joints))
    assert nothing.zone is Zone.STOP
    assert nothing.separation is not None
    assert nothing.separation.reaction is None
    assert math.isclose(nothing.speed_scaling, 0.0)


def test_evaluate_without_a_separation_has_no_terms(robot: Robot) -> None:
    evaluator = Evaluator(robot, zone_profile(robot, "kang2022"))
    joints = JointSample(position=POSE, velocity=np.zeros(6))
    answer = evaluator.evaluate(EvaluationInput(joints=joints, obstacles=(ball(1.2),)))
    assert answer.separation is None
    assert {(entry.max_closing_speed, entry.separation) for entry in answer.pairs} == {(None, None)}


def test_the_same_inputs_give_the_same_decisions_bit_for_bit(robot: Robot) -> None:
    random = np.random.default_rng(8)
    inputs = [
        snapshot((ball(*random.uniform((0.6, -0.5, 0.0), (1.5, 0.5, 0.8))),), wanted=np.full(6, 0.3))
        for _ in range(40)
    ]
    runs = []
    for _ in range(2):
        monitor = Monitor(robot, profile="iso")
        runs.append([monitor.step(each) for each in inputs])
    for one, two in zip(*runs, strict=True):
        assert one.speed_scaling == two.speed_scaling
        assert (one.velocity == two.velocity).all()
        assert (separated(one).max_closing_speed == separated(two).max_closing_speed).all()


def test_links_that_the_rings_do_not_answer_for_are_not_spoken_of(tmp_path: Path) -> None:
    """A second ring, on the upper arm; the assumptions name the forearm alone."""
    text = (robots_directory() / "ur3.toml").read_text()
    start, end = text.index("[[rings]]"), text.index("# The paper's scene")
    second = text[start:end].replace('"forearm"', '"upper"').replace("forearm_link", "upper_arm_link")
    robot = changed(
        tmp_path,
        ("# The paper's scene", second + "# The paper's scene"),
        ('obstacles = "one"', 'obstacles = "one"\nlinks = ["forearm_link"]'),
        ('uncovered = "stop"', 'uncovered = "off"'),
    )
    inputs = snapshot(None, ranges=np.full(16, np.inf))
    found = separated(Monitor(robot, profile="iso").step(inputs))
    assert [found.link(pair) for pair in range(len(found))] == ["forearm_link"]

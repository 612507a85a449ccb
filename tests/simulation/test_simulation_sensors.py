"""The simulated rings against the reading model, and their timing."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from ssm_service.config import RingConfig, RobotConfig, SimulatedSensorConfig, load_robot_config
from ssm_service.model import Obstacle, Robot
from ssm_service.perception import OwnLinks, cone_reading
from ssm_service.simulation import RangeSensors

POSITION = np.array([0.3, -1.1, 1.3, 0.0, 0.0, 0.0])
FOLDED = np.array([1.18, -0.7, -2.29, 1.39, 0.16, -1.19])  # three sensors look at the arm itself


def robot_with(rings: list[dict[str, Any]]) -> Robot:
    """The UR3 with its ring repeated, each time with other values."""
    config = load_robot_config("ur3")
    ring = config.file.rings[0]
    made: list[RingConfig] = [
        msgspec.structs.replace(ring, **{"name": f"ring{index}", **changes})
        for index, changes in enumerate(rings)
    ]
    return Robot(
        RobotConfig(name="ur3", path=config.path, file=msgspec.structs.replace(config.file, rings=made))
    )


def scene(robot: Robot, generator: np.random.Generator) -> list[Obstacle]:
    centre = robot.kinematics(POSITION).transform_rings_to_base[0][:3, 3]
    shapes: list[tuple[str, tuple[float, ...]]] = [
        ("sphere", (0.05,)),
        ("capsule", (0.045, 0.25)),
        ("box", (0.1, 0.2, 0.1)),
        ("cylinder", (0.05, 0.2)),
    ]
    obstacles = []
    for index, (shape, size) in enumerate(shapes):
        direction = generator.standard_normal(3)
        place = centre + direction / np.linalg.norm(direction) * generator.uniform(0.2, 0.8)
        x, y, z = place.tolist()
        obstacles.append(Obstacle(id=str(index), shape=shape, size=size, position=(x, y, z)))
    return obstacles


def run(
    robot: Robot, obstacles: list[Obstacle], seconds: float, *, seed: int = 0, dt: float = 0.002
) -> list[tuple[float, NDArray[np.float64]]]:
    sensors = RangeSensors(robot, seed=seed)
    messages = []
    for step in range(round(seconds / dt)):
        ranges = sensors.step(step * dt, lambda: POSITION, lambda: obstacles)
        if ranges is not None:
            messages.append((step * dt, ranges))
    return messages


def test_readings_are_the_least_of_cone_readings(ur3: Robot) -> None:
    generator = np.random.default_rng(7)
    echoes = 0
    sensors = RangeSensors(ur3)
    for index in range(60):
        obstacles = scene(ur3, generator)
        ranges = sensors.step(0.16 * index, lambda: POSITION, lambda seen=obstacles: seen)
        assert ranges is not None
        ring = ur3.rings[0]
        for T_base_sensor, reading in zip(
            ur3.kinematics(POSITION).transform_sensors_to_base, ranges, strict=True
        ):
            expected = min(
                cone_reading(thing, T_base_sensor, ring.half_angle, ring.range_max) for thing in obstacles
            )
            assert reading == pytest.approx(expected, abs=1e-9)
            echoes += math.isfinite(reading)
    assert echoes > 30


def test_one_scan_each_period(ur3: Robot) -> None:
    times = [time_s for time_s, _ in run(ur3, [], 1.0)]
    assert times == pytest.approx(np.arange(0.0, 1.0, 0.16).tolist())


def test_rings_take_turns_and_every_message_holds_all(ur3: Robot) -> None:
    robot = robot_with([{"period_s": 0.1}, {"period_s": 0.1, "count": 5}, {"period_s": 0.04, "count": 3}])
    messages = run(robot, scene(robot, np.random.default_rng(8)), 1.0)
    times = [round(time_s, 6) for time_s, _ in messages]
    grid = {
        round(phase * period + k * period, 6)
        for phase, period in ((0.0, 0.1), (1 / 3, 0.1), (2 / 3, 0.04))
        for k in range(30)
    }
    due = sorted({math.ceil(round(t / 0.002, 6)) * 0.002 for t in grid if t < 0.998})
    first = max(0.0, 0.1 / 3, 0.08 / 3)
    assert times == pytest.approx([t for t in due if t >= first])
    assert all(len(ranges) == 16 for _, ranges in messages)


def test_latency_delays_the_message_not_the_measurement() -> None:
    robot = robot_with([{"simulated": SimulatedSensorConfig(latency_s=0.25)}])
    centre = robot.kinematics(POSITION).transform_sensors_to_base[0]
    x, y, z = (centre[:3, 3] + 0.5 * centre[:3, 0]).tolist()
    ball = Obstacle(id="ball", shape="sphere", size=(0.05,), position=(x, y, z))
    sensors, messages = RangeSensors(robot), []
    for step in range(500):
        now = step * 0.002
        seen = [ball] if now < 0.16 else []  # there for the first scan, gone for all others
        ranges = sensors.step(now, lambda: POSITION, lambda seen=seen: seen)
        if ranges is not None:
            messages.append((now, ranges))
    assert [time_s for time_s, _ in messages] == pytest.approx([0.25, 0.41, 0.57, 0.73, 0.89], abs=0.0021)
    assert messages[0][1][0] == pytest.approx(0.45, abs=1e-6)
    assert all(np.isinf(ranges).all() for _, ranges in messages[1:])


def test_one_seed_is_one_run() -> None:
    noisy = SimulatedSensorConfig(noise_std_m=0.02, dropout_probability=0.2, resolution_m=0.001)
    robot = robot_with([{"simulated": noisy}, {"simulated": noisy}])
    obstacles = scene(robot, np.random.default_rng(9))
    first, again, other = (run(robot, obstacles, 3.0, seed=seed) for seed in (1, 1, 2))
    assert [time_s for time_s, _ in first] == [time_s for time_s, _ in again]
    for (_, a), (_, b) in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert any(not np.array_equal(a, b) for (_, a), (_, b) in zip(first, other, strict=True))
    # Two rings with the same view, each at its k-th scan: they do not err alike.
    both = [ranges for _, ranges in first[::2]]
    assert len(both) > 15
    assert any(not np.array_equal(ranges[:8], ranges[8:]) for ranges in both)


def test_the_arm_is_read_like_anything_else(ur3: Robot) -> None:
    own = OwnLinks(ur3).readings(FOLDED)
    seen = np.isfinite(own)
    assert seen.sum() == 3
    generator = np.random.default_rng(10)
    sensors, ring = RangeSensors(ur3), ur3.rings[0]
    poses = ur3.kinematics(FOLDED).transform_sensors_to_base
    behind = before = 0
    for index in range(60):
        obstacles = scene(ur3, generator)
        ranges = sensors.step(0.16 * index, lambda: FOLDED, lambda things=obstacles: things)
        assert ranges is not None
        for sensor, reading in enumerate(ranges):
            cast = min(
                cone_reading(thing, poses[sensor], ring.half_angle, ring.range_max) for thing in obstacles
            )
            assert reading == min(cast, own[sensor])
            behind += seen[sensor] and own[sensor] < cast < math.inf
            before += seen[sensor] and cast < own[sensor]
    assert behind >= 1
    assert before >= 1
    alone = RangeSensors(ur3).step(0.0, lambda: FOLDED, list)
    np.testing.assert_array_equal(alone, own)


def test_own_links_are_read_with_the_devices_errors() -> None:
    robot = robot_with([{"simulated": SimulatedSensorConfig(bias_m=0.02, resolution_m=0.001)}])
    own = OwnLinks(robot).readings(FOLDED)
    ranges = RangeSensors(robot).step(0.0, lambda: FOLDED, list)
    assert ranges is not None
    seen = np.isfinite(own)
    np.testing.assert_array_equal(np.isfinite(ranges), seen)
    np.testing.assert_allclose(ranges[seen], np.round(own[seen] + 0.02, 3), atol=1e-12)


SCANS = 4000


def statistics_of(**simulated: float) -> NDArray[np.float64]:
    """Many scans, (SCANS, 4), of a ball 0.5 m before each of four sensors, from the keys of a robot file."""
    robot = robot_with(
        [{"count": 4, "range_max_m": 0.7, "period_s": 0.05, "simulated": SimulatedSensorConfig(**simulated)}]
    )
    balls = []
    for index, T in enumerate(robot.kinematics(POSITION).transform_sensors_to_base):
        x, y, z = (T[:3, 3] + 0.55 * T[:3, 0]).tolist()
        balls.append(Obstacle(id=str(index), shape="sphere", size=(0.05,), position=(x, y, z)))
    sensors = RangeSensors(robot, seed=3)
    scans = [sensors.step(0.05 * index, lambda: POSITION, lambda: balls) for index in range(SCANS)]
    assert all(ranges is not None for ranges in scans)
    return np.array(scans)


def test_errors_of_the_robot_file_come_out_as_they_are_given() -> None:
    exact = statistics_of()
    np.testing.assert_allclose(exact, 0.5, atol=1e-9)
    noisy = statistics_of(noise_std_m=0.02, bias_m=-0.03, dropout_probability=0.15)
    lost = np.isinf(noisy)
    count = noisy.size
    assert lost.mean() == pytest.approx(0.15, abs=4.0 * math.sqrt(0.15 * 0.85 / count))
    assert (np.abs(lost.mean(axis=0) - 0.15) < 4.0 * math.sqrt(0.15 * 0.85 / SCANS)).all()
    error = noisy[~lost] - 0.5
    assert error.mean() == pytest.approx(-0.03, abs=4.0 * 0.02 / math.sqrt(count))
    assert error.std() == pytest.approx(0.02, rel=0.03)
    kept = noisy[~lost.any(axis=1)]
    between = np.corrcoef(kept.T) - np.eye(4)  # sensors err each for themselves
    assert np.abs(between).max() < 0.08
    stepped = statistics_of(noise_std_m=0.02, resolution_m=0.005)
    steps = stepped / 0.005
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert len(np.unique(np.round(steps))) > 15
    # Rounding adds the variance of one step, h²/12.
    assert (stepped - 0.5).std() == pytest.approx(math.hypot(0.02, 0.005 / math.sqrt(12.0)), rel=0.03)


def test_echoes_near_the_end_of_the_range_are_lost_as_often_as_noise_takes_them_over_it() -> None:
    scans = statistics_of(bias_m=0.18, noise_std_m=0.02)  # at 0.68 of 0.7 m: one standard deviation
    beyond = 0.5 * math.erfc(1.0 / math.sqrt(2.0))
    assert np.isinf(scans).mean() == pytest.approx(
        beyond, abs=4.0 * math.sqrt(beyond * (1 - beyond) / scans.size)
    )
    assert scans[np.isfinite(scans)].max() <= 0.7


@pytest.mark.parametrize(("period_s", "latency_s"), [(0.16, 0.05), (0.1, 0.0), (0.04, 0.13)])
def test_period_and_latency_are_exact_in_time(period_s: float, latency_s: float) -> None:
    """A ball that moves away at 0.1 m/s tells by its distance when it was measured."""
    robot = robot_with([{"period_s": period_s, "simulated": SimulatedSensorConfig(latency_s=latency_s)}])
    pose = robot.kinematics(POSITION).transform_sensors_to_base[0]

    def ball(time_s: float) -> list[Obstacle]:
        x, y, z = (pose[:3, 3] + (0.25 + 0.1 * time_s) * pose[:3, 0]).tolist()
        return [Obstacle(id="ball", shape="sphere", size=(0.05,), position=(x, y, z))]

    sensors, dt, got = RangeSensors(robot), 0.002, []
    for step in range(1500):
        now = step * dt
        ranges = sensors.step(now, lambda: POSITION, lambda now=now: ball(now))
        if ranges is not None:
            got.append((now, (ranges[0] - 0.2) / 0.1))
    arrived, measured = np.array(got).T
    np.testing.assert_allclose(arrived - measured, latency_s, atol=dt)
    assert (arrived - measured >= latency_s - 1e-6).all()
    np.testing.assert_allclose(measured, period_s * np.arange(len(measured)), atol=dt + 1e-6)
    assert len(measured) == math.ceil((3.0 - latency_s - 1e-9) / period_s)

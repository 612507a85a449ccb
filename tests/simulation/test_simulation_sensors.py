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
from ssm_service.perception import cone_reading
from ssm_service.simulation import RangeSensors

POSITION = np.array([0.3, -1.1, 1.3, 0.0, 0.0, 0.0])


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
    for _ in range(60):
        obstacles = scene(ur3, generator)
        ((_, ranges),) = run(ur3, obstacles, 0.1)
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

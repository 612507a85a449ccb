"""Stopping levels: the worst joint, always from the next listed speed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssm_service.config import StoppingConfig, StoppingPoint
from ssm_service.safety import StoppingLevels


def data(*points: tuple[float, float, float]) -> StoppingConfig:
    *slower, (speed, time, distance) = points
    return StoppingConfig(
        speed_rad_s=speed,
        time_s=time,
        distance_rad=distance,
        slower=[StoppingPoint(speed_rad_s=s, time_s=t, distance_rad=d) for s, t, d in slower],
    )


def test_one_listed_speed_for_each_joint_is_one_level_of_the_worst() -> None:
    table = {"a": data((3.2, 0.159, 0.18)), "b": data((3.2, 0.154, 0.20)), "c": data((6.4, 0.1, 0.6))}
    levels = StoppingLevels.of(table, ["a", "b"], [3.0, 3.2])
    assert levels.shares.tolist() == [1.0]
    assert levels.times.tolist() == [0.159]
    assert levels.gains.tolist() == [0.20 / 3.2]
    assert StoppingLevels.of(table, ["a", "b", "c"], [3.0, 3.2, 6.4]).gains.tolist() == [0.6 / 6.4]


def test_a_staircase_over_the_joints_shares() -> None:
    table = {
        "a": data((1.0, 0.1, 0.02), (2.0, 0.2, 0.08)),  # half of its limit, and all of it
        "b": data((1.0, 0.15, 0.01), (4.0, 0.18, 0.12)),  # a quarter, and all of it
    }
    levels = StoppingLevels.of(table, ["a", "b"], [2.0, 4.0])
    assert levels.shares.tolist() == [0.25, 0.5, 1.0]
    assert levels.times.tolist() == [0.15, 0.18, 0.2]
    assert levels.gains == pytest.approx([0.02, 0.03, 0.04])


def test_data_beyond_a_joints_limit_do_not_count_where_slower_ones_reach_it() -> None:
    levels = StoppingLevels.of({"a": data((1.0, 0.1, 0.02), (2.0, 0.2, 0.08))}, ["a"], [0.9])
    assert (levels.shares.tolist(), levels.times.tolist()) == ([1.0], [0.1])


def test_steps_that_change_nothing_are_no_levels() -> None:
    table = {"a": data((1.0, 0.1, 0.1), (2.0, 0.1, 0.2)), "b": data((2.0, 0.2, 0.4))}
    levels = StoppingLevels.of(table, ["a", "b"], [2.0, 2.0])
    assert (levels.shares.tolist(), levels.times.tolist(), levels.gains.tolist()) == ([1.0], [0.2], [0.2])


def test_the_level_of_a_share_is_never_too_slow_a_one() -> None:
    table = {"a": data((1.0, 0.1, 0.02), (2.0, 0.2, 0.08))}
    levels = StoppingLevels.of(table, ["a"], [2.0])
    shares = (0.0, 0.5, np.nextafter(0.5, 1.0), 1.0, 7.0, math.nan)
    assert [levels.level_at(share) for share in shares] == [0, 0, 1, 1, 1, 1]


def test_levels_never_fall_however_the_data_are_drawn() -> None:
    random = np.random.default_rng(5)
    for _ in range(200):
        table, limits = {}, []
        for joint in "abc":
            speeds = np.sort(random.uniform(0.2, 3.0, random.integers(1, 5)))
            times, gains = np.sort(random.uniform(0.05, 0.5, (2, len(speeds))))
            table[joint] = data(*zip(speeds, times, gains * speeds, strict=True))
            limits.append(float(random.uniform(0.1, speeds[-1])))
        levels = StoppingLevels.of(table, list(table), limits)
        assert levels.shares[-1] == 1.0
        for column in (levels.shares, levels.times, levels.gains):
            assert (np.diff(column) >= 0.0).all()
        for share in random.uniform(0.0, 1.0, 20):
            level = levels.level_at(share)
            for joint, limit in zip(table, limits, strict=True):
                points = [*table[joint].slower, table[joint]]
                point = next(p for p in points if p.speed_rad_s >= share * limit)
                assert levels.times[level] >= point.time_s
                assert levels.gains[level] >= point.distance_rad / point.speed_rad_s - 1e-15


@pytest.mark.parametrize(("joints", "limits"), [(["a", "b"], [2.0]), (["a"], [2.0, 1.0])])
def test_a_joint_without_a_limit_or_a_limit_without_a_joint_gives_no_levels(
    joints: list[str], limits: list[float]
) -> None:
    table = {name: data((2.0, 0.2, 0.08)) for name in "ab"}
    with pytest.raises(ValueError, match="zip"):
        StoppingLevels.of(table, joints, limits)


@pytest.mark.parametrize("column", ["shares", "times", "gains"])
def test_nobody_changes_levels_that_others_hold(column: str) -> None:
    levels = StoppingLevels.of({"a": data((1.0, 0.1, 0.02), (2.0, 0.2, 0.08))}, ["a"], [2.0])
    with pytest.raises(ValueError, match="read-only"):
        getattr(levels, column)[0] = 0.0

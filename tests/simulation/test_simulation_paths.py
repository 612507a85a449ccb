"""Paths between waypoints, and what is due when."""

from __future__ import annotations

import numpy as np
import pytest

from ssm_service.simulation.paths import Path3
from ssm_service.simulation.schedule import Periodic


def random_path(generator: np.random.Generator, *, loop: bool) -> Path3:
    times = np.concatenate(([0.0], np.cumsum(generator.uniform(0.1, 2.0, 5)))).tolist()
    positions = generator.uniform(-2.0, 2.0, (6, 3))
    if loop:
        positions[-1] = positions[0]
    return Path3.of(times, [tuple(row) for row in positions.tolist()], loop=loop)


@pytest.mark.parametrize("loop", [True, False])
def test_passes_its_waypoints_in_straight_lines(loop: bool) -> None:
    generator = np.random.default_rng(1)
    for _ in range(20):
        path = random_path(generator, loop=loop)
        for time_s, position in zip(path.times, path.positions, strict=True):
            assert path.at(time_s)[0] == pytest.approx(position, abs=1e-12)
        for leg in range(5):
            part = generator.random()
            time_s = path.times[leg] + part * (path.times[leg + 1] - path.times[leg])
            between = (1 - part) * np.array(path.positions[leg]) + part * np.array(path.positions[leg + 1])
            assert path.at(time_s)[0] == pytest.approx(between.tolist(), abs=1e-12)


@pytest.mark.parametrize("loop", [True, False])
def test_velocity_is_the_derivative(loop: bool) -> None:
    generator = np.random.default_rng(2)
    step, compared = 1e-6, 0
    for _ in range(20):
        path = random_path(generator, loop=loop)
        for time_s in generator.uniform(0.0, 2.5 * path.times[-1], 40):
            before, after = path.at(time_s - step)[0], path.at(time_s + step)[0]
            phase = time_s % path.times[-1]
            if min(abs(phase - corner) for corner in path.times) < 2 * step:
                continue
            difference = (np.array(after) - before) / (2 * step)
            assert path.at(time_s)[1] == pytest.approx(difference.tolist(), abs=1e-6)
            compared += 1
    assert compared > 700


def test_a_loop_repeats_and_a_held_path_ends() -> None:
    generator = np.random.default_rng(3)
    loop, held = random_path(generator, loop=True), random_path(generator, loop=False)
    for time_s in generator.uniform(0.0, loop.times[-1], 20):
        assert loop.at(time_s + 3 * loop.times[-1])[0] == pytest.approx(loop.at(time_s)[0], abs=1e-9)
    assert held.at(held.times[-1] + 1e-9) == (held.positions[-1], (0.0, 0.0, 0.0))
    assert held.at(1e6) == (held.positions[-1], (0.0, 0.0, 0.0))
    assert held.at(-1.0) == (held.positions[0], (0.0, 0.0, 0.0))


@pytest.mark.parametrize("loop", [True, False])
def test_one_waypoint_stands_still(loop: bool) -> None:
    path = Path3.of([0.0], [(1.0, 2.0, 3.0)], loop=loop)
    for time_s in (0.0, 0.5, 1e4):
        assert path.at(time_s) == ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))


def test_periodic_keeps_its_grid_over_summed_steps() -> None:
    clock, time_s, due = Periodic(0.008), 0.0, []
    for step in range(100_000):
        if clock.due(time_s):
            due.append(step)
        time_s += 0.002
    assert due == list(range(0, 100_000, 4))


def test_periodic_leaves_out_what_was_missed() -> None:
    clock = Periodic(1.0, phase_s=0.25)
    asked = [0.0, 0.24, 0.25, 0.3, 1.2, 1.26, 7.3, 7.4, 8.24, 8.25]
    assert [time_s for time_s in asked if clock.due(time_s)] == [0.25, 1.26, 7.3, 8.25]

"""Every scenario run in memory: robot, sensors, obstacles and monitor together."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulation_witness import PERIOD_S, order, watch

from ssm_service.model import Robot
from ssm_service.safety import Zone
from ssm_service.simulation import MemoryRun, list_scenarios, load_scenario


def test_every_scenario_is_checked_here() -> None:
    assert list_scenarios() == ["crossing", "empty", "hand", "static", "walk"]


def test_empty_reaches_its_goals_again_and_again(ur3: Robot) -> None:
    seen = watch(ur3, "empty")
    assert order(seen.zones) == [Zone.GREEN]
    assert len(seen.arrivals) == 4
    assert len(set(seen.arrivals)) == 2
    assert seen.echoes == 0
    assert seen.own_echoes > 20  # folded, the forearm's sensors see the rest of the arm
    assert seen.scans == 150
    assert seen.moved > 4.0


def test_static_changes_zone_as_the_arm_passes(ur3: Robot) -> None:
    seen = watch(ur3, "static")
    assert order(seen.zones) == [Zone.GREEN, Zone.YELLOW] * 2 + [Zone.GREEN]
    assert 0.1775 < seen.nearest < 0.355
    assert seen.echoes > 10
    assert "forearm_link" in seen.nearest_links


def test_crossing_passes_through_every_zone_and_back(ur3: Robot) -> None:
    seen = watch(ur3, "crossing")
    there_and_back = [Zone.GREEN, Zone.YELLOW, Zone.RED, Zone.YELLOW]
    assert order(seen.zones) == there_and_back * 4 + [Zone.GREEN]
    assert 0.05 < seen.nearest < 0.1775
    assert seen.echoes > 15
    assert "forearm_link" in seen.nearest_links
    assert seen.moved > 3.0


def test_hand_comes_near_and_leaves(ur3: Robot) -> None:
    seen = watch(ur3, "hand")
    assert order(seen.zones) == [Zone.GREEN, Zone.YELLOW, Zone.RED, Zone.YELLOW, Zone.GREEN]
    assert 0.1 <= seen.nearest <= 0.15
    assert seen.zones.count(Zone.RED) * PERIOD_S > 2.0
    assert seen.echoes > 10
    # Its goals change every 6 s: it reaches the first before the hand is near, the last two after it left.
    for begin, end in ((0.0, 6.0), (12.0, 18.0), (18.0, 24.0)):
        assert any(begin <= time_s < end for time_s in seen.at_goal_s)


def test_walk_passes_by(ur3: Robot) -> None:
    seen = watch(ur3, "walk")
    assert {Zone.GREEN, Zone.YELLOW, Zone.RED} == set(order(seen.zones))
    assert 0.05 < seen.nearest < 0.1775
    assert len(seen.arrivals) == 4
    scenario = load_scenario("walk", ur3)
    assert len(scenario.movers) == 10
    speeds = {
        round(math.hypot(*thing.velocity), 3)
        for time_s in np.arange(0.0, 24.0, 0.1)
        for thing in scenario.obstacles_at(float(time_s))
    }
    assert min(speed for speed in speeds if speed > 0.0) >= 1.0
    assert max(speeds) <= 1.6


def test_rings_alone_see_the_crossing(ur3: Robot) -> None:
    run = MemoryRun(ur3, load_scenario("crossing", ur3), period_s=PERIOD_S, track_obstacles=False)
    zones = []
    for _ in range(6000):
        tick = run.tick()
        assert tick.inputs.obstacles.value is None
        zones.append(tick.decision.zone)
    assert {Zone.GREEN, Zone.YELLOW, Zone.RED} <= set(zones)


def test_the_same_run_twice(ur3: Robot) -> None:
    def record() -> list[bytes]:
        run = MemoryRun(ur3, load_scenario("crossing", ur3), seed=3, period_s=PERIOD_S)
        result = []
        for _ in range(2000):
            decision = run.tick().decision
            result.append(decision.velocity.tobytes() + run.world.plant.position.tobytes())
        return result

    assert record() == record()


@pytest.mark.parametrize("period_s", [0.001, 0.01])
def test_other_rates_work_alike(ur3: Robot, period_s: float) -> None:
    run = MemoryRun(ur3, load_scenario("empty", ur3), period_s=period_s)
    for _ in range(round(5.5 / period_s)):
        run.tick()
    target = run.world.scenario.target_at(5.0)
    assert target is not None
    place = ur3.kinematics(run.world.plant.position).transform_end_effector_to_base[:3, 3]
    assert math.dist(place, target.value) < 0.002

"""Every scenario run in memory: robot, sensors, obstacles and monitor together."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from ssm_service.model import DistanceModel, Robot
from ssm_service.safety import Zone
from ssm_service.simulation import MemoryRun, MemoryTick, list_scenarios, load_scenario
from ssm_service.simulation.world import JOINTS_PERIOD_S, OBSTACLES_PERIOD_S

PERIOD_S = 0.002


@dataclass
class Seen:
    """What one run showed."""

    zones: list[Zone] = field(default_factory=list)
    arrivals: list[tuple[float, ...]] = field(default_factory=list)
    nearest: float = math.inf
    nearest_links: set[str] = field(default_factory=set)
    scans: int = 0
    echoes: int = 0
    moved: float = 0.0


class Witness:
    """Checks each tick by means of its own, and notes what a run showed."""

    def __init__(self, robot: Robot, run: MemoryRun) -> None:
        self.robot, self.run, self.seen = robot, run, Seen()
        self._distance = DistanceModel(robot)
        self._ranges: object = None
        self._before = run.world.plant.position

    def check(self, tick: MemoryTick, index: int) -> None:
        robot, plant, seen = self.robot, self.run.world.plant, self.seen
        decision = tick.decision
        assert (np.abs(plant.velocity) <= robot.velocity_limit).all()
        assert (robot.position_lower <= plant.position).all()
        assert (plant.position <= robot.position_upper).all()
        locked = np.setdiff1d(np.arange(6), robot.free)
        np.testing.assert_array_equal(plant.position[locked], robot.rest_position[locked])
        assert (np.abs(decision.velocity) <= decision.speed_limit).all()
        seen.moved += float(np.abs(plant.position - self._before).sum())
        self._before = plant.position
        seen.zones.append(decision.zone)
        self._note_ranges(tick)
        self._note_arrival(tick)
        if index % 20 == 0:
            self._check_zone(tick)
        if index % 100 == 0:
            self._check_truth(tick)

    def _check_zone(self, tick: MemoryTick) -> None:
        """The zone is never milder than the exact distance between what the monitor was told."""
        obstacles, joints = tick.inputs.obstacles.value, tick.inputs.joints.value
        assert obstacles is not None
        assert joints is not None
        self._distance.set_obstacles(obstacles)
        pairs = self._distance.all_pairs(joints.position)
        if not pairs:
            return
        nearest = min(pairs, key=lambda pair: pair.distance)
        assert tick.decision.zone >= self.run.monitor.profile.zone_at(nearest.distance)
        if nearest.distance < self.seen.nearest:
            self.seen.nearest = nearest.distance
        self.seen.nearest_links.add(nearest.link)

    def _check_truth(self, tick: MemoryTick) -> None:
        """Nor milder than the world as it is, but for what moves within one message of tracker and drive."""
        obstacles = self.run.world.obstacles()
        fastest = max([math.hypot(*thing.velocity) for thing in obstacles], default=0.0)
        slack = (OBSTACLES_PERIOD_S + PERIOD_S) * max(fastest, 1.5) + (JOINTS_PERIOD_S + PERIOD_S) * 0.5
        self._distance.set_obstacles(obstacles)
        nearest = self._distance.nearest(self.run.world.plant.position)
        if nearest is not None:
            assert tick.decision.zone >= self.run.monitor.profile.zone_at(nearest.distance + slack)

    def _note_ranges(self, tick: MemoryTick) -> None:
        ranges = tick.inputs.ranges.value
        if ranges is not self._ranges and ranges is not None:
            self._ranges = ranges
            self.seen.scans += 1
            self.seen.echoes += bool(np.isfinite(ranges).any())

    def _note_arrival(self, tick: MemoryTick) -> None:
        target = tick.inputs.target.value
        assert target is not None
        place = self.robot.kinematics(self.run.world.plant.position).transform_end_effector_to_base[:3, 3]
        goal = tuple(target.value.tolist())
        if math.dist(place, goal) < 0.002 and (not self.seen.arrivals or self.seen.arrivals[-1] != goal):
            self.seen.arrivals.append(goal)


def watch(robot: Robot, name: str, *, seconds: float | None = None) -> Seen:
    scenario = load_scenario(name, robot)
    run = MemoryRun(robot, scenario, period_s=PERIOD_S)
    witness = Witness(robot, run)
    for index in range(round((seconds or scenario.duration_s) / PERIOD_S)):
        witness.check(run.tick(), index)
    return witness.seen


def order(zones: list[Zone]) -> list[Zone]:
    """The zones in the order in which they came, without the stop of the first ticks."""
    changes = [zone for before, zone in zip([None, *zones], zones, strict=False) if zone is not before]
    return changes[1:] if changes[0] is Zone.STOP else changes


def test_every_scenario_is_checked_here() -> None:
    assert list_scenarios() == ["crossing", "empty", "hand", "static", "walk"]


def test_empty_reaches_its_goals_again_and_again(ur3: Robot) -> None:
    seen = watch(ur3, "empty")
    assert order(seen.zones) == [Zone.GREEN]
    assert len(seen.arrivals) == 4
    assert len(set(seen.arrivals)) == 2
    assert seen.echoes == 0
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
    assert len(seen.arrivals) >= 2  # on its way before the hand came and after it had left


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

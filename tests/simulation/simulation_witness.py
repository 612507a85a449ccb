"""A run in memory, watched: each tick checked by other means, and what the run showed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ssm_service.model import DistanceModel, Robot
from ssm_service.perception import OwnLinks
from ssm_service.safety import Zone
from ssm_service.simulation import MemoryRun, MemoryTick, load_scenario
from ssm_service.simulation.world import JOINTS_PERIOD_S, OBSTACLES_PERIOD_S

PERIOD_S = 0.002


@dataclass
class Seen:
    """What one run showed."""

    zones: list[Zone] = field(default_factory=list)
    arrivals: list[tuple[float, ...]] = field(default_factory=list)
    at_goal_s: list[float] = field(default_factory=list)
    nearest: float = math.inf
    nearest_links: set[str] = field(default_factory=set)
    scans: int = 0
    echoes: int = 0
    own_echoes: int = 0
    moved: float = 0.0


class Witness:
    """Checks each tick by means of its own, and notes what a run showed."""

    def __init__(self, robot: Robot, run: MemoryRun) -> None:
        self.robot, self.run, self.seen = robot, run, Seen()
        self._distance = DistanceModel(robot)
        self._own = OwnLinks(robot)
        self._ranges: object = None
        self._before = run.world.plant.position

    def check(self, tick: MemoryTick, index: int) -> None:
        robot, plant, seen = self.robot, self.run.world.plant, self.seen
        decision = tick.decision
        assert (np.abs(plant.velocity) <= robot.velocity_limit).all()
        assert (robot.position_lower <= plant.position).all()
        assert (plant.position <= robot.position_upper).all()
        locked = np.setdiff1d(np.arange(len(robot.joint_names)), robot.free)
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
            own, heard = self._own.distances(self.run.world.plant.position), np.isfinite(ranges)
            off = np.abs(np.where(heard, ranges, -1.0) - own)  # 2 cm: the scan is of a moment ago
            self.seen.echoes += bool((heard & (off > 0.02)).any())
            self.seen.own_echoes += bool((heard & (off <= 0.02)).any())

    def _note_arrival(self, tick: MemoryTick) -> None:
        target = tick.inputs.target.value
        assert target is not None
        if target.kind != "position":
            return
        place = self.robot.kinematics(self.run.world.plant.position).transform_end_effector_to_base[:3, 3]
        goal = tuple(target.value.tolist())
        if math.dist(place, goal) < 0.002:
            self.seen.at_goal_s.append(len(self.seen.zones) * PERIOD_S)
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

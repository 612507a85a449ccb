"""One run of a scenario under one profile, held against the equation at every instant."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ssm_service.model import DistanceModel, Obstacle, Robot, closing_gradients, moved_by
from ssm_service.monitor import Inputs, JointSample, Monitor, Received, Target
from ssm_service.monitor.reach import lever_arms
from ssm_service.monitor.reaction import reaction_times, stopping_levels
from ssm_service.simulation import World

from .iso_scenes import ARM_SPEEDS_M_S, LEGS, PROFILES, SCENARIOS, variant, write_robots

T = TypeVar("T")
Array = NDArray[np.float64]

PERIOD_S = 0.008
"""Time from tick to tick [s], and from one joint state to the next (125 Hz)."""

HORIZON_S = 24.0
STANDING_M_S = 1e-3
"""A point that comes nearer more slowly than this stands still or retreats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """One run.

    Attributes:
        scenario: Of ``SCENARIOS``.
        number: Of the variant.
        profile: Of ``PROFILES``.
        seed: Of everything drawn.
        horizon_s: How long it lasts at most [s].
    """

    scenario: str
    number: int
    profile: str
    seed: int
    horizon_s: float = HORIZON_S


@dataclass(slots=True, kw_only=True)
class Result:
    """What came out of one run.

    Attributes:
        piece: The run.
        instants: Instants looked at.
        short: Instants at which a link that was coming nearer had less than S_p to something.
        apart: Instants at which only links that stood still or retreated had less (counted apart).
        spent: Instants of ``short`` at which not even a stop that began at once would have done.
        worst_m: The greatest S_p − d of ``short`` [m].
        worst_s: The greatest (S_p − d)/(v_h + v_r) of ``short``: how long ago the distance was enough [s].
        worst_spent_m: What was missing at the worst of ``spent`` [m].
        reaction_s: The greatest T_r in force [s].
        contacts: Times that something touched the arm while the arm came nearer.
        touched: Times that something touched a link that stood still or retreated.
        least_m: The least distance [m].
        finished_s: When the cycle of targets was done [s]; None where it was not.
        legs: Targets reached.
        seconds: How long the run was [s].
        zones: Instants by zone.
        example: The first of ``spent``, in words.
    """

    piece: Piece
    instants: int = 0
    short: int = 0
    apart: int = 0
    spent: int = 0
    worst_m: float = 0.0
    worst_s: float = 0.0
    worst_spent_m: float = 0.0
    reaction_s: float = 0.0
    contacts: int = 0
    touched: int = 0
    least_m: float = math.inf
    finished_s: float | None = None
    legs: int = 0
    seconds: float = 0.0
    zones: dict[str, int] = field(default_factory=dict)
    example: str = ""


class Held(Generic[T]):
    """The newest value of a source, when it came, and the longest time between two."""

    def __init__(self) -> None:
        self._value: T | None = None
        self._time = self._longest = 0.0

    def received(self, value: T | None, now: float) -> Received[T]:
        """Take a new value, if there is one."""
        if value is not None:
            if self._value is not None:
                self._longest = max(self._longest, now - self._time)
            self._value, self._time = value, now
        age = None if self._value is None else now - self._time
        return Received(value=self._value, age_s=age, period_s=self._longest)


class Watch:
    """Looks at the true arm and the true obstacles, and asks the equation.

    The separation is that of profile ``iso``: its C, Z_d and Z_r, T_r as in force at the instant, T_s and the
    stopping gain of the level that the true joint velocity is in; v_h is the obstacle's true speed, v_r the
    true directed closing speed of the link's nearest point.

    ``short``: d < S_p and v_r > 0. S_p is what must be there when the robot is to begin to react; while it
    reacts, the distance shrinks below it, by (v_h + v_r)·T_r at most. ``spent``: d < S_p with T_r = 0, and
    the command in force still closes in: the reaction time is used up and no stop has begun.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._distance = DistanceModel(robot)
        self._moved = np.array([moved_by(robot, link) for link in robot.monitored_links])
        self._arms = lever_arms(robot)
        self._levels = stopping_levels(robot)
        config = robot.config.file.profiles["iso"].separation
        if config is None:
            raise ValueError("profile iso has no separation")
        self._fixed = config.intrusion_m + config.human_uncertainty_m + config.robot_uncertainty_m
        self._touching: set[tuple[int, int]] = set()

    def begin(self) -> None:
        """Forget the run before."""
        self._touching = set()

    def look(self, now: float, world: World, command: Array, reaction_s: float, into: Result) -> None:
        """Look at one instant [s], at which a command, (n,) [rad/s], is in force."""
        arm, levels, obstacles = world.plant, self._levels, world.obstacles()
        self._distance.set_obstacles(obstacles)
        pairs = self._distance.pairs(arm.position)
        speeds = np.array([math.hypot(*(one.velocity or (0.0, 0.0, 0.0))) for one in obstacles])
        human = speeds[pairs.obstacle]
        free = self._robot.free
        level = levels.level_at(float((np.abs(arm.velocity) / self._robot.velocity_limit)[free].max()))
        standing = human * (reaction_s + levels.times[level]) + self._fixed
        each = reaction_s + float(levels.gains[level])
        # The hulls are never too far, and no point is faster than this: the others cannot be short.
        near = pairs.distance < standing + float(self._arms @ np.abs(arm.velocity)) * each
        rows = (near | (pairs.distance < into.least_m)).nonzero()[0]
        into.instants += 1
        into.reaction_s = max(into.reaction_s, reaction_s)
        if not len(rows):
            return
        self._distance.refine(pairs, rows.tolist())
        gradients = closing_gradients(
            self._robot.kinematics(arm.position).spatial_jacobian,
            self._moved[pairs.link[rows]],
            pairs.point_on_link[rows],
            pairs.normal[rows],
        )
        closing, wanted = gradients @ arm.velocity, gradients @ command
        into.least_m = min(into.least_m, float(pairs.distance[rows].min()))
        missing = standing[rows] + np.maximum(closing, 0.0) * each - pairs.distance[rows]
        keys = list(zip(pairs.link[rows].tolist(), pairs.obstacle[rows].tolist(), strict=True))
        self._touches(keys, pairs.distance[rows], closing, into)
        moving = (missing > 0.0) & (closing > STANDING_M_S)
        into.short += bool(moving.any())
        into.apart += bool((missing > 0.0).any()) and not moving.any()
        if moving.any():
            lag = missing / np.maximum(human[rows] + closing, STANDING_M_S)
            into.worst_m = max(into.worst_m, float(missing[moving].max()))
            into.worst_s = max(into.worst_s, float(lag[moving].max()))
            left = missing - reaction_s * (human[rows] + closing)
            spent = moving & (left > 0.0) & (wanted > STANDING_M_S)
            self._spent(now, keys, np.where(spent, left, -math.inf), closing, into)

    def _touches(self, keys: list[tuple[int, int]], distance: Array, closing: Array, into: Result) -> None:
        touching = set()
        for key, gap, speed in zip(keys, distance.tolist(), closing.tolist(), strict=True):
            if gap <= 0.0:
                touching.add(key)
                if key not in self._touching:
                    into.contacts += speed > STANDING_M_S
                    into.touched += speed <= STANDING_M_S
        self._touching = touching

    def _spent(
        self, now: float, keys: list[tuple[int, int]], left: Array, closing: Array, into: Result
    ) -> None:
        worst = int(left.argmax())
        if not left[worst] > 0.0:
            return
        into.spent += 1
        into.worst_spent_m = max(into.worst_spent_m, float(left[worst]))
        if not into.example:
            link, obstacle = keys[worst]
            into.example = (
                f"{into.piece.scenario} {into.piece.number} at {now:.3f} s: "
                f"{self._robot.monitored_links[link]} and obstacle {obstacle} have {left[worst]:.3f} m less "
                f"than a stop at once needs, closing at {closing[worst]:.3f} m/s"
            )


@cache
def robots() -> list[tuple[Robot, Watch]]:
    """Return the robots, one for each of ``ARM_SPEEDS_M_S``, and what looks at them."""
    with tempfile.TemporaryDirectory(prefix="iso-") as folder:
        first = Robot.load(write_robots(Path(folder), 1.0)[0])
        paths = write_robots(Path(folder), plain_distance(first))
        return [(robot, Watch(robot)) for robot in map(Robot.load, paths)]


def plain_distance(robot: Robot) -> float:
    """Return the distance to stop at that is safe at the fastest of the arm's speeds, by the equation [m]."""
    law = robot.config.file.profiles["iso"].separation
    if law is None:
        raise ValueError("profile iso has no separation")
    file, levels = robot.config.file, stopping_levels(robot)
    tracker = 2.0 * max(file.sources.obstacles.period_s, 1.0 / 30.0 + PERIOD_S)
    reaction = tracker + PERIOD_S + file.reaction.transport_s + file.reaction.robot_s
    fixed = law.intrusion_m + law.human_uncertainty_m + law.robot_uncertainty_m
    person = law.human_speed_m_s * (reaction + float(levels.times[-1]))
    return fixed + person + max(ARM_SPEEDS_M_S) * (reaction + float(levels.gains[-1]))


@cache
def _monitor(number: int, profile: str) -> Monitor:
    return Monitor(robots()[number][0], profile=profile, period_s=PERIOD_S)


def monitor_of(number: int, profile: str) -> Monitor:
    """Return a robot's monitor as if it were new: nothing was known for longer than a zone lasts."""
    monitor = _monitor(number, profile)
    for _ in range(monitor.profile.config.recovery_ticks + 1):
        monitor.step(Inputs())
    return monitor


def run(piece: Piece) -> Result:
    """Run one variant under one profile until the cycle of targets is done, or the time over."""
    rng = np.random.default_rng([piece.seed, SCENARIOS.index(piece.scenario), piece.number])
    number = int(rng.integers(len(ARM_SPEEDS_M_S)))
    robot, watch = robots()[number]
    task = variant(robot, piece.scenario, rng)
    world, monitor = World(robot, task), monitor_of(number, piece.profile)
    result, pending = Result(piece=piece), np.zeros(len(robot.joint_names))
    joints: Held[JointSample] = Held()
    obstacles: Held[tuple[Obstacle, ...]] = Held()
    target: Held[Target] = Held()
    watch.begin()
    for _ in range(round(piece.horizon_s / PERIOD_S)):
        now = world.time_s
        emitted = world.emit()
        inputs = Inputs(
            joints=joints.received(emitted.joints, now),
            obstacles=obstacles.received(emitted.obstacles, now),
            target=target.received(emitted.target, now),
        )
        decision = monitor.step(inputs)
        result.zones[decision.zone.word] = result.zones.get(decision.zone.word, 0) + 1
        reaction = reaction_times(robot, inputs, {"obstacles"}, PERIOD_S)["obstacles"].total
        watch.look(now, world, pending, reaction, result)
        world.step(pending, PERIOD_S)  # what was decided a tick ago
        pending = decision.velocity
        if len(task.reached_s) >= LEGS:
            break
    result.legs, result.seconds = len(task.reached_s), world.time_s
    result.finished_s = task.reached_s[LEGS - 1] if result.legs >= LEGS else None
    return result


def pieces(seed: int, variants: int, horizon_s: float = HORIZON_S) -> list[Piece]:
    """Return all runs."""
    return [
        Piece(scenario=scenario, number=number, profile=profile, seed=seed, horizon_s=horizon_s)
        for scenario in SCENARIOS
        for number in range(variants)
        for profile in PROFILES
    ]

"""One scene with one method, watched by the true distances."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssm_service.model import Kinematics, Obstacle
from ssm_service.monitor import JointSample
from ssm_service.monitor.command import limited_velocity
from ssm_service.motion.self_collision import SelfCollision
from ssm_service.perception import scan
from ssm_service.simulation import Plant
from ssm_service.simulation.schedule import Periodic

from .avoidance_judge import Judge
from .avoidance_methods import METHODS, info_of
from .avoidance_outcome import Outcome
from .avoidance_scenes import REST, Scene, World, robot
from .avoidance_sight import Sight
from .avoidance_state import PERIOD_S, State

Array = NDArray[np.float64]

TRACKER_S = 1.0 / 30.0
HORIZON_S = 40.0
ARRIVED_M = 0.005
STILL_S = 6.0
STILL_RAD = 0.1
PROGRESS_M = 0.005
ITSELF_TICKS = 5
"""So many ticks apart it is looked whether the arm touches itself."""

BIN = 1.02
"""Solve times are counted in steps of this factor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """One method in one scene.

    Attributes:
        scene: As ``avoidance_draw.drawn`` returned it.
        method: Of ``METHODS``.
        horizon_s: How long the run lasts at most [s].
    """

    scene: dict[str, Any]
    method: str
    horizon_s: float = HORIZON_S


@cache
def _itself() -> SelfCollision:
    return SelfCollision(robot(), REST)


def _scanned(kinematics: Kinematics, obstacles: tuple[Obstacle, ...]) -> Array:
    """Return what the ring reads of the obstacles, (m,) [m]; echoes of the arm itself are left out."""
    ring = robot().rings[0]
    return scan(
        obstacles, kinematics.transform_sensors_to_base, ring.half_angle, ring.range_max, ring.range_min
    )


class Progress:
    """Knows since when the arm has come no nearer to its goal and has kept to one place.

    It comes nearer when its distance falls by ``PROGRESS_M`` below the least so far, and leaves its place
    when a joint is ``STILL_RAD`` away: an arm that swings to and fro before a wall makes no progress, one on
    its way round does.
    """

    def __init__(self, position: Array) -> None:
        self._place, self._best, self._since = position, math.inf, 0.0

    def step(self, now: float, position: Array, left: float, *, waiting: bool) -> float:
        """Return for how long there was no progress [s]; none is expected while ``waiting``."""
        moved = max(map(abs, (position - self._place).tolist())) > STILL_RAD
        nearer = left < self._best - PROGRESS_M
        if moved:
            self._place = position.copy()
        if nearer:
            self._best = left
        if waiting or moved or nearer:
            self._since = now
        return now - self._since


class Run:
    """One run, tick by tick.

    Attributes:
        result: What came of it so far.

    Args:
        scene: The scene.
        name: Of the method.
        planned: Length of the planner's path [rad]; None where there is none.
    """

    def __init__(self, scene: Scene, name: str, planned: float | None) -> None:
        self._arm, self._scene = robot(), scene
        # New ones: Coal begins each search where the last one ended, which shows in the last digits.
        self._seen_by, self._true = Sight(self._arm), Sight(self._arm)
        self._world, self._plant = World(scene), Plant(self._arm, scene.start)
        self.method = METHODS[name](self._arm)
        self._judge = Judge(self._arm)
        self._ring = Periodic(self._arm.rings[0].period) if name == "field3d" else None
        self._tracker = Periodic(TRACKER_S)
        self._command = np.zeros(len(self._arm.joint_names))
        self._truth = self._seen = self._world.obstacles()
        self._ranges: Array | None = None
        self._progress = Progress(scene.start)
        self.result = Outcome(
            number=scene.number,
            kind=scene.kind,
            method=name,
            possible=planned is not None,
            blocked=scene.blocked,
            planned=planned,
        )

    @property
    def time_s(self) -> float:
        """Time since the start [s]."""
        return self._world.time_s

    def tick(self) -> tuple[State, Array]:
        """Let the method decide, look at the truth, and move on; return what it was told and the command."""
        state = self._told()
        begin = time.thread_time_ns()  # not the time in which others had the processor
        wanted = self.method.velocity(state)
        spent_us = max(1e-3 * (time.thread_time_ns() - begin), 1.0)
        self.result.solve_us[round(BIN ** round(math.log(spent_us, BIN)), 3)] += 1
        plant = self._plant
        command = limited_velocity(
            self._arm,
            wanted,
            previous=self._command,
            position=plant.position,
            speed_limit=state.speed_limit,
            period_s=PERIOD_S,
        )
        self._look(state)
        before = plant.position
        plant.step(self._command, PERIOD_S)  # what was decided a tick ago
        self.result.path += math.dist(plant.position.tolist(), before.tolist())
        self._world.step(state.end_effector, PERIOD_S)
        if len(self._truth) > len(self._scene.fixed):
            self._truth = self._world.obstacles()
        self._command = command
        self._end(state)
        return state, command

    def _told(self) -> State:
        """Return what the method is told: what the tracker and the ring saw last."""
        now, plant = self.time_s, self._plant
        if self._tracker.due(now):
            self._seen = self._truth
        kinematics = self._arm.kinematics(plant.position)
        if self._ring is not None and self._ring.due(now):
            self._ranges = _scanned(kinematics, self._truth)
        sight = self._seen_by.at(self._seen, plant.position)
        return State(
            robot=self._arm,
            time_s=now,
            dt=PERIOD_S,
            joints=JointSample(position=plant.position.copy(), velocity=plant.velocity.copy()),
            kinematics=kinematics,
            goal=self._scene.goal,
            obstacles=self._seen,
            sight=sight,
            ranges=self._ranges,
            previous=self._command,
            speed_limit=self._judge.limit_at(sight.least_m),
        )

    def _look(self, state: State) -> None:
        plant, result = self._plant, self.result
        # Where nothing has moved since the tracker looked, its distances are the true ones.
        sight = state.sight if self._seen is self._truth else self._true.at(self._truth, plant.position)
        self._judge.look(plant, sight, state.speed_limit, state.time_s, result)
        if result.instants % ITSELF_TICKS == 0:
            result.itself += _itself().touches(plant.position)

    def _end(self, state: State) -> None:
        """Say how it ended, where it did."""
        result, now = self.result, state.time_s
        result.goal_m = math.dist(state.end_effector.tolist(), self._scene.goal.tolist())
        if result.goal_m > ARRIVED_M:
            result.arrived_s = None
        elif result.arrived_s is None:
            result.arrived_s = now
        idle = self._progress.step(now, self._plant.position, result.goal_m, waiting=not self._world.still)
        if result.contact:
            result.end = "contact"
        elif self._world.still and result.arrived_s is not None:
            result.end = "arrived"
        elif idle > STILL_S:
            result.end = "stuck"


def simulate(
    scene: Scene,
    name: str,
    planned: float | None,
    horizon_s: float,
    trace: Callable[[tuple[State, Array, Any]], object] | None = None,
) -> Outcome:
    """Let one method run through a scene; what it depends on is the arguments, solve times apart.

    Args:
        scene: The scene.
        name: Of the method.
        planned: Length of the planner's path [rad]; None where there is none.
        horizon_s: How long it lasts at most [s].
        trace: Takes ``(state, command, method)`` of every tick, where given.
    """
    it = Run(scene, name, planned)
    result = it.result
    while it.time_s < horizon_s and result.end == "late":
        told, command = it.tick()
        if trace is not None:
            trace((told, command, it.method))
    result.info |= info_of(it.method)
    if result.end != "arrived":
        result.arrived_s = None
    return result


def run(piece: Piece) -> Outcome:
    """Run one method through one scene."""
    scene = Scene.of(piece.scene["scene"])
    return simulate(scene, piece.method, piece.scene["planned"], piece.horizon_s)


__all__ = ["Outcome", "Piece", "run", "simulate"]

"""The service's filter in ``bench.avoidance``: alone, with its circulation, with the planner behind it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ssm_service.model import Robot
from ssm_service.monitor.filtering import Filtering
from ssm_service.monitor.methods import Methods
from ssm_service.motion.guide import PathGuide
from ssm_service.motion.path import Path
from ssm_service.motion.planner import plan

from .avoidance_state import PERIOD_S, PLANNER_CLEARANCE_M, State, snapshot_of

Array = NDArray[np.float64]

PLANNING_S = 2.0
"""How long a plan takes in simulated time; meanwhile the arm goes on without."""

PLANS = 8
PLANNER_STATES = 8_000
STUCK_S = 1.5
STUCK_M = 0.005


class Filter:
    """The service's quadratic programme with its circulation; ``planner``: with the planner behind it.

    Args:
        robot: The arm.
        circulating: Whether it goes round what blocks it.
        planner: Whether it plans when it is stuck.
    """

    def __init__(self, robot: Robot, *, circulating: bool = True, planner: bool = False) -> None:
        self._filtering = Filtering(robot, PERIOD_S)
        self._methods = Methods(robot, self._filtering.around if circulating else None)
        self.rescue = Rescue() if planner else None

    def velocity(self, state: State) -> Array:
        """Return the velocity that the programme leaves."""
        led = None if self.rescue is None else self.rescue.wanted(state)
        snapshot = snapshot_of(state, "filter", led)
        wanted = self._methods.wanted(snapshot)
        return self._filtering.step(
            snapshot, wanted, state.previous, state.speed_limit, state.sight.distances
        )


@dataclass(slots=True)
class Rescue:
    """Plans when the hand makes no progress, and follows the path.

    Attributes:
        plans: Plans made so far.
    """

    plans: int = 0
    _best: float = math.inf
    _since: float = 0.0
    _ready_s: float | None = None
    _path: Path | None = None
    _guide: PathGuide | None = None
    _arc: float = field(default=0.0)

    def wanted(self, state: State) -> Array | None:
        """Return the joint velocity along the path, (n,); None where there is none to follow."""
        self._watch(state)
        if self._ready_s is not None and state.time_s >= self._ready_s:
            self._ready_s = None
            self._guide = None if self._path is None else PathGuide(self._path)
            self._restart(state)
        if self._guide is None:
            return None
        speed = float(state.speed_limit[state.robot.free].min())
        wanted = self._guide.wanted(state.joints.position, speed)
        if not self._guide.valid:
            self._guide = None
            self._restart(state)
            return None
        return wanted

    def _restart(self, state: State) -> None:
        self._best, self._since, self._arc = math.inf, state.time_s, 0.0

    def _watch(self, state: State) -> None:
        """Ask for a plan where neither the goal nor the path's end came nearer for a while."""
        distance = float(np.linalg.norm(state.goal - state.end_effector))
        left = distance if self._guide is None else self._guide.remaining
        if left < self._best - (STUCK_M if self._guide is None else 0.02):
            self._best, self._since = left, state.time_s
        waited = state.time_s - self._since
        if distance < STUCK_M or self._ready_s is not None or waited < STUCK_S or self.plans >= PLANS:
            return
        self.plans += 1
        self._ready_s = state.time_s + PLANNING_S
        self._path = plan(
            state.robot,
            state.joints.position,
            state.goal,
            state.obstacles,
            clearance_m=PLANNER_CLEARANCE_M,
            seconds=7200.0,  # the states decide, on every machine
            seed=self.plans,
            states=PLANNER_STATES,
        )

"""The methods that ``bench.avoidance`` compares, each as ``velocity(state)``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ssm_service.config import ControllerName
from ssm_service.model import DistanceModel, Kinematics, Obstacle, Pairs, Robot
from ssm_service.monitor import JointSample, Target
from ssm_service.monitor.decision import Nearest
from ssm_service.monitor.filtering import Filtering
from ssm_service.monitor.methods import Methods
from ssm_service.monitor.snapshot import Snapshot
from ssm_service.motion.guide import PathGuide
from ssm_service.motion.path import Path
from ssm_service.motion.planner import plan

from .avoidance_peer import Pink

Array = NDArray[np.float64]

PERIOD_S = 0.008
"""Time from tick to tick [s]."""

PLANNER_CLEARANCE_M = 0.045
"""The planner keeps this distance: a little more than the filter's margin, so that its paths are passable."""

PLANNING_S = 2.0
"""How long a plan takes in simulated time; meanwhile the arm goes on without."""

PLANS = 8
PLANNER_STATES = 8_000
STUCK_S = 1.5
STUCK_M = 0.005


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """What a method is told at a tick.

    Attributes:
        robot: The arm.
        time_s: Time [s].
        dt: Time to the next command [s].
        joints: Joint state.
        kinematics: Frames and Jacobians.
        goal: (3,) [m].
        obstacles: As last tracked.
        pairs: Every link with every obstacle, by the hulls.
        distances: Measures some of them exactly.
        ranges: (m,) of the ring [m], or None before its first scan.
        previous: (n,) the last command [rad/s].
        speed_limit: (n,) of the zone [rad/s].
    """

    robot: Robot
    time_s: float
    dt: float
    joints: JointSample
    kinematics: Kinematics
    goal: Array
    obstacles: tuple[Obstacle, ...]
    pairs: Pairs
    distances: DistanceModel
    ranges: Array | None
    previous: Array
    speed_limit: Array

    @property
    def end_effector(self) -> Array:
        """Where the end effector is, (3,) [m]."""
        place: Array = self.kinematics.transform_end_effector_to_base[:3, 3]
        return place


class Method(Protocol):
    """One method; a new one for each scene."""

    def velocity(self, state: State) -> Array:
        """Return the wanted joint velocity, (n,) [rad/s]; all limits of the arm and the zone come after."""
        ...


class Service:
    """A method of the service that asks for a velocity and leaves the rest to the limits."""

    def __init__(self, robot: Robot, controller: ControllerName) -> None:
        self._methods = Methods(robot)
        self._controller = controller

    def velocity(self, state: State) -> Array:
        """Return what the service would want."""
        return self._methods.wanted(snapshot_of(state, self._controller))


def snapshot_of(state: State, controller: ControllerName, velocity: Array | None = None) -> Snapshot:
    """Return what the service's methods look at; with ``velocity``, a target of the joints' velocity."""
    if velocity is None:
        target = Target(kind="position", value=state.goal, controller=controller)
    else:
        target = Target(kind="joint_velocity", value=velocity, controller=controller)
    return Snapshot(
        kinematics=state.kinematics,
        joints=state.joints,
        target=target,
        nearest=_nearest(state.pairs),
        ranges=state.ranges,
        obstacles=state.obstacles,
        pairs=state.pairs,
    )


def _nearest(pairs: Pairs) -> Nearest | None:
    if not len(pairs):
        return None
    row = int(pairs.distance.argmin())
    return Nearest(
        source="obstacles",
        link=pairs.links[pairs.link[row]],
        obstacle=pairs.obstacles[pairs.obstacle[row]],
        distance=float(pairs.distance[row]),
        point_on_link=pairs.point_on_link[row],
        point_on_obstacle=pairs.point_on_obstacle[row],
        normal=pairs.normal[row],
    )


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
        snapshot = snapshot_of(state, "filter") if led is None else snapshot_of(state, "filter", led)
        wanted = self._methods.wanted(snapshot)
        return self._filtering.step(snapshot, wanted, state.previous, state.speed_limit, state.distances)


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
            seconds=120.0,
            seed=self.plans,
            states=PLANNER_STATES,
        )


METHODS: dict[str, Callable[[Robot], Method]] = {
    "field": lambda robot: Service(robot, "field"),
    "field3d": lambda robot: Service(robot, "field3d"),
    "clik-1": lambda robot: Service(robot, "clik-1"),
    "clik-2": lambda robot: Service(robot, "clik-2"),
    "clik-3": lambda robot: Service(robot, "clik-3"),
    "filter-only": lambda robot: Filter(robot, circulating=False),
    "filter": lambda robot: Filter(robot),
    "filter+planner": lambda robot: Filter(robot, planner=True),
    "pink": lambda robot: Pink(robot),
}


def info_of(method: Method) -> dict[str, Any]:
    """Return what a method has to say of itself after a run."""
    rescue = getattr(method, "rescue", None)
    return {"plans": rescue.plans if rescue is not None else 0, "failed": getattr(method, "failed", 0)}

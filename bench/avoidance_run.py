"""One scene with every method, each watched by the true distances."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ssm_service.model import DistanceModel, Kinematics, Obstacle, Pairs, Robot, closing_gradients, moved_by
from ssm_service.monitor import JointSample
from ssm_service.monitor.command import limited_velocity, zone_speed_limit
from ssm_service.motion.planner import plan
from ssm_service.motion.self_collision import SelfCollision
from ssm_service.perception import scan
from ssm_service.safety import Zone, ZoneProfile
from ssm_service.simulation import Plant
from ssm_service.simulation.schedule import Periodic

from .avoidance_methods import METHODS, PERIOD_S, PLANNER_CLEARANCE_M, State, info_of
from .avoidance_scenes import REST, Scene, World, draw, end_effector, robot

Array = NDArray[np.float64]

TRACKER_S = 1.0 / 30.0
HORIZON_S = 40.0
ARRIVED_M = 0.005
STANDING_M_S = 1e-3
STILL_S = 6.0
STILL_RAD = 0.01
AS_FAST_AS_MAY = 0.8
"""A link that retreats with this share of what it may has done what it could."""

THREATENED_M = 0.05
"""Nearer than this to something that comes, a link is about to be touched."""

ITSELF_TICKS = 5
"""So many ticks apart it is looked whether the arm touches itself."""

PLAN_SECONDS = 240.0
PLAN_STATES = 200_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """One scene of a run.

    Attributes:
        seed: Of all scenes.
        number: Of the scene.
        methods: What is tried, of ``METHODS``.
        horizon_s: How long a run lasts at most [s].
    """

    seed: int
    number: int
    methods: tuple[str, ...]
    horizon_s: float = HORIZON_S


@dataclass(slots=True, kw_only=True)
class Outcome:
    """What one method did in one scene.

    Attributes:
        number: Of the scene.
        kind: Of the scene.
        method: Its name.
        possible: Whether the planner knows a path past everything that stands.
        blocked: Whether the straight motion is blocked by what stands.
        arrived_s: When the goal was reached for good [s]; None where it was not.
        end: ``arrived``, ``contact``, ``stuck`` (stands still) or ``late``.
        contact: ``drove`` into something, or was ``yielding`` less than it could; empty for neither.
        where: Link, obstacle, time, closing speed and what was possible, of the contact.
        apart: Contacts of an obstacle with a link that retreated as fast as it might or could not.
        least_m: The least distance until the end [m].
        path: Length of the way in joint space [rad].
        planned: Length of the planner's path [rad]; None where there is none.
        instants: Ticks.
        over: Ticks with a joint faster than its zone allows, by more than 1 %.
        itself: Looks at which the arm touched itself, by the hulls of links that no joint joins.
        goal_m: Distance to the goal at the end [m].
        times_us: Solve times [µs].
        info: What the method has to say.
    """

    number: int
    kind: str
    method: str
    possible: bool
    blocked: bool
    planned: float | None
    arrived_s: float | None = None
    end: str = "late"
    contact: str = ""
    where: str = ""
    apart: int = 0
    least_m: float = math.inf
    path: float = 0.0
    instants: int = 0
    over: int = 0
    itself: int = 0
    goal_m: float = math.inf
    times_us: list[float] = field(default_factory=list)
    info: dict[str, Any] = field(default_factory=dict)


class Eyes:
    """Distances to a set of obstacles, measured anew only where something has changed."""

    def __init__(self, arm: Robot) -> None:
        self.distances = DistanceModel(arm)
        self._obstacles: tuple[Obstacle, ...] = ()

    def pairs(self, obstacles: tuple[Obstacle, ...], position: Array) -> Pairs:
        """Return all pairs by the hulls."""
        if obstacles is not self._obstacles:
            self.distances.set_obstacles(obstacles)
            self._obstacles = obstacles
        return self.distances.pairs(position)

    def refine(self, pairs: Pairs, rows: Sequence[int]) -> None:
        """Measure some of the last pairs to the triangles."""
        self.distances.refine(pairs, rows)


class Watch:
    """Looks at the true arm among the true obstacles."""

    def __init__(self, arm: Robot) -> None:
        self._arm = arm
        self._eyes = Eyes(arm)
        self._moved = np.array([moved_by(arm, link) for link in arm.monitored_links])
        self.profile = ZoneProfile(name="avoidance", config=arm.config.file.profiles["avoidance"])
        self._touching: set[tuple[int, str]] = set()

    def begin(self) -> None:
        """Forget the run before."""
        self._touching = set()

    def limit_at(self, distance: float) -> Array:
        """Return each joint's speed limit at a distance [m], (n,); in contact that of red, to get free."""
        zone = min(self.profile.zone_at(distance), Zone.RED)
        return zone_speed_limit(self._arm, self.profile, Zone(zone))

    def look(self, plant: Plant, obstacles: tuple[Obstacle, ...], state: State, into: Outcome) -> None:
        """Look at one instant; ``state`` is what the method was told last."""
        pairs = self._eyes.pairs(obstacles, plant.position)
        into.instants += 1
        if not len(pairs):
            return
        rows = (pairs.distance < into.least_m).nonzero()[0]
        if len(rows):
            self._eyes.refine(pairs, rows.tolist())
            into.least_m = min(into.least_m, float(pairs.distance[rows].min()))
        limit = self.limit_at(float(pairs.distance.min()))
        into.over += bool((np.abs(plant.velocity) > 1.01 * limit + 1e-4).any())
        near = (pairs.distance <= 0.0).nonzero()[0]
        self._eyes.refine(pairs, [int(row) for row in near if not pairs.exact[row]])
        touching = set()
        for row in near:
            if pairs.distance[row] > 0.0:
                continue
            key = (int(pairs.link[row]), pairs.obstacles[pairs.obstacle[row]])
            touching.add(key)
            if key not in self._touching:
                self._judge(int(row), pairs, plant, obstacles, state, into)
        self._touching = touching

    def _judge(
        self,
        row: int,
        pairs: Pairs,
        plant: Plant,
        obstacles: tuple[Obstacle, ...],
        state: State,
        into: Outcome,
    ) -> None:
        """Say whose fault a new contact is."""
        near = (pairs.distance < 0.1).nonzero()[0]
        spatial = self._arm.kinematics(plant.position).spatial_jacobian
        gradients = closing_gradients(
            spatial, self._moved[pairs.link[near]], pairs.point_on_link[near], pairs.normal[near]
        )
        own = int((near == row).nonzero()[0][0])
        gradient = gradients[own]
        closing = float(gradient @ plant.velocity)
        velocity = np.array(obstacles[pairs.obstacle[row]].velocity or (0.0, 0.0, 0.0))
        comes = float(pairs.normal[row] @ velocity)
        config = self._arm.config.file.motion.filter
        speeds = np.array([one.velocity or (0.0, 0.0, 0.0) for one in obstacles])
        coming = np.einsum("ij,ij->i", pairs.normal[near], speeds[pairs.obstacle[near]]) > STANDING_M_S
        threatened = coming & (pairs.distance[near] < THREATENED_M)
        admitted = config.approach_gain * pairs.distance[near].clip(0.0)
        # What else is about to be touched must not retreat more slowly for it.
        admitted[threatened] = np.minimum(admitted, gradients @ plant.velocity)[threatened]
        others, admitted = np.delete(gradients, own, axis=0), np.delete(admitted, own)
        margin = self._arm.config.file.limits.position_margin_rad
        room_below = plant.position > self._arm.position_lower + margin
        room_above = plant.position < self._arm.position_upper - margin
        limit = state.speed_limit
        bounds = np.column_stack([np.where(room_below, -limit, 0.0), np.where(room_above, limit, 0.0)])
        best = linprog(gradient, A_ub=others, b_ub=admitted, bounds=bounds, method="highs")
        might = -float(best.fun) if best.success else 0.0
        where = (
            f"{pairs.links[pairs.link[row]]} and {pairs.obstacles[pairs.obstacle[row]]} at "
            f"{state.time_s:.2f} s: link closes at {closing:.3f}, might retreat at {might:.3f}, "
            f"obstacle comes at {comes:.3f} m/s"
        )
        if comes > STANDING_M_S and (might < 0.005 or -closing >= AS_FAST_AS_MAY * might):
            into.apart += 1
            into.info.setdefault("apart", where)
        elif not into.contact:
            into.contact = "drove" if closing > STANDING_M_S else "yielding"
            into.where = where


@cache
def _watch() -> Watch:
    return Watch(robot())


@cache
def _itself() -> SelfCollision:
    return SelfCollision(robot(), REST)


@cache
def _eyes() -> Eyes:
    return Eyes(robot())


def _scanned(kinematics: Kinematics, obstacles: tuple[Obstacle, ...]) -> Array:
    """Return what the ring reads of the obstacles, (m,) [m]; echoes of the arm itself are left out."""
    ring = robot().rings[0]
    return scan(
        obstacles, kinematics.transform_sensors_to_base, ring.half_angle, ring.range_max, ring.range_min
    )


def simulate(
    scene: Scene, name: str, planned: float | None, horizon_s: float, trace: list[Any] | None = None
) -> Outcome:
    """Let one method run through a scene.

    Args:
        scene: The scene.
        name: Of the method.
        planned: Length of the planner's path [rad]; None where there is none.
        horizon_s: How long it lasts at most [s].
        trace: Takes ``(state, command, method)`` of every tick, where given.
    """
    arm, watch, eyes = robot(), _watch(), _eyes()
    world, plant, method = World(scene), Plant(arm, scene.start), METHODS[name](arm)
    ring = Periodic(arm.rings[0].period)
    tracker = Periodic(TRACKER_S)
    result = Outcome(
        number=scene.number,
        kind=scene.kind,
        method=name,
        possible=planned is not None,
        blocked=scene.blocked,
        planned=planned,
    )
    pending = previous = np.zeros(len(arm.joint_names))
    seen: tuple[Obstacle, ...] = ()
    ranges: Array | None = None
    truth = world.obstacles()
    stood = scene.start, 0.0
    watch.begin()
    while world.time_s < horizon_s:
        now = world.time_s
        if tracker.due(now):
            seen = truth
        kinematics = arm.kinematics(plant.position)
        if name == "field3d" and ring.due(now):
            ranges = _scanned(kinematics, truth)
        pairs = eyes.pairs(seen, plant.position)
        state = State(
            robot=arm,
            time_s=now,
            dt=PERIOD_S,
            joints=JointSample(position=plant.position.copy(), velocity=plant.velocity.copy()),
            kinematics=kinematics,
            goal=scene.goal,
            obstacles=seen,
            pairs=pairs,
            distances=eyes.distances,
            ranges=ranges,
            previous=previous,
            speed_limit=watch.limit_at(float(pairs.distance.min(initial=math.inf))),
        )
        begin = time.perf_counter_ns()
        wanted = method.velocity(state)
        result.times_us.append(1e-3 * (time.perf_counter_ns() - begin))
        command = limited_velocity(
            arm,
            wanted,
            previous=previous,
            position=plant.position,
            speed_limit=state.speed_limit,
            period_s=PERIOD_S,
        )
        if trace is not None:
            trace.append((state, command, method))
        watch.look(plant, truth, state, result)
        if result.instants % ITSELF_TICKS == 0:
            result.itself += _itself().touches(plant.position)
        before = plant.position
        plant.step(pending, PERIOD_S)  # what was decided a tick ago
        result.path += float(np.linalg.norm(plant.position - before))
        hand = state.end_effector
        world.step(hand, PERIOD_S)
        if not world.still or truth is seen:
            truth = truth if world.still and len(truth) == len(scene.fixed) else world.obstacles()
        pending = previous = command
        result.goal_m = float(np.linalg.norm(hand - scene.goal))
        if result.goal_m > ARRIVED_M:
            result.arrived_s = None
        elif result.arrived_s is None:
            result.arrived_s = now
        if float(np.abs(plant.position - stood[0]).max()) > STILL_RAD or not world.still:
            stood = plant.position.copy(), now
        if result.contact:
            result.end = "contact"
            break
        if world.still and result.arrived_s is not None:
            result.end = "arrived"
            break
        if now - stood[1] > STILL_S:
            result.end = "stuck"
            break
    result.info |= info_of(method)
    if result.end != "arrived":
        result.arrived_s = None
    return result


def run(piece: Piece) -> list[Outcome]:
    """Run one scene with all methods; it depends on nothing but the piece, solve times apart."""
    scene = draw(piece.seed, piece.number)
    path = plan(
        robot(),
        scene.start,
        scene.goal,
        scene.fixed,
        clearance_m=PLANNER_CLEARANCE_M,
        seconds=PLAN_SECONDS,
        seed=piece.number,
        states=PLAN_STATES,
    )
    planned = None if path is None else path.length
    return [simulate(scene, name, planned, piece.horizon_s) for name in piece.methods]


__all__ = ["Outcome", "Piece", "end_effector", "run", "simulate"]

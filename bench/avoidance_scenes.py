"""Random scenes for ``bench.avoidance``: a start, a goal, things that stand, cross and chase."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.motion import damped_pseudo_inverse
from ssm_service.motion.fields import free_speed
from ssm_service.motion.self_collision import SelfCollision

Array = NDArray[np.float64]

KINDS = ("static", "crossing", "chasing")
MOST = 8
CLEAR_M = 0.08
"""Least distance of everything to the arm at the start and at the goal."""

BASE_M = 0.22
"""Nothing that moves comes nearer than this to the axis of the base, whose links cannot move away."""

WALLS = 0.5
"""Share of the things in the way that are plates across it."""

REST = np.array([0.0, -1.57, 0.0, -1.57, 0.0, 0.0])
_SPREAD = np.array([math.pi, 1.3, 2.4, math.pi, math.pi, math.pi])
_LOW, _HIGH = np.array([-0.7, -0.7, 0.0]), np.array([0.7, 0.7, 0.8])
_STEP_S = 0.05
_AWAY_M = 1.4
_LEAVING_M_S = 0.4
_TRIES = 80


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mover:
    """Something that moves.

    Attributes:
        obstacle: Its shape, and where it begins.
        velocity: (3,) of one that crosses [m/s].
        speed_m_s: Of one that chases; 0 for one that crosses.
        until_s: When one that chases gives up and leaves [s].
    """

    obstacle: Obstacle
    velocity: Array
    speed_m_s: float = 0.0
    until_s: float = 0.0

    def velocity_at(self, time_s: float, position: Array, end_effector: Array) -> Array:
        """Return its velocity, (3,) [m/s], where it is now.

        One that chases heads for the end effector, but never into the base, and leaves outwards in the end.
        """
        if self.speed_m_s == 0.0:
            return self.velocity
        outwards = np.array([position[0], position[1], 0.0])
        outwards /= max(float(np.linalg.norm(outwards)), 1e-9)
        if time_s >= self.until_s:
            return _LEAVING_M_S * outwards
        towards = end_effector - position
        distance = float(np.linalg.norm(towards))
        wanted: Array = towards * (self.speed_m_s / max(distance, self.speed_m_s * _STEP_S))
        inwards = -float(wanted @ outwards)
        if math.hypot(*position[:2]) <= BASE_M + reach(self.obstacle) and inwards > 0.0:
            wanted = wanted + inwards * outwards
        return wanted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """One scene.

    Attributes:
        number: Its number.
        kind: Of ``KINDS``.
        start: (6,) [rad].
        goal: (3,) position of the end effector [m].
        fixed: What stands.
        movers: What moves.
        blocked: Whether the straight motion of the end effector, unavoidingly followed, touches what stands.
    """

    number: int
    kind: str
    start: Array
    goal: Array
    fixed: tuple[Obstacle, ...]
    movers: tuple[Mover, ...]
    blocked: bool


class World:
    """The obstacles of a scene in the course of time.

    Attributes:
        time_s: Time since the start.
    """

    def __init__(self, scene: Scene) -> None:
        self.time_s = 0.0
        self._fixed = tuple([replace(one, velocity=(0.0, 0.0, 0.0)) for one in scene.fixed])
        self._movers = [[one, np.array(one.obstacle.position), one.velocity] for one in scene.movers]

    @property
    def still(self) -> bool:
        """Whether everything that moves is gone."""
        return not self._movers

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return all obstacles now, with their velocities."""
        moving = [
            replace(one.obstacle, position=tuple(place.tolist()), velocity=tuple(velocity.tolist()))
            for one, place, velocity in self._movers
        ]
        return (*self._fixed, *moving)

    def step(self, end_effector: Array, dt: float) -> None:
        """Move everything on by ``dt`` [s], with the end effector at (3,) [m]; what is far away is gone."""
        for mover in self._movers:
            mover[2] = mover[0].velocity_at(self.time_s, mover[1], end_effector)
            mover[1] = mover[1] + mover[2] * dt
        self.time_s += dt
        self._movers = [m for m in self._movers if not _gone(m[1], m[2])]


def _gone(position: Array, velocity: Array) -> bool:
    return float(np.linalg.norm(position)) > _AWAY_M and float(position @ velocity) > 0.0


@cache
def robot() -> Robot:
    """Return the arm of all scenes."""
    return Robot.load(Path(__file__).with_name("avoidance_robot.toml"))


@cache
def _distances() -> DistanceModel:
    return DistanceModel(robot())


@cache
def _itself() -> SelfCollision:
    return SelfCollision(robot(), REST)


def reach(obstacle: Obstacle) -> float:
    """Return the radius of the ball round an obstacle [m]."""
    if obstacle.shape in ("capsule", "cylinder"):
        return obstacle.size[0] + 0.5 * obstacle.size[1]
    return obstacle.radius


def end_effector(position: Array) -> Array:
    """Return where the end effector is, (3,) [m]."""
    place: Array = robot().kinematics(position).transform_end_effector_to_base[:3, 3]
    return place


def draw(seed: int, number: int) -> Scene:
    """Return a scene; its kind goes round with its number."""
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    # Drawn once: scenes with something in the way are refused more often.
    blocker = rng.random() < (0.9 if kind == "static" else 0.4)
    while True:
        start, goal = _pose(rng), _pose(rng)
        way = straight_motion(start, end_effector(goal))
        if way is None or straight_motion(start, end_effector(goal), turning=False) is None:
            continue
        count = int(rng.integers(1, MOST + 1))
        movers = [] if kind == "static" else _movers(kind, rng, way, min(count, 2), start)
        if kind != "static" and not movers:
            continue
        fixed = _fixed(rng, way, count - len(movers), blocker, start, goal)
        if len(fixed) + len(movers) == count:
            return Scene(
                number=number,
                kind=kind,
                start=start,
                goal=end_effector(goal),
                fixed=tuple(fixed),
                movers=tuple(movers),
                blocked=_touched(fixed, way),
            )


def _pose(rng: np.random.Generator) -> Array:
    """Return a joint position, (6,), with the hand above the table, off the base, not touching itself."""
    while True:
        position = REST + rng.uniform(-1.0, 1.0, 6) * _SPREAD
        place = end_effector(position)
        if place[2] > 0.1 and math.hypot(*place[:2]) > 0.2 and not _itself().touches(position):
            return position


def straight_motion(start: Array, goal: Array, *, turning: bool = True) -> Array | None:
    """Return the joint positions every 50 ms, (t, 6), of the straight motion to a goal, (3,) [m], or None.

    None where the motion is short or long, meets the arm's own limits or links, or does not arrive. Without
    ``turning`` the hand keeps its orientation, as the modes of CLIK do.
    """
    arm, config = robot(), robot().config.file.motion
    rows = 3 if turning else 6
    distance = float(np.linalg.norm(goal - end_effector(start)))
    if not 0.3 <= distance <= 0.8:
        return None
    way = [start]
    for _ in range(round(3.0 * distance / config.speed_m_s / _STEP_S)):
        kinematics = arm.kinematics(way[-1])
        error = goal - kinematics.transform_end_effector_to_base[:3, 3]
        left = float(np.linalg.norm(error))
        if left < 0.005:
            return np.array(way)
        inverse = damped_pseudo_inverse(
            kinematics.jacobian_full[:rows],
            threshold=config.singular_value_threshold,
            max_damping=config.max_damping,
        )
        step = inverse[:, :3] @ (error * (free_speed(left, config) / left)) * _STEP_S
        if float(np.abs(step).max()) > 1.0 * _STEP_S:
            return None
        way.append(way[-1] + step)
        if not _within(way[-1]) or _itself().touches(way[-1]):
            return None
    return None


def _within(position: Array) -> bool:
    margin = 0.1
    arm = robot()
    return bool(np.all((arm.position_lower + margin < position) & (position < arm.position_upper - margin)))


def _shape(rng: np.random.Generator, name: str, shapes: tuple[str, ...], position: Array) -> Obstacle:
    shape = shapes[int(rng.integers(len(shapes)))]
    size = {
        "sphere": lambda: (rng.uniform(0.03, 0.12),),
        "box": lambda: tuple(rng.uniform(0.05, 0.3, 3)),
        "capsule": lambda: (rng.uniform(0.03, 0.07), rng.uniform(0.1, 0.5)),
    }[shape]()
    turned = rng.normal(size=4)
    turned /= np.linalg.norm(turned)
    return Obstacle(
        id=name,
        shape=shape,
        size=tuple(map(float, size)),
        position=tuple(position.tolist()),
        quaternion_xyzw=tuple(turned.tolist()),
    )


def _wall(rng: np.random.Generator, name: str, way: Array) -> Obstacle:
    """Return a plate across the way of the hand: in front of it lies a local minimum of every field."""
    index = int(rng.uniform(0.3, 0.7) * (len(way) - 1))
    before, after = end_effector(way[index]), end_effector(way[index + 1])
    across = after - before + rng.normal(0.0, 0.2, 3) * np.linalg.norm(after - before)
    one, other = rng.normal(size=(2, 3))
    frame, _ = np.linalg.qr(np.column_stack([across, one, other]))
    frame[:, 2] *= np.linalg.det(frame)
    size = (rng.uniform(0.02, 0.06), rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6))
    return Obstacle(
        id=name,
        shape="box",
        size=size,
        position=tuple((before + rng.normal(0.0, 0.05, 3)).tolist()),
        quaternion_xyzw=tuple(Rotation.from_matrix(frame).as_quat().tolist()),
    )


def _on_the_way(rng: np.random.Generator, way: Array) -> tuple[int, Array]:
    """Return a moment of the motion and a place at or near the moving half of the arm, (3,) [m]."""
    index = int(rng.uniform(0.3, 0.7) * (len(way) - 1))
    links = robot().link_transforms(way[index])
    wrist, hand = links["wrist_1_link"][:3, 3], links["tool0"][:3, 3]
    elbow = links["forearm_link"][:3, 3]
    share = rng.uniform(0.0, 1.0)
    place = hand + share * (wrist - hand) if rng.random() < 0.6 else wrist + share * 0.8 * (elbow - wrist)
    return index, place + rng.normal(0.0, 0.02, 3)


def _fixed(
    rng: np.random.Generator, way: Array, count: int, blocker: bool, start: Array, goal: Array
) -> list[Obstacle]:
    """Return so many things that stand clear of start and goal, the first of them in the way if wanted."""
    found: list[Obstacle] = []
    for _ in range(_TRIES):
        if len(found) == count:
            break
        blocking, name = blocker and not found, f"fixed{len(found)}"
        if blocking and rng.random() < WALLS:
            one = _wall(rng, name, way)
        else:
            place = _on_the_way(rng, way)[1] if blocking else rng.uniform(_LOW, _HIGH)
            one = _shape(rng, name, ("sphere", "box", "capsule"), place)
        clear = min(_least([one], start), _least([one], goal)) >= CLEAR_M
        if clear and (not blocking or _touched([one], way[::3])):
            found.append(one)
    return found


def _movers(kind: str, rng: np.random.Generator, way: Array, most: int, start: Array) -> list[Mover]:
    """Return one or two things that move."""
    wanted, found = int(rng.integers(1, most + 1)), []
    for _ in range(_TRIES):
        if len(found) == wanted:
            break
        make = _crossing if kind == "crossing" else _chasing
        one = make(rng, way, f"mover{len(found)}")
        if one is not None and _least([one.obstacle], start) >= 2.0 * CLEAR_M:
            found.append(one)
    return found


def _crossing(rng: np.random.Generator, way: Array, name: str) -> Mover | None:
    """Return one that flies straight through the place where the arm would be at that moment."""
    index, through = _on_the_way(rng, way)
    direction = rng.normal(size=3) * [1.0, 1.0, 0.5]
    direction /= np.linalg.norm(direction)
    velocity = direction * rng.uniform(0.08, 0.35)
    one = _shape(rng, name, ("sphere", "capsule"), through - velocity * index * _STEP_S)
    flat = velocity[:2]
    nearest = abs(float(flat[0] * through[1] - flat[1] * through[0])) / float(np.linalg.norm(flat))
    return Mover(obstacle=one, velocity=velocity) if nearest >= BASE_M + reach(one) else None


def _chasing(rng: np.random.Generator, way: Array, name: str) -> Mover | None:
    """Return one that comes from outside and follows the hand for a while."""
    angle = rng.uniform(-math.pi, math.pi)
    radius = rng.uniform(0.4, 0.8)
    place = np.array([radius * math.cos(angle), radius * math.sin(angle), rng.uniform(0.1, 0.6)])
    one = _shape(rng, name, ("sphere",), place)
    return Mover(
        obstacle=one,
        velocity=np.zeros(3),
        speed_m_s=float(rng.uniform(0.05, 0.2)),
        until_s=float(rng.uniform(4.0, 10.0)),
    )


def _least(obstacles: list[Obstacle], position: Array) -> float:
    if not obstacles:
        return math.inf
    _distances().set_obstacles(obstacles)
    return float(_distances().bounds(position).min())


def _touched(obstacles: list[Obstacle], way: Array) -> bool:
    # The middle first: start and goal are clear.
    order = np.argsort(np.abs(np.arange(len(way)) - 0.5 * len(way)))
    return any(_least(obstacles, way[index]) <= 0.0 for index in order)

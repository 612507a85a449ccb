"""What stands and what moves in the scenes of ``bench.avoidance``, drawn round the arm's straight motion."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssm_service.model import DistanceModel, Obstacle

from .avoidance_scenes import BASE_M, STEP_S, Mover, end_effector, reach, robot

Array = NDArray[np.float64]

CLEAR_M = 0.08
"""Least distance of everything to the arm at the start and at the goal."""

WALLS = 0.5
"""Share of the things in the way that are plates across it."""

_LOW, _HIGH = np.array([-0.7, -0.7, 0.0]), np.array([0.7, 0.7, 0.8])
_TRIES = 80


@cache
def _distances() -> DistanceModel:
    return DistanceModel(robot())


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


def standing(
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
        clear = keeps([one], start, CLEAR_M) and keeps([one], goal, CLEAR_M)
        if clear and (not blocking or touched([one], way[::3])):
            found.append(one)
    return found


def moving(kind: str, rng: np.random.Generator, way: Array, most: int, start: Array) -> list[Mover]:
    """Return one or two things that move."""
    wanted, found = int(rng.integers(1, most + 1)), []
    for _ in range(_TRIES):
        if len(found) == wanted:
            break
        make = _crossing if kind == "crossing" else _chasing
        one = make(rng, way, f"mover{len(found)}")
        if one is not None and keeps([one.obstacle], start, 2.0 * CLEAR_M):
            found.append(one)
    return found


def _crossing(rng: np.random.Generator, way: Array, name: str) -> Mover | None:
    """Return one that flies straight through the place where the arm would be at that moment."""
    index, through = _on_the_way(rng, way)
    direction = rng.normal(size=3) * [1.0, 1.0, 0.5]
    direction /= np.linalg.norm(direction)
    velocity = direction * rng.uniform(0.08, 0.35)
    one = _shape(rng, name, ("sphere", "capsule"), through - velocity * index * STEP_S)
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


def forget() -> None:
    """Begin anew: Coal begins each search where the last one ended, which shows in the last digits."""
    _distances.cache_clear()


def keeps(obstacles: list[Obstacle], position: Array, clearance: float) -> bool:
    """Return whether all obstacles keep a distance [m] from the arm, by its hulls."""
    _distances().set_obstacles(obstacles)
    return _distances().keeps(position, clearance)


def touched(obstacles: list[Obstacle], way: Array) -> bool:
    """Return whether an obstacle touches the arm on a way, (t, 6), by its hulls."""
    # The middle first: start and goal are clear.
    order = np.argsort(np.abs(np.arange(len(way)) - 0.5 * len(way)))
    return any(not keeps(obstacles, way[index], 0.0) for index in order)

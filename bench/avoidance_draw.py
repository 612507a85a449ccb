"""Draws the scenes of ``bench.avoidance``, and asks the planner which of them are possible."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssm_service.motion import damped_pseudo_inverse
from ssm_service.motion.fields import free_speed
from ssm_service.motion.planner import plan
from ssm_service.motion.self_collision import SelfCollision

from .avoidance_scenes import KINDS, REST, STEP_S, Scene, end_effector, robot
from .avoidance_state import PLANNER_CLEARANCE_M
from .avoidance_things import forget, moving, standing, touched

Array = NDArray[np.float64]

MOST = 8
PLAN_SECONDS = 7200.0
"""So long that the number of states decides: the same path, or none, on every machine."""

PLAN_STATES = 200_000

_SPREAD = np.array([math.pi, 1.3, 2.4, math.pi, math.pi, math.pi])


@cache
def _itself() -> SelfCollision:
    return SelfCollision(robot(), REST)


def drawn(seed: int, number: int) -> dict[str, Any]:
    """Return a scene and the length of the planner's path [rad], None where there is none, as JSON values."""
    forget()
    scene = draw(seed, number)
    path = plan(
        robot(),
        scene.start,
        scene.goal,
        scene.fixed,
        clearance_m=PLANNER_CLEARANCE_M,
        seconds=PLAN_SECONDS,
        seed=number,
        states=PLAN_STATES,
    )
    return {"scene": scene.to_builtins(), "planned": None if path is None else path.length}


def draw(seed: int, number: int) -> Scene:
    """Return a scene; its kind goes round with its number."""
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    # Drawn once: scenes with something in the way are refused more often.
    blocker = rng.random() < (0.9 if kind == "static" else 0.4)
    while True:
        start, goal = _pose(rng), _pose(rng)
        # What rarely succeeds and costs least comes first.
        way, stiff = _way(start, end_effector(goal), 3), None
        if way is not None:
            stiff = _way(start, end_effector(goal), 6)
        if way is None or stiff is None or _touches_itself(way) or _touches_itself(stiff):
            continue
        count = int(rng.integers(1, MOST + 1))
        movers = [] if kind == "static" else moving(kind, rng, way, min(count, 2), start)
        if kind != "static" and not movers:
            continue
        fixed = standing(rng, way, count - len(movers), blocker, start, goal)
        if len(fixed) + len(movers) == count:
            return Scene(
                number=number,
                kind=kind,
                start=start,
                goal=end_effector(goal),
                fixed=tuple(fixed),
                movers=tuple(movers),
                blocked=touched(fixed, way),
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
    way = _way(start, goal, 3 if turning else 6)
    return None if way is None or _touches_itself(way) else way


def _touches_itself(way: Array) -> bool:
    return any(_itself().touches(position) for position in way[1:])


def _way(start: Array, goal: Array, rows: int) -> Array | None:
    """Return the straight motion that keeps so many rows of the Jacobian, whatever links it meets."""
    arm, config = robot(), robot().config.file.motion
    distance = float(np.linalg.norm(goal - end_effector(start)))
    if not 0.3 <= distance <= 0.8:
        return None
    way = [start]
    for _ in range(round(3.0 * distance / config.speed_m_s / STEP_S)):
        kinematics = arm.kinematics(way[-1])
        error = goal - kinematics.transform_end_effector_to_base[:3, 3]
        left = math.hypot(*error.tolist())
        if left < 0.005:
            return np.array(way)
        inverse = damped_pseudo_inverse(
            kinematics.jacobian_full[:rows],
            threshold=config.singular_value_threshold,
            max_damping=config.max_damping,
        )
        step = inverse[:, :3] @ (error * (free_speed(left, config) / left)) * STEP_S
        if max(map(abs, step.tolist())) > 1.0 * STEP_S:
            return None
        way.append(way[-1] + step)
        if not _within(way[-1]):
            return None
    return None


def _within(position: Array) -> bool:
    margin = 0.1
    arm = robot()
    return bool(np.all((arm.position_lower + margin < position) & (position < arm.position_upper - margin)))

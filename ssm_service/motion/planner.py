"""A way round obstacles in joint space, by a sampling planner: what is behind a controller that is stuck.

RRT-Connect of OMPL, the optional extra ``planner``. It looks at the obstacles as they stand; whoever follows
the path still needs a filter for those that move.
"""

from __future__ import annotations

import ctypes
import importlib
import math
import time
from collections.abc import Sequence
from pathlib import Path as FilePath
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, SsmError
from ..model import Obstacle, Robot
from .free_space import FreeSpace
from .path import Path
from .shortening import shortened

RANGE_RAD = 0.8
"""Longest step of a tree [rad]."""

CHECKED_RAD = 0.05
"""A step of a tree is checked at places not farther apart than this [rad]; the path, finely."""

GOALS = 8
"""Joint positions for one position of the end effector that are looked for."""

_RESTARTS = 60
_STEPS = 40
_SHORTENED = 200


def plan(
    robot: Robot,
    start: ArrayLike,
    goal: ArrayLike,
    obstacles: Sequence[Obstacle],
    *,
    clearance_m: float,
    seconds: float,
    seed: int = 0,
    states: int = 1_000_000,
    joints: bool = False,
) -> Path | None:
    """Return a path without contact to a position of the end effector or of the joints, or None.

    Joints turn by at most half a turn either way from where they start, which reaches every pose of the arm.
    Self-collision counts, by the hulls. The same arguments give the same path where neither ``seconds`` ran
    out nor OMPL is a build whose generator cannot be seeded (Python's binding offers no way; the library
    does). The path is the first found, shortened: short, not shortest. None proves nothing.

    Args:
        robot: The robot; locked joints stay at ``start``.
        start: (n,) [rad or m].
        goal: (3,) of the end effector [m], base frame; (n,) [rad or m] with ``joints``.
        obstacles: What stands there.
        clearance_m: Least distance to all of them along the path, by the hulls, so that it is never less by
            the meshes. Where the arm starts nearer than that, the beginning may be as near as the start.
        seconds: Time for all [s].
        seed: Of everything drawn.
        states: Greatest number of joint positions that are checked: a limit that, unlike time, makes the
            same result on every machine.
        joints: Whether the goal is a joint position.

    Raises:
        SsmError: OMPL is not installed.
        InputError: ``wrong_length``, ``not_finite``, ``out_of_range``.
    """
    base, geometric, util = _ompl()
    begin = _vector("start", start, len(robot.joint_names))
    end = _vector("goal", goal, len(robot.joint_names) if joints else 3)
    if not (seconds > 0.0 and clearance_m >= 0.0 and states > 0):
        asked = {"seconds": seconds, "clearance_m": clearance_m, "states": states}
        raise InputError("out_of_range", "plan", asked, "seconds > 0, clearance_m ≥ 0, states > 0")
    deadline = time.monotonic() + seconds
    rng = np.random.default_rng(seed)
    space = FreeSpace(robot, begin, obstacles, clearance_m)

    def over() -> bool:
        """Tell whether states or time are used up."""
        return space.checked >= states or time.monotonic() >= deadline

    goals = [end] if joints else goal_positions(robot, begin, end, space, rng, over)
    goals = [one for one in goals if space.free(one)]
    if not goals:
        return None
    for one in goals:  # often nothing is in the way
        if space.edge_free(begin, one):
            return Path(waypoints=np.array([begin, one]), goal=None if joints else end)
    util.noOutputHandler()
    _seed_ompl(seed)
    found = _search(base, geometric, space, goals, over)
    if found is None:
        return None
    points = shortened(found, space.edge_free, rng, attempts=_SHORTENED, over=over)
    return Path(waypoints=points, goal=None if joints else end) if points is not None else None


def goal_positions(
    robot: Robot,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    space: FreeSpace,
    rng: np.random.Generator,
    over: Any,
) -> list[NDArray[np.float64]]:
    """Return joint positions, (n,) each, that bring the end effector to ``goal``, the nearest first.

    Damped Newton steps from the start and from positions drawn round it, more and more widely.
    """
    found: list[NDArray[np.float64]] = []
    free = robot.free
    for restart in range(_RESTARTS):
        if len(found) >= GOALS or over():
            break
        position = start.copy()
        position[free] += rng.normal(0.0, 3.0 * restart / _RESTARTS, len(free))
        position = np.clip(position, space.lower, space.upper)
        solution = _newton(robot, position, goal, space)
        if solution is not None and space.free(solution):
            found.append(solution)
    return sorted(found, key=lambda one: float(np.linalg.norm(one - start)))


def _newton(
    robot: Robot, position: NDArray[np.float64], goal: NDArray[np.float64], space: FreeSpace
) -> NDArray[np.float64] | None:
    free = robot.free
    for _ in range(_STEPS):
        kinematics = robot.kinematics(position)
        error = goal - kinematics.transform_end_effector_to_base[:3, 3]
        if math.hypot(*error.tolist()) <= 1e-5:
            return position
        jacobian = kinematics.jacobian
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-4 * np.eye(3), error)
        position = position.copy()
        position[free] += step * min(1.0, 0.5 / max(float(np.linalg.norm(step)), 1e-12))
        position = np.clip(position, space.lower, space.upper)
    return None


def _search(
    base: ModuleType,
    geometric: ModuleType,
    space: FreeSpace,
    goals: Sequence[NDArray[np.float64]],
    over: Any,
) -> NDArray[np.float64] | None:
    """Return the waypoints, (w, n), of the first path that RRT-Connect finds."""
    free = space.robot.free
    states = base.RealVectorStateSpace(len(free))
    bounds = base.RealVectorBounds(len(free))
    for index, joint in enumerate(free.tolist()):
        bounds.setLow(index, float(space.lower[joint]))
        bounds.setHigh(index, float(space.upper[joint]))
    states.setBounds(bounds)
    information = base.SpaceInformation(states)
    information.setStateValidityChecker(lambda state: space.free(space.whole(state[0 : len(free)])))
    information.setStateValidityCheckingResolution(CHECKED_RAD / states.getMaximumExtent())
    information.setup()

    def state_of(position: NDArray[np.float64]) -> Any:
        """Return the library's state of the free joints of a position (n,)."""
        state = states.allocState()
        state[0 : len(free)] = position[free].tolist()
        return state

    problem = base.ProblemDefinition(information)
    problem.addStartState(state_of(space.start))
    region = base.GoalStates(information)
    for goal in goals:
        region.addState(state_of(goal))
    problem.setGoal(region)
    planner = geometric.RRTConnect(information)
    planner.setRange(RANGE_RAD)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(over))
    if not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath().getStates()
    return np.array([space.whole(state[0 : len(free)]) for state in path])


def _ompl() -> tuple[ModuleType, ModuleType, ModuleType]:
    try:
        return (
            importlib.import_module("ompl.base"),
            importlib.import_module("ompl.geometric"),
            importlib.import_module("ompl.util"),
        )
    except ImportError as error:
        raise SsmError(
            "planning needs OMPL, which is not installed: pip install 'ssm-service[planner]'"
        ) from error


def _seed_ompl(seed: int) -> None:
    """Seed the generators that OMPL makes from now on, by the C++ library; its binding leaves this out."""
    folder = FilePath(str(importlib.import_module("ompl").__file__)).parent
    try:
        set_seed = ctypes.CDLL(str(folder / "libompl.so"))._ZN4ompl3RNG7setSeedEm
    except (OSError, AttributeError):
        return  # another build: other paths each time, as the docstring of `plan` says
    set_seed(ctypes.c_ulong(seed % 2**31 + 1))


def _vector(where: str, values: ArrayLike, length: int) -> NDArray[np.float64]:
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (length,):
        raise InputError("wrong_length", where, f"shape {vector.shape}", f"{length} numbers")
    if not np.isfinite(vector).all():
        raise InputError("not_finite", where, vector.tolist(), "finite numbers")
    return vector

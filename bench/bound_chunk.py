"""Pieces of the sweep of ``bench.bound``: scenes, held against Coal or against brute force."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ssm_service.model import LinkDistance, Robot
from ssm_service.perception import Bound, LowerBound

from .bound_scenes import SWEEP, draw, sensors
from .brute import Array, MeshTruth, least_ball
from .sweep import Arrays

AIMED = 0.8
TOLERANCE_M = 1e-9
LOOSE_M = 1e-3
PATIENCE = 8
CHUNK, DEAR, BRUTE = 1000, 100, 5
"""Scenes of a piece: of configurations with many scenes, of others, of brute force."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One piece: what ``work`` is given.

    Attributes:
        seed: Of the sweep.
        case: Place in ``SWEEP``.
        brute: Whether it is held against brute force, not against Coal.
        index: Its number among the pieces of its kind.
        count: Number of scenes.
    """

    seed: int
    case: int
    brute: bool
    index: int
    count: int


def tasks(seed: int, scenes: int, brute: int) -> list[Task]:
    """Return the pieces of so many scenes and so many of brute force over all configurations, interleaved."""
    whole = sum(case.part for case in SWEEP)
    searched = [number for number, case in enumerate(SWEEP) if case.error > 0.0]
    found: list[tuple[float, Task]] = []

    def add(case: int, kind: bool, count: int, size: int) -> None:
        pieces = math.ceil(count / size)
        for i in range(pieces):
            task = Task(seed=seed, case=case, brute=kind, index=i, count=min(size, count - i * size))
            found.append((i / pieces, task))

    for number, case in enumerate(SWEEP):
        add(
            number,
            False,
            max(1, round(scenes * case.part / whole)),
            CHUNK if case.part > whole / 20 else DEAR,
        )
    for place, number in enumerate(searched):
        add(number, True, (brute + len(searched) - 1 - place) // len(searched), BRUTE)
    return [task for _, task in sorted(found, key=lambda one: one[0])]


def work(task: Task) -> Arrays:
    """Do one piece; nothing but the task decides what comes out, the times excepted."""
    rng = np.random.default_rng([task.seed, task.case, int(task.brute), task.index])
    return _against_brute_force(task, rng) if task.brute else _against_coal(task, rng)


@cache
def _subject(number: int) -> tuple[LowerBound, MeshTruth]:
    """What a process builds once for each configuration."""
    case = SWEEP[number]
    robot, truth, surface = _link(case.robot, case.link)
    return LowerBound(sensors(robot, case.design, case.link), surface, case.assumptions), truth


@cache
def _link(name: str, link: str) -> tuple[Robot, MeshTruth, LinkDistance]:
    robot = Robot.load(name)
    return robot, MeshTruth(robot, link), LinkDistance(robot, link)


def _scenes(
    task: Task, count: int, echo: bool, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Return exactly ``count`` scenes, all with an echo if asked to: what ``draw`` returns."""
    case = SWEEP[task.case]
    robot, truth, _ = _link(case.robot, case.link)
    array = sensors(robot, case.design, case.link)
    pieces: list[Sequence[Array]] = []
    missing = count
    while missing > 0:
        drawn = draw(case, array, truth, missing + 20, rng, AIMED)
        kept = np.isfinite(drawn[0]).any(axis=1) if echo else np.ones(len(drawn[0]), dtype=np.bool_)
        pieces.append([part[kept][:missing] for part in drawn])
        missing -= len(pieces[-1][0])
    readings, distances, centres, radii = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return readings, distances, centres, radii


def _against_coal(task: Task, rng: np.random.Generator) -> Arrays:
    """Return ``echoes``, Coal's ``distance`` and the ``bound`` of each scene, and all of the bad ones."""
    bound, _ = _subject(task.case)
    readings, distances, centres, radii = _scenes(task, task.count, False, rng)
    begin = time.perf_counter()
    bounds = bound.of_many(readings)
    spent = time.perf_counter() - begin
    bad = violates(bounds, distances)
    return {
        "echoes": np.isfinite(readings).sum(axis=1),
        "distance": distances,
        "bound": bounds,
        "seconds": np.array([spent]),
        "bad.piece": np.full(int(bad.sum()), task.index),
        "bad.readings": readings[bad],
        "bad.centres": centres[bad],
        "bad.radii": radii[bad],
        "bad.distance": distances[bad],
        "bad.bound": bounds[bad],
    }


def violates(bounds: Array, distances: Array) -> NDArray[np.bool_]:
    """Return where a bound is above the distance, or says that there is no ball, (n,)."""
    bad: NDArray[np.bool_] = np.isnan(bounds) | (bounds > distances + TOLERANCE_M)
    return bad


def _against_brute_force(task: Task, rng: np.random.Generator) -> Arrays:
    """Return for each scene the ``excess`` of the nearest ball that brute force finds over the bound [m].

    The search is told where the scene's own balls are and the ball that the bound met, and has ``PATIENCE``
    more tries as long as it is 1 mm off.
    """
    bound, truth = _subject(task.case)
    case = SWEEP[task.case]
    array = sensors(_link(case.robot, case.link)[0], case.design, case.link)
    scans, _, centres, radii = _scenes(task, task.count, True, rng)
    excess, tries, limits = np.empty(len(scans)), np.zeros(len(scans)), np.empty(len(scans))
    for i, scan in enumerate(scans):
        found = bound.of(scan)
        limits[i] = math.nan if found.distance is None else found.distance
        there = np.isfinite(radii[i])
        hints = _with(found, (centres[i][there], radii[i][there]))
        if case.many:
            hints = _with(bound.of(np.full(len(scan), math.inf)), hints)
        nearest = math.inf
        while tries[i] <= PATIENCE and (tries[i] == 0 or nearest - limits[i] > LOOSE_M):
            least = least_ball(truth, array, case.assumptions, scan, rng, hints)
            if least.distance < nearest:
                nearest = least.distance
                hints = np.vstack([hints[0], least.centre]), np.append(hints[1], least.radius)
            tries[i] += 1
        excess[i] = nearest - limits[i]
    return {"excess": excess, "bound": limits, "tries": tries, "readings": scans}


def _with(found: Bound, hints: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return centres and radii of balls, and of the one that a bound met, if it did."""
    if found.centre is None or found.radius is None:
        return hints
    return np.vstack([hints[0], found.centre]), np.append(hints[1], found.radius)

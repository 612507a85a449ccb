"""Both implementations of the decision side by side, tick by tick."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from ssm_service.errors import SsmError
from ssm_service.model import Robot
from ssm_service.monitor import Monitor

from .decision_mutants import MUTANTS, planted
from .decision_scenes import VARIANTS, Scenes, SlowArm, near_an_edge, slow_monitor, write_robot
from .decision_ticks import Sequence, differences

PERIODS_S = (0.002, 0.004, 0.008)
RENEW = 4000
"""Ticks after which other postures and obstacles are drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One piece of work: so many ticks of one robot file and profile.

    Attributes:
        variant: Which of ``VARIANTS``.
        seed: Of everything drawn.
        ticks: How many.
        mutant: Which of ``MUTANTS`` is planted in the monitor; None: it is as it is.
        count: Postures, and sets of obstacles.
    """

    variant: int
    seed: int
    ticks: int
    mutant: int | None = None
    count: int = 8


@dataclass(slots=True, kw_only=True)
class Outcome:
    """What came out.

    Attributes:
        variant: Which of ``VARIANTS``.
        ticks: How many were compared.
        edges: Ticks so near to an edge that either answer is right.
        zones: Ticks by zone in force.
        different: The first ticks that differ: number, differences, and the tick.
        first: Number of the first tick that differs, from 1; None where none does.
    """

    variant: int
    ticks: int = 0
    edges: int = 0
    zones: dict[str, int] = field(default_factory=dict)
    different: list[dict[str, Any]] = field(default_factory=list)
    first: int | None = None


@cache
def _robots(required: str) -> tuple[SlowArm, Robot]:
    with tempfile.TemporaryDirectory(prefix="decision-") as folder:
        path = write_robot(Path(folder), required)
        return SlowArm(path), Robot.load(path)


@cache
def _scenes(required: str, seed: int, count: int) -> Scenes:
    return Scenes(_robots(required)[0], seed, count)


def compare(task: Task) -> Outcome:
    """Run one piece of work; with something planted, only as far as the first difference."""
    required, profile = VARIANTS[task.variant]
    arm, robot = _robots(required)
    period = PERIODS_S[task.seed % len(PERIODS_S)]
    outcome = Outcome(variant=task.variant)
    with ExitStack() as stack:
        if task.mutant is not None:
            stack.enter_context(planted(MUTANTS[task.mutant]))
        real, slow = Monitor(robot, profile=profile, period_s=period), slow_monitor(arm, profile, period)
        while outcome.ticks < task.ticks and (task.mutant is None or outcome.first is None):
            part = outcome.ticks // RENEW
            scenes = _scenes(required, 1000 * task.seed + part, task.count)
            sequence = Sequence(scenes, [task.seed, task.variant, part], period)
            _run(sequence, slow, real, min(RENEW, task.ticks - outcome.ticks), outcome, task)
        if task.mutant is None:
            _scenes.cache_clear()
    return outcome


def _run(sequence: Sequence, slow: Any, real: Monitor, ticks: int, outcome: Outcome, task: Task) -> None:
    _forget(sequence, slow, real)
    for _ in range(ticks):
        tick = sequence.tick()
        outcome.ticks += 1
        one = slow.step(tick, sequence.scene(tick))
        outcome.zones[one["zone"]] = outcome.zones.get(one["zone"], 0) + 1
        try:
            found = differences(one, real.step(sequence.real(tick)))
        except SsmError as error:
            found = [f"error: {error}"]
        if not found:
            continue
        if near_an_edge(one, slow):
            outcome.edges += 1
        else:
            outcome.first = outcome.first or outcome.ticks
            if len(outcome.different) < 3:
                outcome.different.append({"tick": outcome.ticks, "differs": found, "inputs": repr(tick)})
            if task.mutant is not None:
                return
        _forget(sequence, slow, real)


def _forget(sequence: Sequence, slow: Any, real: Monitor) -> None:
    """Bring both to the same past: nothing is known for longer than a zone lasts."""
    for _ in range(slow.window + 1):
        nothing = sequence.absent()
        slow.step(nothing, None)
        real.step(sequence.real(nothing))

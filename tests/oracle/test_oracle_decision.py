"""The slow decision agrees with the monitor, and finds what is planted in it."""

from __future__ import annotations

import sys
from pathlib import Path
from pkgutil import resolve_name

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench.decision import WITHIN, hunt, hunts
from bench.decision_mutants import MUTANTS, planted
from bench.decision_run import Task, compare
from bench.decision_scenes import VARIANTS

TICKS = 500
HUNTED = ("timeouts a ninth longer", "1 % less reaction time", "one pair limits nothing")


@pytest.mark.parametrize("variant", range(len(VARIANTS)))
def test_both_decisions_are_the_same(variant):
    outcome = compare(Task(variant=variant, seed=7, ticks=TICKS, count=3))
    assert not outcome.different
    assert outcome.ticks == TICKS
    assert outcome.edges < 0.02 * TICKS
    assert sum(count > 0 for count in outcome.zones.values()) >= 2


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_what_is_planted_replaces_a_function_that_is_there_and_leaves_with_the_context(mutant):
    before = resolve_name(mutant.target)
    with planted(mutant):
        assert resolve_name(mutant.target) is not before
    assert resolve_name(mutant.target) is before


@pytest.mark.parametrize("name", HUNTED)
def test_a_planted_difference_is_found(name):
    places = hunts(5)[[mutant.name for mutant in MUTANTS].index(name)]
    task, first = hunt(places[:1]) or pytest.fail(f"not found: {name}")
    assert first <= WITHIN
    assert VARIANTS[task.variant][1] in MUTANTS[task.mutant].profiles

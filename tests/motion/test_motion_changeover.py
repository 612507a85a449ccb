"""A change of method changes the wanted velocity no faster than configured, and then not at all."""

from __future__ import annotations

import numpy as np
import pytest

from ssm_service.motion import Changeover

DT, ACCELERATION = 0.002, 4.0
STEP = DT * ACCELERATION


def run(changeover, method, wanted, previous, ticks):
    """Return what is wanted tick by tick, as if it were obeyed at once."""
    found = []
    for _ in range(ticks):
        previous = changeover.step(method, wanted, previous)
        found.append(previous)
    return np.array(found)


def test_it_reaches_the_new_method_in_the_time_that_the_acceleration_gives():
    changeover, first = Changeover(ACCELERATION, DT), np.array([0.5, -0.2, 0.0])
    assert run(changeover, "field", first, np.zeros(3), 1)[0] == pytest.approx(first)
    second = np.array([-0.1, -0.2, 0.25])
    found = run(changeover, "filter", second, first, 200)
    changes = np.abs(np.diff(np.vstack([first, found]), axis=0))
    assert changes.max() <= STEP * (1 + 1e-9)
    reached = int((np.abs(found - second).max(axis=1) < 1e-12).argmax()) + 1
    assert reached == pytest.approx(0.6 / STEP, abs=1.0)
    assert (found[reached:] == second).all()


def test_after_it_no_change_is_delayed():
    changeover = Changeover(ACCELERATION, DT)
    changeover.step("field", np.ones(2), np.zeros(2))
    run(changeover, "filter", np.zeros(2), np.ones(2), 200)
    assert changeover.step("filter", np.full(2, 9.0), np.zeros(2)).tolist() == [9.0, 9.0]


@pytest.mark.parametrize("methods", [(None, "field"), ("field", None)])
def test_a_start_and_an_end_are_no_changeover(methods):
    changeover = Changeover(ACCELERATION, DT)
    changeover.step(methods[0], np.ones(1), np.ones(1))
    assert changeover.step(methods[1], np.zeros(1), np.ones(1)).tolist() == [0.0]

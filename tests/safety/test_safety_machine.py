"""The machine that lifts severity slowly: every reachable state, and every pair of runs."""

from __future__ import annotations

import copy
from collections import deque
from itertools import product

import pytest

from ssm_service.safety import Zone, ZoneMachine

Window = tuple[Zone, ...]
NEEDED = (1, 2, 3, 4, 5)


def state_of(machine: ZoneMachine) -> str:
    """Return everything that a machine remembers."""
    return str(sorted(vars(machine).items()))


def after(machine: ZoneMachine, *zones: Zone) -> ZoneMachine:
    """Return a machine after some more ticks; the given one stays as it is."""
    later = copy.deepcopy(machine)
    for zone in zones:
        later.step(zone)
    return later


def reachable(needed: int) -> dict[tuple[str, Window], ZoneMachine]:
    """Return every state that any sequence of ticks leads to, with the last ``needed`` ticks beside it.

    Before the first tick nothing is known, which counts as ``stop``.
    """
    start, window = ZoneMachine(needed), (Zone.STOP,) * needed
    found = {(state_of(start), window): start}
    waiting = deque(found.items())
    while waiting:
        (_, window), machine = waiting.popleft()
        for zone in Zone:
            later = after(machine, zone)
            key = (state_of(later), (*window[1:], zone))
            if key not in found:
                found[key] = later
                waiting.append((key, later))
    return found


@pytest.mark.parametrize("needed", NEEDED)
def test_every_step_from_every_reachable_state(needed: int) -> None:
    """Worse at once; milder only after enough milder ticks in a row, and then no milder than these."""
    states = reachable(needed)
    for (_, window), machine in states.items():
        before = machine.zone
        for zone in Zone:
            now = after(machine, zone).zone
            last = (*window[1:], zone)
            assert now >= zone
            assert now <= max(before, zone)
            if zone >= before:
                assert now is zone
            if now < before:
                assert all(tick < before for tick in last)
                assert now is max(last)
            assert after(machine, *[zone] * needed).zone is zone, "recovery ends"
    assert len(states) >= 4**needed
    print(f"recovery_ticks {needed}: {len(states)} states, {4 * len(states)} steps")


@pytest.mark.parametrize("needed", NEEDED[:3])
def test_a_worse_run_is_never_milder_now_or_later(needed: int) -> None:
    """Every pair of runs of which one is, tick by tick, at least as severe as the other."""
    machines = {state: machine for (state, _), machine in reachable(needed).items()}
    steps = {
        (state, zone): state_of(after(machine, zone))
        for (state, machine), zone in product(machines.items(), Zone)
    }
    start = state_of(ZoneMachine(needed))
    found, waiting = {(start, start)}, deque([(start, start)])
    while waiting:
        mild, severe = waiting.popleft()
        assert machines[severe].zone >= machines[mild].zone
        for a, b in product(Zone, Zone):
            if a <= b and (pair := (steps[mild, a], steps[severe, b])) not in found:
                found.add(pair)
                waiting.append(pair)
    print(f"recovery_ticks {needed}: {len(found)} pairs of states")


def test_a_tick_that_is_worse_begins_the_recovery_anew() -> None:
    machine = ZoneMachine(3)
    assert [machine.step(zone) for zone in (Zone.GREEN, Zone.GREEN, Zone.STOP)] == [Zone.STOP] * 3
    assert [machine.step(Zone.GREEN) for _ in range(3)] == [Zone.STOP, Zone.STOP, Zone.GREEN]


def test_a_fault_never_lets_green_through_earlier() -> None:
    """Twice the same, but for a stop in the place of one red."""
    mild, severe = ZoneMachine(3), ZoneMachine(3)
    mild.step(Zone.RED)
    severe.step(Zone.STOP)
    for _ in range(8):
        assert severe.step(Zone.GREEN) >= mild.step(Zone.GREEN)

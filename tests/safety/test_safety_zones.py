import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssm_service.config import load_robot_config
from ssm_service.safety import SourceState, Zone, ZoneMachine, ZoneProfile, classify, forces_stop

KANG = ZoneProfile(name="kang2022", config=load_robot_config("ur3").file.profiles["kang2022"])
SOURCES = load_robot_config("ur3").file.sources
D = 0.1775


@pytest.mark.parametrize(
    ("distance", "zone"),
    [
        (D, Zone.RED),
        (math.nextafter(D, 1.0), Zone.YELLOW),
        (2 * D, Zone.YELLOW),
        (math.nextafter(2 * D, 1.0), Zone.GREEN),
        (math.nextafter(0.0, 1.0), Zone.RED),
        (0.0, Zone.STOP),
        (-0.01, Zone.STOP),
        (math.inf, Zone.GREEN),
        (math.nan, Zone.STOP),
    ],
)
def test_zone_edges_belong_to_the_nearer_zone(distance: float, zone: Zone) -> None:
    assert KANG.zone_at(distance) is zone


@settings(derandomize=True, max_examples=300)
@given(st.floats(-1, 2), st.floats(-1, 2))
def test_closer_is_never_milder_nor_faster(a: float, b: float) -> None:
    near, far = sorted((a, b))
    assert KANG.zone_at(near) >= KANG.zone_at(far)
    speeds = [KANG.joint_speed(KANG.zone_at(d)) for d in (near, far)]
    slow, fast = (math.inf if speed is None else speed for speed in speeds)
    assert slow <= fast
    assert KANG.speed_scaling(KANG.zone_at(near)) <= KANG.speed_scaling(KANG.zone_at(far))


def test_the_limits_are_those_of_the_paper() -> None:
    assert [KANG.joint_speed(zone) for zone in Zone] == [None, 0.24, 0.18, 0.0]
    assert [KANG.speed_scaling(zone) for zone in Zone] == [1.0, 0.5, 0.25, 0.0]


@settings(derandomize=True, max_examples=300)
@given(st.integers(1, 6), st.lists(st.sampled_from(list(Zone)), max_size=60))
def test_the_machine_against_its_definition(needed: int, zones: list[Zone]) -> None:
    """The zone in force is the most severe of the last ticks; before the first one they were stops."""
    machine = ZoneMachine(needed)
    assert machine.zone is Zone.STOP
    ticks = [Zone.STOP] * needed
    for zone in zones:
        ticks.append(zone)
        assert machine.step(zone) is max(ticks[-needed:])
        assert machine.zone is max(ticks[-needed:])


@pytest.mark.parametrize(
    ("age", "invalid", "state", "reason"),
    [
        (None, False, SourceState.ABSENT, "waiting:ranges"),
        (None, True, SourceState.INVALID, "invalid:ranges"),
        (0.0, False, SourceState.FRESH, None),
        (0.4, False, SourceState.FRESH, None),
        (math.nextafter(0.4, 1.0), False, SourceState.STALE, "stale:ranges"),
        (0.1, True, SourceState.INVALID, "invalid:ranges"),
        (-0.001, False, SourceState.STALE, "stale:ranges"),
        (math.nan, False, SourceState.STALE, "stale:ranges"),
        (math.inf, False, SourceState.STALE, "stale:ranges"),
    ],
)
def test_states_of_a_source(age: float | None, invalid: bool, state: SourceState, reason: str | None) -> None:
    status = classify("ranges", SOURCES.ranges, age_s=age, invalid=invalid)
    assert status.state is state
    assert status.reason == reason


@pytest.mark.parametrize("name", ["ranges", "obstacles"])
def test_only_an_optional_source_that_never_spoke_may_be_missing(name: str) -> None:
    config = getattr(SOURCES, name)
    for age, invalid in ((None, False), (99.0, False), (0.0, True), (None, True), (0.0, False)):
        status = classify(name, config, age_s=age, invalid=invalid)
        fresh = status.state is SourceState.FRESH
        unheard = status.state is SourceState.ABSENT and not config.required
        assert forces_stop(status, config) is not (fresh or unheard)

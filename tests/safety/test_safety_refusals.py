"""What the refusals and states of this room say, word by word: others act on them and show them."""

from __future__ import annotations

import math

import pytest

from ssm_service.config import ProfileConfig, SeparationConfig, ZoneConfig, load_robot_config
from ssm_service.errors import InputError
from ssm_service.safety import SeparationLaw, Zone, ZoneProfile, classify

TERMS = (
    "human_speed",
    "reaction_time",
    "stopping_time",
    "intrusion",
    "human_uncertainty",
    "robot_uncertainty",
    "stopping_gain",
)


@pytest.mark.parametrize("name", TERMS)
@pytest.mark.parametrize("value", [-1e-9, math.inf])
def test_a_term_that_is_refused_is_named_with_what_was_found_and_what_may_stand_there(
    name: str, value: float
) -> None:
    with pytest.raises(InputError) as caught:
        SeparationLaw(**{"reaction_time": 0.1, "stopping_time": 0.3, name: value})
    error = caught.value
    assert (error.cause, error.where, error.found) == ("out_of_range", name, value)
    assert error.allowed == "a finite number, 0 or more"


@pytest.mark.parametrize("name", TERMS)
def test_a_term_may_be_nothing(name: str) -> None:
    law = SeparationLaw(**{"reaction_time": 0.1, "stopping_time": 0.3, name: 0.0})
    assert getattr(law, name) == 0.0


def test_a_robot_that_needs_no_time_at_all_is_refused_by_the_name_of_the_first() -> None:
    with pytest.raises(InputError) as caught:
        SeparationLaw(reaction_time=0.0, stopping_time=0.0)
    error = caught.value
    assert (error.cause, error.where, error.found) == ("out_of_range", "reaction_time", 0.0)
    assert error.allowed == "above 0 with stopping_time"


def test_a_speed_that_is_no_number_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        SeparationLaw(reaction_time=0.1, stopping_time=0.3).terms(math.inf)
    error = caught.value
    assert (error.cause, error.where, error.found) == ("not_finite", "robot_speed", math.inf)
    assert error.allowed == "a finite number"


def test_the_very_distance_of_standing_still_leaves_no_speed_even_to_a_robot_that_stops_at_once() -> None:
    ideal = SeparationLaw(reaction_time=0.0, stopping_time=0.25, stopping_gain=0.0)
    standing = ideal.terms(0.0).S_p
    assert ideal.greatest_speed(standing) == 0.0
    assert ideal.greatest_speed(math.nextafter(standing, 1.0)) == math.inf


@pytest.mark.parametrize("age", [None, 0.01, 99.0])
def test_a_status_carries_the_age_that_it_was_given(age: float | None) -> None:
    sources = load_robot_config("ur3").file.sources
    for invalid in (False, True):
        status = classify("ranges", sources.ranges, age_s=age, invalid=invalid)
        assert (status.name, status.age_s) == ("ranges", age)


RED = ZoneConfig(distance_m=0.2, joint_speed_rad_s=0.1, speed_scaling=0.2)
YELLOW = ZoneConfig(distance_m=0.5, joint_speed_rad_s=0.3, speed_scaling=0.6)
EQUATION = SeparationConfig(
    intrusion_m=0.0, human_uncertainty_m=0.0, robot_uncertainty_m=0.0, red_scaling=0.16
)


def profile(**fields: object) -> ZoneProfile:
    return ZoneProfile(name="p", config=ProfileConfig(recovery_ticks=5, **fields))


def test_without_steps_only_contact_is_a_matter_of_distance() -> None:
    bare = profile(separation=EQUATION)
    assert [bare.zone_at(d) for d in (-0.1, 0.0, math.nan)] == [Zone.STOP] * 3
    assert [bare.zone_at(d) for d in (math.ulp(0.0), 0.3, 0.9, math.inf)] == [Zone.GREEN] * 4


def test_without_steps_a_doubt_is_worth_what_the_separation_says() -> None:
    bare = profile(separation=EQUATION)
    assert [bare.speed_scaling(zone) for zone in Zone] == [1.0, pytest.approx(0.4), 0.16, 0.0]
    assert [bare.joint_speed(zone) for zone in Zone] == [None, None, None, 0.0]


def test_steps_go_before_the_separation() -> None:
    both = profile(red=RED, yellow=YELLOW, separation=EQUATION)
    assert [both.speed_scaling(zone) for zone in Zone] == [1.0, 0.6, 0.2, 0.0]
    assert [both.joint_speed(zone) for zone in Zone] == [None, 0.3, 0.1, 0.0]
    zones = [both.zone_at(d) for d in (0.0, 0.1, 0.2, 0.4, 0.5, 0.6)]
    assert zones == [Zone.STOP, Zone.RED, Zone.RED, Zone.YELLOW, Zone.YELLOW, Zone.GREEN]

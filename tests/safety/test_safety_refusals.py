"""What the refusals and states of this room say, word by word: others act on them and show them."""

from __future__ import annotations

import math

import pytest

from ssm_service.config import load_robot_config
from ssm_service.errors import InputError
from ssm_service.safety import SeparationLaw, classify

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

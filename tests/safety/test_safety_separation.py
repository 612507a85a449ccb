"""The protective separation distance against published worked examples, and its inverse."""

from __future__ import annotations

import math

import pytest

from ssm_service.errors import InputError
from ssm_service.safety import SeparationLaw

# v_h, v_r, T_r, T_s, C, Z_d, Z_r, S_p in s, m, m/s; constant speeds, S_s = v_r·T_s/2
EXAMPLES = [
    (1.6, 1.0, 0.10, 0.30, 0.20, 0.10, 0.05, 1.240),
    (1.6, 0.5, 0.10, 0.30, 0.20, 0.10, 0.05, 1.115),
    (1.6, 0.0, 0.10, 0.30, 0.20, 0.10, 0.05, 0.990),
    (1.6, 1.0, 0.20, 0.30, 0.20, 0.10, 0.05, 1.500),
]


def law(v_h: float, T_r: float, T_s: float, C: float, Z_d: float, Z_r: float) -> SeparationLaw:
    return SeparationLaw(
        human_speed=v_h,
        reaction_time=T_r,
        stopping_time=T_s,
        intrusion=C,
        human_uncertainty=Z_d,
        robot_uncertainty=Z_r,
    )


@pytest.mark.parametrize(("v_h", "v_r", "T_r", "T_s", "C", "Z_d", "Z_r", "S_p"), EXAMPLES)
def test_published_examples(
    v_h: float, v_r: float, T_r: float, T_s: float, C: float, Z_d: float, Z_r: float, S_p: float
) -> None:
    terms = law(v_h, T_r, T_s, C, Z_d, Z_r).terms(v_r)
    assert terms.S_p == pytest.approx(S_p, abs=1e-12)
    assert terms.S_h == pytest.approx(v_h * (T_r + T_s), abs=1e-15)
    assert terms.S_r == pytest.approx(v_r * T_r, abs=1e-15)
    assert terms.S_s == pytest.approx(v_r * T_s / 2, abs=1e-15)
    assert (terms.C, terms.Z_d, terms.Z_r) == (C, Z_d, Z_r)


@pytest.mark.parametrize(("v_h", "v_r", "T_r", "T_s", "C", "Z_d", "Z_r", "S_p"), EXAMPLES)
def test_greatest_speed_is_the_inverse(
    v_h: float, v_r: float, T_r: float, T_s: float, C: float, Z_d: float, Z_r: float, S_p: float
) -> None:
    assert law(v_h, T_r, T_s, C, Z_d, Z_r).greatest_speed(S_p) == pytest.approx(v_r, abs=1e-9)


def test_inverse_over_many_speeds_and_with_a_measured_stopping_distance() -> None:
    measured = SeparationLaw(reaction_time=0.18, stopping_time=0.159, stopping_gain=0.18 / 3.194)
    for step in range(1, 200):
        v_r = 0.01 * step
        assert measured.greatest_speed(measured.terms(v_r).S_p) == pytest.approx(v_r, abs=1e-9)
    assert measured.terms(1.0).S_s == pytest.approx(0.18 / 3.194, abs=1e-15)


def test_no_speed_is_left_at_or_below_the_distance_of_standing_still() -> None:
    standing = law(1.6, 0.1, 0.3, 0.2, 0.1, 0.05)
    for distance in (0.0, 0.5, standing.terms(0.0).S_p, -1.0, -math.inf, math.nan):
        assert standing.greatest_speed(distance) == 0.0
    assert standing.greatest_speed(math.inf) == math.inf


def test_the_allowed_speed_rises_with_distance_and_never_allows_too_much() -> None:
    one = law(1.6, 0.1, 0.3, 0.2, 0.1, 0.05)
    speeds = [one.greatest_speed(0.01 * step) for step in range(300)]
    assert speeds == sorted(speeds)
    for step, speed in enumerate(speeds):
        if speed > 0.0:
            assert one.terms(speed).S_p <= 0.01 * step + 1e-12


def test_moving_away_takes_nothing_off() -> None:
    one = law(1.6, 0.1, 0.3, 0.2, 0.1, 0.05)
    assert one.terms(-5.0) == one.terms(0.0)


def test_a_robot_that_stops_in_no_time_may_run_at_any_speed_only_with_room_to_spare() -> None:
    ideal = SeparationLaw(reaction_time=0.0, stopping_time=0.2, stopping_gain=0.0)
    assert ideal.greatest_speed(0.33) == math.inf
    assert ideal.greatest_speed(0.31) == 0.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"human_speed": -1.0},
        {"reaction_time": math.nan},
        {"stopping_time": math.inf},
        {"intrusion": -0.1},
        {"stopping_gain": -1.0},
        {"reaction_time": 0.0, "stopping_time": 0.0},
    ],
)
def test_nonsense_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError) as caught:
        SeparationLaw(**{"reaction_time": 0.1, "stopping_time": 0.3, **wrong})  # type: ignore[arg-type]
    assert caught.value.cause == "out_of_range"
    with pytest.raises(InputError):
        SeparationLaw(reaction_time=0.1, stopping_time=0.3).terms(math.nan)

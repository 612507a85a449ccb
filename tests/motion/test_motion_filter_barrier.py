import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssm_service.config import FilterConfig
from ssm_service.errors import InputError
from ssm_service.motion import (
    VelocityFilter,
    approach_speeds,
    barrier_bounds,
    contact_bounds,
    limit_velocity,
    softness,
    velocity_box,
)
from ssm_service.motion.barrier import YIELDING_M_S, YIELDING_SHARE

CONFIG = FilterConfig(margin_m=0.03, approach_gain=3.0, influence_distance_m=0.6, retreat_speed_m_s=0.5)
N = 6
SEEDED = settings(max_examples=300, derandomize=True, deadline=None, database=None)


def numbers(low, high):
    return st.lists(st.floats(low, high, width=64), min_size=N, max_size=N).map(np.array)


CASES = st.fixed_dictionaries(
    {
        "previous": numbers(-4, 4),
        "position": numbers(-3.5, 3.5),
        "speed_limit": st.lists(
            st.one_of(st.floats(0, 4), st.just(0.0), st.just(math.inf)), min_size=N, max_size=N
        ).map(np.array),
        "lower": numbers(-3, -0.5),
        "upper": numbers(0.5, 3),
        "margin": st.floats(0, 0.3),
        "acceleration": st.floats(0.1, 50),
        "dt": st.sampled_from([0.002, 0.01, 0.02]),
    }
)
BASE = {
    "previous": np.zeros(N),
    "position": np.zeros(N),
    "speed_limit": np.full(N, 2.0),
    "lower": np.full(N, -3.0),
    "upper": np.full(N, 3.0),
    "margin": 0.02,
    "acceleration": 4.0,
    "dt": 0.002,
}


def test_the_bound_is_the_barrier_less_the_approach():
    distance = np.array([0.03, 0.13, 0.13, 0.13, 0.0, -0.2, 0.6, 0.61, math.inf, -math.inf])
    approach = np.array([0.0, 0.0, 0.4, -0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    expected = [0.0, 0.3, -0.1, 0.3, -0.09, -0.5, 1.71, math.inf, math.inf, -0.5]
    np.testing.assert_allclose(barrier_bounds(distance, approach, CONFIG), expected, atol=1e-15)


@SEEDED
@given(st.floats(-0.5, 0.59), st.floats(0, 0.01), st.floats(-1, 1), st.floats(0, 0.1))
def test_nearer_or_faster_never_admits_more(distance, more, approach, faster):
    bounds = barrier_bounds(
        np.array([distance, distance + more, distance]),
        np.array([approach, approach, approach + faster]),
        CONFIG,
    )
    assert bounds[0] <= bounds[1]
    assert bounds[2] <= bounds[0]
    assert (bounds >= -0.5).all()


def test_the_ceiling_is_the_contact_distance_and_never_asks_for_a_retreat():
    distance = np.array([0.003, 0.103, 0.103, 0.103, 0.0, -0.2, 0.61, -math.inf])
    approach = np.array([0.0, 0.0, 0.4, -0.4, 0.0, 0.5, 0.0, 0.0])
    expected = [0.0, 1.0, 0.6, 1.0, 0.0, 0.0, math.inf, 0.0]
    np.testing.assert_allclose(contact_bounds(distance, approach, CONFIG), expected, atol=1e-15)


@SEEDED
@given(st.floats(-0.5, 0.59), st.floats(-1, 1))
def test_the_ceiling_is_never_below_the_bound(distance, approach):
    pair = np.array([distance]), np.array([approach])
    assert contact_bounds(*pair, CONFIG)[0] >= barrier_bounds(*pair, CONFIG)[0]


def test_margins_are_softer_for_who_is_not_threatened():
    """A full threat, half of one, what stands, what leaves, and what comes from far away."""
    bounds = np.array([-0.2, -0.025, -0.1, -0.1, 0.4])
    approach = np.array([0.3, 0.1, 0.0, -0.2, 0.1])
    expected = 0.01 * (1.0 + YIELDING_SHARE * np.array([0.0, 0.5, 1.0, 1.0, 1.0]))
    np.testing.assert_allclose(softness(bounds, approach, 0.01), expected)
    np.testing.assert_array_equal(softness(bounds[2:], approach[2:], 0.01), np.full(3, 0.01))
    assert softness(np.empty(0), np.empty(0), 0.01).shape == (0,)
    for more in (1e-9, -1e-9):  # no jump where the threat begins
        near = softness(np.array([-0.1, -0.1]), np.array([more, 0.0]), 0.01)
        np.testing.assert_allclose(near, 0.01, rtol=YIELDING_SHARE / YIELDING_M_S * 2e-9)


@pytest.mark.parametrize("change", [{"contact_m": 0.04}, {"contact_gain": 2.0}])
def test_the_contact_distance_is_within_the_margin_and_stiffer(change):
    with pytest.raises(ValueError, match="must not be above"):
        FilterConfig(**change)


def test_approach_is_the_part_of_the_obstacles_velocity_along_the_normal():
    normals = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    velocities = np.array([[0.3, 5.0, 5.0], [1.0, -1.0, 0.0]])
    np.testing.assert_allclose(approach_speeds(normals, velocities), [0.3, -0.6])


@pytest.mark.parametrize(
    ("distance", "approach"), [([math.nan, 0.1], [0.0, 0.0]), ([math.inf, 0.9], [math.nan, 0.0])]
)
def test_refuses_nan_even_far_away(distance, approach):
    with pytest.raises(InputError) as caught:
        barrier_bounds(np.array(distance), np.array(approach), CONFIG)
    assert caught.value.cause == "not_finite"


def test_refuses_lists_of_different_length():
    with pytest.raises(InputError) as caught:
        barrier_bounds(np.zeros(3), np.zeros(2), CONFIG)
    assert caught.value.cause == "wrong_length"
    assert barrier_bounds(np.empty(0), np.empty(0), CONFIG).shape == (0,)


@pytest.mark.parametrize("approach", [0.0, 0.1, 0.3])
def test_a_point_on_a_line_never_comes_below_the_margin(approach):
    """One joint, an obstacle that comes in from afar, and a target that pushes towards it."""
    distance, velocity, dt, least = 1.0, 0.0, 0.008, math.inf
    for _ in range(3000):
        bounds = barrier_bounds(np.array([distance]), np.array([approach]), CONFIG)
        box = velocity_box(*map(np.array, ([0.0], [velocity], [-math.inf], [math.inf], [2.0])), 0.0, 4.0, dt)
        found = VelocityFilter().solve(np.array([0.4]), np.array([[1.0]]), bounds, box)
        velocity = float(found.velocity[0])
        distance -= dt * (velocity + approach)
        least = min(least, distance)
    assert least >= 0.03 - 1e-4
    assert distance == pytest.approx(0.03, abs=1e-3)
    assert velocity == pytest.approx(-approach, abs=1e-3)


@SEEDED
@given(CASES)
def test_each_side_of_the_box_is_the_greatest_speed_of_one_joint_alone(case):
    box = velocity_box(**case)
    assert (box.lower <= 0.0).all()
    assert (box.upper >= 0.0).all()
    for index in range(N):
        for sign, side in ((1.0, box.upper), (-1.0, -box.lower)):
            wanted = np.zeros(N)
            wanted[index] = sign * 1e3
            alone = limit_velocity(wanted, **case)
            assert abs(alone[index]) == pytest.approx(side[index], rel=1e-12, abs=1e-300)


@SEEDED
@given(CASES, numbers(-5, 5))
def test_what_limit_velocity_returns_is_in_the_box(case, wanted):
    box = velocity_box(**case)
    result = limit_velocity(wanted, **case)
    assert (result >= box.lower).all()
    assert (result <= box.upper).all()


@SEEDED
@given(CASES, st.lists(st.floats(0, 1), min_size=N, max_size=N).map(np.array))
def test_what_is_in_the_box_passes_limit_velocity(case, share):
    box = velocity_box(**case)
    chosen = box.lower + share * (box.upper - box.lower)
    np.testing.assert_allclose(limit_velocity(chosen, **case), chosen, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("name", ["previous", "position", "speed_limit", "lower", "upper"])
def test_refuses_nan_wherever_it_stands(name):
    case = {key: np.array(value) if np.ndim(value) else value for key, value in BASE.items()}
    case[name][4] = math.nan
    with pytest.raises(InputError) as caught:
        velocity_box(**case)
    assert (caught.value.cause, caught.value.where) == ("not_finite", "joint[4]")


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"speed_limit": np.full(N, -0.1)}, "out_of_range"),
        ({"lower": np.full(N, 4.0)}, "out_of_range"),
        ({"dt": 0.0}, "out_of_range"),
        ({"acceleration": math.nan}, "out_of_range"),
        ({"acceleration": math.inf}, "out_of_range"),
        ({"margin": math.nan}, "out_of_range"),
        ({"position": np.zeros(N - 1)}, "wrong_length"),
    ],
)
def test_refuses_limits_without_meaning(change, cause):
    with pytest.raises(InputError) as caught:
        velocity_box(**{**BASE, **change})
    assert caught.value.cause == cause

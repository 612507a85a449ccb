import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssm_service.errors import InputError
from ssm_service.motion import limit_velocity

N = 6
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
WANTED = st.one_of(numbers(-5, 5), numbers(-0.05, 0.05))
SEEDED = settings(max_examples=400, derandomize=True, deadline=None, database=None)


def allowed_speeds(wanted, case):
    """Every limit of every moving joint, written down a second time, joint by joint."""
    for i in np.flatnonzero(wanted).tolist():
        gap = (
            case["upper"][i] - case["margin"] - case["position"][i]
            if wanted[i] > 0
            else case["position"][i] - (case["lower"][i] + case["margin"])
        )
        start = abs(case["previous"][i]) if np.sign(wanted[i]) == np.sign(case["previous"][i]) else 0.0
        bound = 0.0 if gap <= 0 else min(math.sqrt(2 * case["acceleration"] * gap), float(gap) / case["dt"])
        yield i, min(float(case["speed_limit"][i]), bound, float(start) + case["acceleration"] * case["dt"])


@SEEDED
@given(WANTED, CASES)
def test_is_the_wanted_velocity_times_the_greatest_factor_that_keeps_every_limit(wanted, case):
    result = limit_velocity(wanted, **case)
    factor = min([1.0, *(bound / abs(float(wanted[i])) for i, bound in allowed_speeds(wanted, case))])
    np.testing.assert_allclose(result, factor * wanted, rtol=1e-14, atol=1e-300)
    for i, bound in allowed_speeds(wanted, case):
        assert abs(result[i]) <= bound  # to the last bit
    assert (np.abs(result) <= np.abs(wanted)).all()
    assert (result * wanted >= 0).all()
    assert not result[wanted == 0].any()


@SEEDED
@given(WANTED, CASES, numbers(0, 1))
def test_a_smaller_speed_limit_never_gives_a_faster_joint(wanted, case, share):
    result = limit_velocity(wanted, **case)
    finite = np.minimum(case["speed_limit"], 100.0)
    slower = limit_velocity(wanted, **{**case, "speed_limit": share * finite})
    assert (np.abs(slower) <= np.abs(result)).all()


@SEEDED
@given(WANTED, CASES)
def test_stops_at_once(wanted, case):
    assert not limit_velocity(np.zeros(N), **case).any()
    stopped = limit_velocity(wanted, **{**case, "speed_limit": np.zeros(N)})
    assert not stopped.any()


@SEEDED
@given(WANTED, CASES)
def test_what_it_returns_passes_unchanged(wanted, case):
    """Only the acceleration could object the second time, and it allows at least as much."""
    result = limit_velocity(wanted, **case)
    np.testing.assert_array_equal(limit_velocity(result, **case), result)


@SEEDED
@given(WANTED, CASES)
def test_mirrored_case_gives_the_mirrored_velocity(wanted, case):
    mirrored = {
        **case,
        "previous": -case["previous"],
        "position": -case["position"],
        "lower": -case["upper"],
        "upper": -case["lower"],
    }
    np.testing.assert_array_equal(limit_velocity(-wanted, **mirrored), -limit_velocity(wanted, **case))


@pytest.mark.parametrize("dt", [0.002, 0.02])
def test_long_runs_never_pass_a_margin(dt):
    rng = np.random.default_rng(1)
    lower, upper = np.array([-1.0, -0.5, -0.2, -2.0, -0.1, -0.05]), np.array([0.8, 0.5, 0.3, 2.0, 0.1, 0.5])
    for margin in (0.0, 0.02):
        position, velocity, touched = np.zeros(N), np.zeros(N), 0
        for tick in range(6000):
            if tick % 250 == 0:
                wanted = rng.normal(size=N) * rng.choice([0.0, 0.5, 3.0], N)
            case = {"previous": velocity, "position": position, "lower": lower, "upper": upper}
            new = limit_velocity(wanted, **{**BASE, **case, "dt": dt, "margin": margin})
            assert (np.abs(new) <= np.abs(velocity) + BASE["acceleration"] * dt + 1e-12).all()
            velocity = new
            position = position + dt * velocity
            assert (position >= lower + margin - 1e-12).all()
            assert (position <= upper - margin + 1e-12).all()
            touched += int((np.minimum(position - lower, upper - position) < margin + 1e-9).any())
        assert touched > 100


@pytest.mark.parametrize("dt", [0.002, 0.02])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_comes_to_rest_at_the_margin_without_overshoot(dt, sign):
    position, velocity, speeds = np.zeros(1), np.zeros(1), []
    for _ in range(int(4.0 / dt)):
        velocity = limit_velocity(
            sign * np.array([1.5]),
            previous=velocity,
            position=position,
            speed_limit=np.array([2.0]),
            lower=np.array([-1.0]),
            upper=np.array([1.0]),
            margin=0.02,
            acceleration=4.0,
            dt=dt,
        )
        position = position + dt * velocity
        speeds.append(abs(velocity[0]))
        assert sign * position[0] <= 0.98 + 1e-12
    assert sign * position[0] == pytest.approx(0.98, abs=1e-9)
    assert speeds[-1] < 1e-9
    assert max(speeds) == pytest.approx(1.5)
    # Once it slows it only slows, at hardly more than the acceleration but for the very last steps.
    slowing = np.diff(speeds[int(np.argmax(np.array(speeds) > 1.4999)) + int(0.1 / dt) :])
    assert (slowing <= 1e-12).all()
    assert (slowing >= -2.5 * 4.0 * dt - 1e-9).all()


@pytest.mark.parametrize("place", [2.98, 2.99, 3.0, 3.2, -2.98, -2.99, -3.0, -3.2])
def test_retreat_from_a_limit_is_free_and_the_way_into_it_is_shut(place):
    position = np.zeros(N)
    position[2] = place
    inwards, outwards = np.full(N, 0.001), np.full(N, 0.001)
    inwards[2], outwards[2] = -math.copysign(0.005, place), math.copysign(0.005, place)
    case = {**BASE, "position": position}
    np.testing.assert_array_equal(limit_velocity(inwards, **case), inwards)
    assert not limit_velocity(outwards, **case).any()
    sideways = np.full(N, 0.005)
    sideways[2] = 0.0
    np.testing.assert_array_equal(limit_velocity(sideways, **case), sideways)


def test_speeding_up_takes_its_time_and_slowing_down_none():
    wanted, velocity = np.linspace(0.2, 1.2, N), np.zeros(N)
    for tick in range(1, 151):
        velocity = limit_velocity(wanted, **{**BASE, "previous": velocity})
        assert velocity[-1] == pytest.approx(min(1.2, 0.008 * tick))
    np.testing.assert_array_equal(limit_velocity(wanted / 10, **{**BASE, "previous": velocity}), wanted / 10)


def test_a_reversal_starts_from_rest():
    fast = np.full(N, 1.0)
    turned = limit_velocity(-fast, **{**BASE, "previous": fast})
    np.testing.assert_allclose(turned, -0.008, rtol=1e-12)
    gentle = np.full(N, -0.004)
    np.testing.assert_array_equal(limit_velocity(gentle, **{**BASE, "previous": fast}), gentle)


def test_a_locked_joint_with_no_speed_limit_left_holds_nobody_else():
    limit = np.array([0.0, 2.0, 2.0, 2.0, 2.0, 2.0])
    wanted = np.array([0.0, 0.001, 0.002, -0.003, 0.0, 0.004])
    np.testing.assert_array_equal(limit_velocity(wanted, **{**BASE, "speed_limit": limit}), wanted)


def test_joints_without_position_limits_turn_for_ever():
    case = {
        **BASE,
        "position": np.full(N, 1e6),
        "previous": np.ones(N),
        "lower": np.full(N, -math.inf),
        "upper": np.full(N, math.inf),
        "speed_limit": np.full(N, math.inf),
    }
    np.testing.assert_array_equal(limit_velocity(np.ones(N), **case), np.ones(N))


def test_returns_a_new_array_and_leaves_its_arguments():
    wanted = np.full(N, 0.001)
    result = limit_velocity(wanted, **BASE)
    result[:] = 7.0
    assert (wanted == 0.001).all()


@pytest.mark.parametrize("name", ["wanted", "previous", "position", "speed_limit", "lower", "upper"])
@pytest.mark.parametrize("want", [0.0, 0.5])
def test_refuses_nan_wherever_it_stands(name, want):
    case = {key: np.array(value) if np.ndim(value) else value for key, value in BASE.items()}
    case["wanted"] = np.full(N, want)
    case[name][4] = math.nan
    with pytest.raises(InputError) as caught:
        limit_velocity(**case)
    assert (caught.value.cause, caught.value.where) == ("not_finite", "joint[4]")


@pytest.mark.parametrize("name", ["wanted", "previous", "position"])
@pytest.mark.parametrize("bad", [math.inf, -math.inf])
def test_refuses_infinity_in_a_value(name, bad):
    case = {"wanted": np.full(N, 0.5), **BASE}
    case[name] = np.array([0.0, bad, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(InputError) as caught:
        limit_velocity(**case)
    assert caught.value.cause == "not_finite"


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"speed_limit": np.full(N, -0.1)}, "out_of_range"),
        ({"lower": np.full(N, 4.0)}, "out_of_range"),
        ({"dt": 0.0}, "out_of_range"),
        ({"dt": math.nan}, "out_of_range"),
        ({"acceleration": -1.0}, "out_of_range"),
        ({"margin": math.nan}, "out_of_range"),
        ({"position": np.zeros(N - 1)}, "wrong_length"),
    ],
)
def test_refuses_limits_without_meaning(change, cause):
    with pytest.raises(InputError) as caught:
        limit_velocity(np.full(N, 0.5), **{**BASE, **change})
    assert caught.value.cause == cause


def test_rounding_never_carries_a_joint_past_its_limit():
    rng = np.random.default_rng(2)
    for _ in range(3000):
        wanted, limit = rng.uniform(0.5, 5.0, N), rng.uniform(0.001, 0.5, N)
        result = limit_velocity(wanted, **{**BASE, "previous": wanted, "speed_limit": limit})
        assert (result <= limit).all()
        np.testing.assert_allclose(result, wanted * np.min(limit / wanted), rtol=1e-14)

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssm_service.errors import InputError
from ssm_service.motion import LineSegmentParabolicBlend, lspb_speed


def line(start=0.0, goal=1.0, speed=0.25, acceleration=0.5):
    return LineSegmentParabolicBlend(start=start, goal=goal, speed=speed, acceleration=acceleration)


def random_line(rng, dimension=3):
    start, goal = rng.uniform(-1.0, 1.0, (2, dimension))
    return line(start, goal, rng.uniform(0.05, 2.0), rng.uniform(0.1, 3.0))


def test_a_line_worked_out_by_hand():
    """1 m at 0.25 m/s and 0.5 m/s²: half a second and 1/16 m for each blend, 3.5 s between, 4.5 s in all."""
    segment = line()
    assert segment.duration == pytest.approx(4.5, abs=1e-15)
    assert segment.blend_s == pytest.approx(0.5, abs=1e-15)
    places = {0.0: 0.0, 0.25: 1 / 64, 0.5: 1 / 16, 2.25: 0.5, 4.0: 15 / 16, 4.25: 63 / 64, 4.5: 1.0}
    for time_s, place in places.items():
        assert segment.position(time_s) == pytest.approx(place, abs=1e-15)
    for time_s, rate in {0.0: 0.0, 0.25: 0.125, 0.5: 0.25, 3.0: 0.25, 4.25: 0.125, 4.5: 0.0}.items():
        assert segment.velocity(time_s) == pytest.approx(rate, abs=1e-15)


def test_a_short_line_has_no_linear_segment():
    """0.02 m at 0.5 m/s²: the peak is √(a·L) = 0.1 m/s after 0.2 s, which is half of the time."""
    segment = line(goal=0.02, speed=1.0)
    assert segment.peak_speed == pytest.approx(0.1)
    assert segment.duration == pytest.approx(0.4) == pytest.approx(2.0 * segment.blend_s)
    assert segment.position(0.2) == pytest.approx(0.01)
    assert segment.velocity(0.2) == pytest.approx(0.1)


def test_velocity_is_the_derivative_of_position():
    rng = np.random.default_rng(1)
    for _ in range(50):
        segment, h = random_line(rng), 1e-6
        for time_s in rng.uniform(0.0, segment.duration, 5):
            slope = (segment.position(time_s + h) - segment.position(time_s - h)) / (2.0 * h)
            np.testing.assert_allclose(segment.velocity(time_s), slope, atol=2e-6)


def test_speed_and_acceleration_keep_their_bounds_and_the_area_is_the_line():
    rng = np.random.default_rng(2)
    for _ in range(20):
        segment = random_line(rng)
        times = np.linspace(0.0, segment.duration, 2001)
        rates = np.array([np.linalg.norm(segment.velocity(t)) for t in times])
        assert rates.max() <= segment.speed * (1.0 + 1e-12)
        assert (np.abs(np.diff(rates)) <= segment.acceleration * np.diff(times) * (1.0 + 1e-9)).all()
        assert np.trapezoid(rates, times) == pytest.approx(segment.length, rel=1e-4)


def test_it_runs_backwards_as_it_runs_forwards():
    rng = np.random.default_rng(3)
    for _ in range(20):
        there = random_line(rng)
        back = line(there.goal, there.start, there.speed, there.acceleration)
        for time_s in np.linspace(0.0, there.duration, 9):
            np.testing.assert_allclose(
                back.position(time_s), there.position(there.duration - time_s), atol=1e-12
            )


def test_every_point_is_on_the_line_and_rotations_commute():
    rng = np.random.default_rng(4)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    one = random_line(rng)
    turned = line(rotation @ one.start, rotation @ one.goal, one.speed, one.acceleration)
    along = (one.goal - one.start) / one.length
    for time_s in np.linspace(-1.0, one.duration + 1.0, 13):
        place = one.position(time_s)
        np.testing.assert_allclose(turned.position(time_s), rotation @ place, atol=1e-12)
        np.testing.assert_allclose(turned.velocity(time_s), rotation @ one.velocity(time_s), atol=1e-12)
        way = float(along @ (place - one.start))
        np.testing.assert_allclose(place, one.start + way * along, atol=1e-12)
        assert way == pytest.approx(one.travelled(time_s), abs=1e-12)


def test_before_the_start_and_after_the_end_it_stands():
    segment = line([1.0, 2.0, 3.0], [1.0, 2.5, 3.0])
    for time_s, place in ((-math.inf, segment.start), (math.inf, segment.goal), (99.0, segment.goal)):
        np.testing.assert_array_equal(segment.position(time_s), place)
        np.testing.assert_array_equal(segment.velocity(time_s), np.zeros(3))


def test_a_line_of_no_length():
    segment = line([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert segment.duration == segment.peak_speed == 0.0
    np.testing.assert_array_equal(segment.position(1.0), segment.start)
    np.testing.assert_array_equal(segment.velocity(0.0), np.zeros(3))


def test_a_plain_number_stays_one():
    assert line(goal=-1.0).position(9.0).shape == ()
    assert line(goal=-1.0).velocity(1.0) == pytest.approx(-0.25)


@settings(max_examples=50, deadline=None)
@given(st.floats(1e-3, 5.0), st.floats(1e-2, 3.0), st.floats(1e-2, 10.0), st.floats(0.0, 1.0))
def test_the_speed_by_what_remains_is_that_of_the_clock(length, speed, acceleration, share):
    segment = line(goal=length, speed=speed, acceleration=acceleration)
    time_s = share * segment.duration
    remaining = length - segment.travelled(time_s)
    by_law = lspb_speed(time_s, remaining, speed=speed, acceleration=acceleration)
    # Where little remains, its root loses half of the digits.
    assert by_law == pytest.approx(segment.rate(time_s), abs=1e-6 * (speed + math.sqrt(acceleration)))


def test_stepping_by_the_law_takes_the_segments_time():
    segment, dt = line(goal=0.6, speed=0.08, acceleration=0.2), 0.01
    way, ticks = 0.0, 0
    while segment.length - way > 1e-4:
        way += dt * lspb_speed((ticks + 0.5) * dt, 0.6 - way, speed=0.08, acceleration=0.2)
        ticks += 1
        assert ticks < 2000
    assert ticks * dt == pytest.approx(segment.duration, abs=0.05)


@pytest.mark.parametrize(("elapsed", "remaining"), [(0.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (1.0, -1.0)])
def test_no_time_or_no_way_is_no_speed(elapsed, remaining):
    assert lspb_speed(elapsed, remaining, speed=1.0, acceleration=1.0) == 0.0


@pytest.mark.parametrize(
    ("wrong", "cause", "where"),
    [
        ({"start": [0.0, math.nan, 0.0]}, "not_finite", "start"),
        ({"goal": [0.0, math.inf, 0.0]}, "not_finite", "goal"),
        ({"goal": [0.0, 1.0]}, "wrong_length", "goal"),
        ({"speed": 0.0}, "out_of_range", "speed"),
        ({"speed": math.nan}, "out_of_range", "speed"),
        ({"acceleration": -1.0}, "out_of_range", "acceleration"),
        ({"acceleration": math.inf}, "out_of_range", "acceleration"),
    ],
)
def test_what_makes_no_sense_is_refused(wrong, cause, where):
    given_values = {"start": [0.0, 0.0, 0.0], "goal": [1.0, 0.0, 0.0], "speed": 1.0, "acceleration": 1.0}
    with pytest.raises(InputError) as caught:
        LineSegmentParabolicBlend(**(given_values | wrong))
    assert (caught.value.cause, caught.value.where) == (cause, where)


def test_nan_is_no_time_and_no_way():
    for ask in (line().position, line().velocity, line().travelled, line().rate):
        with pytest.raises(InputError, match="time_s"):
            ask(math.nan)
    for elapsed, remaining in ((math.nan, 1.0), (1.0, math.nan), (1.0, math.inf)):
        with pytest.raises(InputError):
            lspb_speed(elapsed, remaining, speed=1.0, acceleration=1.0)
    with pytest.raises(InputError):
        lspb_speed(1.0, 1.0, speed=0.0, acceleration=1.0)


def test_what_was_given_may_change_afterwards():
    start = np.zeros(3)
    segment = line(start, [1.0, 0.0, 0.0])
    start[0] = 9.0
    np.testing.assert_array_equal(segment.position(0.0), np.zeros(3))
    with pytest.raises(ValueError, match="read-only"):
        segment.start[0] = 1.0

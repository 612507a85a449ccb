import math

import numpy as np
import pytest

from ssm_service.config import AssumptionsConfig, RingConfig
from ssm_service.errors import InputError
from ssm_service.model import Robot
from ssm_service.model.link_distance import LinkDistance
from ssm_service.model.rings import Ring, SensorArray
from ssm_service.perception import Fit, FitWeights, SphereFit, sphere_readings

R = 0.05
SILENT = math.inf
ASSUMED = AssumptionsConfig(radius_min_m=R, reading_error_m=0.06)
FREE = FitWeights(up_std=1e6, side_std=1e6)


def make_array(count=8, field_of_view_deg=20.0, heights=(0.106625,), tilt_deg=0.0):
    rings = [
        Ring.from_config(
            RingConfig(
                name=f"ring{i}",
                parent_frame="forearm_link",
                origin_m=(0.0, 0.0, height),
                axis=(0.0, 0.0, 1.0),
                first_direction=(1.0, 0.0, 0.0),
                count=count,
                radius_m=0.0323,
                field_of_view_deg=field_of_view_deg,
                range_max_m=1.2,
                period_s=0.16,
                tilt_deg=tilt_deg,
            )
        )
        for i, height in enumerate(heights)
    ]
    slices = [slice(i * count, (i + 1) * count) for i in range(len(rings))]
    return SensorArray.of_rings("forearm_link", rings, slices, [np.eye(4)] * len(rings))


def readings_of(array, centre, radius=R):
    T = array.transforms_sensor_to_link
    local = np.einsum("kji,kj->ki", T[:, :3, :3], centre - T[:, :3, 3])
    found = np.array(
        [sphere_readings(p, radius, angle) for p, angle in zip(local, array.half_angles, strict=True)]
    )
    return np.where(found > array.ranges_max, SILENT, found)


def ball(rng, most=0.5, height=0.106625):
    """A ball's centre, 1 cm to ``most`` off the ring's cylinder and within 10 cm of the height."""
    bearing, radial = rng.uniform(-math.pi, math.pi), 0.0323 + R + rng.uniform(0.01, most)
    return np.array([radial * math.cos(bearing), radial * math.sin(bearing), height + rng.uniform(-0.1, 0.1)])


def seen(array, seed, count, least=1, most=0.5):
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        centre = ball(rng, most)
        readings = readings_of(array, centre)
        if np.isfinite(readings).sum() >= least:
            found.append((centre, readings))
    return found


@pytest.fixture(scope="module")
def link():
    return LinkDistance(Robot.load("ur3"), "forearm_link")


@pytest.fixture(scope="module")
def fit(link):
    return SphereFit(make_array(), link, ASSUMED)


@pytest.mark.parametrize("tilt_deg", [0.0, 15.0])
def test_a_ball_that_several_rings_determine_is_found_exactly(link, tilt_deg):
    array = make_array(16, 40.0, (0.03, 0.1, 0.17), tilt_deg)
    free = SphereFit(array, link, ASSUMED, FREE)
    for centre, readings in seen(array, 1, 60, least=5, most=0.4):
        if (np.isfinite(readings) != np.isfinite(readings_of(array, centre, 0.96 * R))).any():
            continue  # a cone that is only just grazed: its reading is smoothed
        np.testing.assert_allclose(free.of(readings).centre, centre, rtol=0.0, atol=1e-6)


def test_the_usual_priors_move_such_a_ball_little(link):
    array = make_array(16, 40.0, (0.03, 0.1, 0.17))
    usual = SphereFit(array, link, ASSUMED)
    scenes = seen(array, 2, 100, least=5, most=0.4)
    errors = [abs(usual.of(m).distance - (link.distance(c[np.newaxis])[0] - R)) for c, m in scenes]
    assert np.median(errors) < 0.006
    assert np.max(errors) < 0.03


def test_distance_and_position_are_those_of_the_ball(fit, link):
    for _, readings in seen(fit.array, 3, 50):
        found = fit.of(readings)
        to_centre = link.distance(found.centre[np.newaxis])[0]
        assert found.distance == pytest.approx(max(0.0, to_centre - R), abs=1e-12)
        assert np.linalg.norm(found.position - found.centre) == pytest.approx(min(R, to_centre), abs=1e-9)
        assert link.distance(found.position[np.newaxis])[0] == pytest.approx(found.distance, abs=0.004)
        x, y, _ = found.position
        assert found.bearing == pytest.approx(math.atan2(y, x), abs=1e-12)


def test_many_scans_give_the_very_numbers_of_one(fit):
    readings = np.array([m for _, m in seen(fit.array, 4, 50)] + [np.full(8, SILENT)])
    readings[: len(readings) // 2] += np.random.default_rng(4).uniform(0.0, 0.06, (len(readings) // 2, 8))
    distances, positions = fit.of_many(readings)
    assert distances.shape == (51,)
    assert positions.shape == (51, 3)
    for i, row in enumerate(readings[:-1]):
        found = fit.of(row)
        assert found.distance == distances[i]
        assert found.position.tolist() == positions[i].tolist()
    assert math.isnan(distances[-1])
    assert np.isnan(positions[-1]).all()


def test_turning_the_ring_by_one_sensor_turns_the_ball(fit):
    turn = np.eye(3)
    turn[:2, :2] = [[math.sqrt(0.5), -math.sqrt(0.5)], [math.sqrt(0.5), math.sqrt(0.5)]]
    for _, readings in seen(fit.array, 5, 40):
        turned = fit.of(np.roll(readings, 1)).centre
        np.testing.assert_allclose(turned, turn @ fit.of(readings).centre, rtol=0.0, atol=1e-6)


def test_mirrored_readings_mirror_the_ball(fit):
    for _, readings in seen(fit.array, 6, 40):
        mirrored = fit.of(readings[[0, 7, 6, 5, 4, 3, 2, 1]]).centre
        np.testing.assert_allclose(mirrored * [1.0, -1.0, 1.0], fit.of(readings).centre, rtol=0.0, atol=1e-6)


def test_all_silent_is_no_ball(fit):
    assert fit.of(np.full(8, SILENT)) is None


def test_one_echo_lies_in_its_beam(fit):
    readings = np.full(8, SILENT)
    readings[2] = 0.3
    found = fit.of(readings)
    assert isinstance(found, Fit)
    assert found.sensors == (2,)
    assert found.bearing == pytest.approx(math.pi / 2.0, abs=0.02)
    assert found.distance == pytest.approx(0.3, abs=0.01)
    assert found.distance_std > 0.03


def test_the_echoes_are_named_least_first(fit):
    readings = np.full(8, SILENT)
    readings[[1, 2, 6]] = 0.12, 0.1, 0.5
    assert fit.of(readings).sensors == (2, 1, 6)


def intrusion(array, centre, readings):
    """How far the ball reaches into the cones that were silent, beyond their edges [m]."""
    alone = [readings_of(array, centre, radius) for radius in np.linspace(0.001, R, 50)]
    reached = np.isfinite(alone)[:, ~np.isfinite(readings)].any(axis=1)
    return 0.001 * float(reached.sum())


def test_silences_push_the_ball_out_of_their_cones(link):
    array = make_array(16, 40.0)
    usual = SphereFit(array, link, ASSUMED)
    deaf = SphereFit(array, link, ASSUMED, FitWeights(silence_m=1e6))
    readings = np.full(16, SILENT)
    readings[4] = 0.2  # alone: its neighbours' cones overlap its own
    with_silence, without = usual.of(readings), deaf.of(readings)
    assert intrusion(array, with_silence.centre, readings) < intrusion(array, without.centre, readings)


def test_several_rings_tell_the_side(link):
    array = make_array(16, 40.0, (0.05, 0.16))
    sides = SphereFit(array, link, ASSUMED)
    for height in (0.0, 0.21):
        centre = np.array([0.2, 0.02, height])
        assert abs(sides.of(readings_of(array, centre)).centre[2] - height) < 0.03


def test_an_echo_of_another_part_hardly_moves_the_ball(fit):
    readings = np.full(8, SILENT)
    readings[0] = 0.15
    alone = fit.of(readings).distance
    readings[1] = 0.8
    assert fit.of(readings).distance == pytest.approx(alone, abs=0.01)


def test_two_deviations_hold_the_distance_of_balls(link):
    rng = np.random.default_rng(8)
    for array in (make_array(), make_array(16, 40.0)):
        fit, held = SphereFit(array, link, ASSUMED), []
        for centre, readings in seen(array, 8, 300):
            found = fit.of(np.clip(readings + rng.uniform(-0.06, 0.06, len(readings)), 0.0, None))
            truth = link.distance(centre[np.newaxis])[0] - R
            held.append(abs(found.distance - truth) <= 2.0 * found.distance_std)
        assert np.mean(held) > 0.93


def test_the_deviation_follows_the_declared_error(link):
    readings = readings_of(make_array(), np.array([0.2, 0.05, 0.12]))
    deviations = [
        SphereFit(make_array(), link, AssumptionsConfig(reading_error_m=error)).of(readings).distance_std
        for error in (0.0, 0.02, 0.06)
    ]
    assert deviations == sorted(deviations)
    assert deviations[0] < 0.5 * deviations[2]


def test_a_ball_at_the_link_has_distance_0(fit):
    found = fit.of(np.array([0.0, 0.0, *[SILENT] * 6]))
    assert found.distance < 0.01
    assert np.isfinite(found.position).all()


def test_the_assumed_radius_is_used(link):
    wide = AssumptionsConfig(radius_min_m=0.05, assumed_radius_m=0.1, reading_error_m=0.06)
    assert SphereFit(make_array(), link, wide).radius == 0.1
    assert SphereFit(make_array(), link, ASSUMED).radius == R


@pytest.mark.parametrize(
    ("readings", "cause"),
    [
        (np.full(7, 0.1), "wrong_length"),
        (np.full((1, 8), 0.1), "wrong_length"),
        (np.array([math.nan, *[0.1] * 7]), "not_finite"),
        (np.array([-0.1, *[0.1] * 7]), "out_of_range"),
    ],
)
def test_bad_readings_are_refused(fit, readings, cause):
    with pytest.raises(InputError) as caught:
        fit.of(readings)
    assert caught.value.cause == cause
    if readings.ndim == 1:
        with pytest.raises(InputError) as caught:
            fit.of_many(readings[np.newaxis])
        assert caught.value.cause == cause


def test_another_links_distance_is_refused():
    with pytest.raises(InputError, match="forearm_link"):
        SphereFit(make_array(), LinkDistance(Robot.load("ur3"), "upper_arm_link"), ASSUMED)


@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_weights_are_checked(value):
    with pytest.raises(InputError, match="silence_m"):
        FitWeights(silence_m=value)

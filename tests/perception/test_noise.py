import math

import numpy as np
import pytest

from ssm_service.config import RingConfig, SimulatedSensorConfig
from ssm_service.errors import InputError
from ssm_service.model.rings import Ring
from ssm_service.perception import SimulatedSensorModel

COUNT = 40_000


def model(range_max=1.2, **errors):
    return SimulatedSensorModel(config=SimulatedSensorConfig(**errors), range_max=range_max)


def test_off_by_default():
    ideal = np.array([0.0, 0.3, 1.2, math.inf, 0.123456789])
    before = ideal.copy()
    out = model().apply(ideal, np.random.default_rng(0))
    assert out.tolist() == before.tolist()
    assert ideal.tolist() == before.tolist()
    assert out is not ideal


def test_bias_and_gaussian_noise():
    out = model(noise_std_m=0.02, bias_m=0.05).apply(np.full(COUNT, 0.6), np.random.default_rng(1))
    error = out - 0.6
    assert error.mean() == pytest.approx(0.05, abs=5 * 0.02 / math.sqrt(COUNT))
    assert error.std() == pytest.approx(0.02, rel=0.02)
    standard = (error - 0.05) / 0.02
    assert np.mean(np.abs(standard) < 1.0) == pytest.approx(0.6827, abs=0.012)
    assert np.mean(np.abs(standard) < 2.0) == pytest.approx(0.9545, abs=0.006)
    assert abs(np.corrcoef(error[:-1], error[1:])[0, 1]) < 0.025


def test_quantisation_rounds_to_the_nearest_step():
    ideal = np.random.default_rng(2).uniform(0.0, 1.2, 5000)
    out = model(resolution_m=0.01).apply(ideal, np.random.default_rng(2))
    assert np.abs(out / 0.01 - np.round(out / 0.01)).max() < 1e-9
    assert np.abs(out - ideal).max() <= 0.005 + 1e-12
    assert (out - ideal).mean() == pytest.approx(0.0, abs=3e-4)


def test_dropout_rate_and_extremes():
    ideal = np.full(COUNT, 0.5)
    lost = np.isinf(model(dropout_probability=0.1).apply(ideal, np.random.default_rng(3)))
    assert lost.mean() == pytest.approx(0.1, abs=5 * math.sqrt(0.09 / COUNT))
    assert np.isinf(model(dropout_probability=1.0).apply(ideal, np.random.default_rng(3))).all()


def test_silence_stays_silence():
    silent = np.full(COUNT, math.inf)
    out = model(noise_std_m=1.0, bias_m=-1.0, resolution_m=0.1).apply(silent, np.random.default_rng(4))
    assert np.isinf(out).all()


def test_beyond_range_is_no_echo_and_below_zero_is_zero():
    ideal = np.array([1.2, math.nextafter(1.2, 0.0), 0.02])
    generator = np.random.default_rng(5)
    assert model(bias_m=0.001).apply(ideal, generator).tolist() == [math.inf, math.inf, pytest.approx(0.021)]
    assert model(bias_m=-0.05).apply(ideal, generator).tolist() == [
        pytest.approx(1.15),
        pytest.approx(1.15),
        0.0,
    ]
    # Rounding up at the far end clamps; it does not lose the echo.
    assert model(resolution_m=0.1, range_max=1.16).apply(np.array([1.159]), generator).tolist() == [1.16]
    assert model(resolution_m=0.001).apply(np.array([1.2]), generator).tolist() == [1.2]


def test_readings_stay_within_the_device():
    ideal = np.random.default_rng(6).uniform(0.0, 1.2, COUNT)
    out = model(noise_std_m=0.3, bias_m=0.1, resolution_m=0.07).apply(ideal, np.random.default_rng(6))
    echoes = out[np.isfinite(out)]
    assert echoes.min() == 0.0
    assert echoes.max() <= 1.2
    assert 0 < len(echoes) < COUNT


def test_one_seed_one_result_and_the_same_advance_whatever_the_settings():
    ideal = np.array([0.5, math.inf, 0.7])
    noisy = model(noise_std_m=0.05, dropout_probability=0.2)
    first, second = np.random.default_rng(7), np.random.default_rng(7)
    one = [noisy.apply(ideal, first).tolist() for _ in range(20)]
    assert one == [noisy.apply(ideal, second).tolist() for _ in range(20)]
    plain = np.random.default_rng(7)
    for _ in range(20):
        model().apply(np.full(3, math.inf), plain)
    assert plain.random() == first.random()


def test_of_ring_takes_the_rings_errors_and_range():
    ring = Ring.from_config(
        RingConfig(
            name="r",
            parent_frame="p",
            origin_m=(0.0, 0.0, 0.0),
            count=4,
            radius_m=0.05,
            field_of_view_deg=20.0,
            range_max_m=0.9,
            period_s=0.1,
            simulated=SimulatedSensorConfig(bias_m=0.1),
        )
    )
    out = SimulatedSensorModel.of_ring(ring).apply(np.array([0.5, 0.85]), np.random.default_rng(0))
    assert out.tolist() == [pytest.approx(0.6), math.inf]


@pytest.mark.parametrize(
    ("ranges", "cause"),
    [
        (np.ones((2, 2)), "wrong_length"),
        (np.array([np.nan]), "not_finite"),
        (np.array([-1.0]), "out_of_range"),
    ],
)
def test_bad_readings_are_refused(ranges, cause):
    with pytest.raises(InputError) as caught:
        model().apply(ranges, np.random.default_rng(0))
    assert caught.value.cause == cause


@pytest.mark.parametrize("range_max", [0.0, -1.0, math.inf, math.nan])
def test_bad_range_is_refused(range_max):
    with pytest.raises(InputError):
        model(range_max=range_max)

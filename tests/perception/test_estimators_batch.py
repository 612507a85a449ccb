"""Many scans at once say what each says alone: numbers, sensors and reasons."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ssm_service.errors import InputError
from ssm_service.model import Ring, Robot
from ssm_service.perception.estimators import estimate
from ssm_service.perception.estimators_batch import REASONS, estimate_many

NAMES = ("as_printed", "corrected", "nearest")


@pytest.fixture(scope="module")
def config():
    return Robot.load("ur3").config.file.rings[0]


def ring_of(config, count):
    return Ring.from_config(msgspec.structs.replace(config, count=count))


def scans(count, number, seed):
    """Return echoes and silences of all kinds: equal ones, zeros, far ones, near neighbours."""
    rng = np.random.default_rng(seed)
    readings = rng.uniform(0.0, 0.3, (number, 1)) + rng.uniform(0.0, 0.06, (number, count))
    readings = np.where(rng.random((number, 1)) < 0.2, np.round(readings, 2), readings)
    readings[rng.random((number, count)) < rng.uniform(0.0, 1.0, (number, 1))] = math.inf
    readings[rng.random((number, count)) < 0.02] = 0.0
    return readings


def pose(seed):
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T[:3, 3] = rng.normal(size=3)
    return T


@pytest.mark.parametrize("count", [1, 2, 3, 8, 17])
def test_many_scans_say_what_each_says_alone(config, count):
    ring, T = ring_of(config, count), pose(count)
    readings = scans(count, 1500, seed=count)
    many = estimate_many(ring, readings, T)
    assert tuple(many) == NAMES
    seen = set()
    for i, row in enumerate(readings):
        alone = estimate(ring, row, T)
        for name in NAMES:
            got, wanted = many[name], getattr(alone, name)
            reason = REASONS[got.reasons[i]]
            seen.add((name, reason))
            assert reason == alone.reasons.get(name, "")
            if wanted is None:
                assert np.isnan([got.distances[i], got.bearings[i], *got.positions[i]]).all()
                assert got.sensors[i].tolist() == [0, 0]
                continue
            assert got.distances[i] == pytest.approx(wanted.distance, abs=1e-12)
            assert tuple(s for s in got.sensors[i].tolist() if s) == wanted.sensors
            if wanted.bearing is None:
                assert np.isnan([got.bearings[i], *got.positions[i]]).all()
            else:
                assert -math.pi < got.bearings[i] <= math.pi
                turn = math.remainder(got.bearings[i] - wanted.bearing, 2.0 * math.pi)
                assert turn == pytest.approx(0.0, abs=1e-12)  # −π + 1 ulp is the same bearing as π
                assert got.positions[i] == pytest.approx(wanted.position, abs=1e-12)
    if count == 8:
        assert seen >= {("corrected", reason) for reason in REASONS}


def test_a_bearing_straight_behind_is_plus_pi(config):
    readings = np.full((1, 8), math.inf)
    readings[0, 4] = 0.2
    assert estimate_many(ring_of(config, 8), readings, np.eye(4))["nearest"].bearings[0] == math.pi


def test_no_scan_gives_nothing(config):
    many = estimate_many(ring_of(config, 8), np.empty((0, 8)), np.eye(4))
    assert all(len(found.distances) == 0 for found in many.values())


@pytest.mark.parametrize(
    ("cause", "readings", "T"),
    [
        ("wrong_length", np.ones(8), np.eye(4)),
        ("wrong_length", np.ones((2, 7)), np.eye(4)),
        ("not_finite", np.full((2, 8), math.nan), np.eye(4)),
        ("out_of_range", np.full((2, 8), -0.1), np.eye(4)),
        ("wrong_length", np.ones((2, 8)), np.eye(3)),
        ("not_finite", np.ones((2, 8)), np.full((4, 4), math.inf)),
    ],
)
def test_what_is_no_scan_is_refused(config, cause, readings, T):
    with pytest.raises(InputError) as caught:
        estimate_many(ring_of(config, 8), readings, T)
    assert caught.value.cause == cause

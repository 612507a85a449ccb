"""``lower_bound`` against brute force and random scenes; its monotony, contradictions and corner cases."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench.bound_scenes import CASES, LINK, Case, draw, sensors
from bench.brute import MeshTruth, disagreement, least_ball, predicted
from ssm_service.config import AssumptionsConfig
from ssm_service.errors import InputError
from ssm_service.model import LinkDistance, Robot
from ssm_service.perception import LowerBound

EXACT = Case(design="ur3", radius_min=0.05, radius_max=0.05, error=0.0)
USUAL = Case(design="ur3", radius_min=0.05, radius_max=0.15, error=0.01)


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


@pytest.fixture(scope="module")
def truth(robot):
    return MeshTruth(robot, LINK)


@pytest.fixture(scope="module")
def surface(robot):
    return LinkDistance(robot, LINK)


@pytest.fixture(scope="module")
def make(robot, surface):
    def make(case):
        array = sensors(robot, case.design)
        return array, LowerBound(array, surface, case.assumptions)

    return make


def silence(array, **echoes):
    readings = np.full(len(array.half_angles), math.inf)
    for name, value in echoes.items():
        readings[int(name[1:])] = value
    return readings


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.design}-{case.balls}-{case.error}")
def test_never_above_the_truth(make, truth, case):
    array, bound = make(case)
    count = {"covered": 40, "wide": 300}.get(case.design, 900)
    readings, distances, _, _ = draw(case, array, truth, count, np.random.default_rng(7))
    bounds = bound.of_many(readings)
    assert not np.isnan(bounds).any()
    assert (bounds <= distances + 1e-7).all()
    assert case.many or (bounds[np.isfinite(readings).any(axis=1)] > 0.0).any()


@pytest.mark.parametrize(
    "case", [CASES[1], CASES[2], CASES[3]], ids=lambda case: f"{case.design}-{case.error}"
)
def test_within_a_millimetre_of_brute_force(make, truth, case):
    array, bound = make(case)
    rng = np.random.default_rng(11)
    readings, _, centres, radii = draw(case, array, truth, 800, rng)
    echoes = np.isfinite(readings).sum(axis=1)
    chosen = [*np.flatnonzero(echoes > 1)[:2], *np.flatnonzero(echoes == 1)[:4]]
    for i in chosen:
        found = bound.of(readings[i])
        hints = centres[i], radii[i]
        if found.centre is not None:  # what is wrong with it, if anything, the search finds out
            hints = np.vstack([hints[0], found.centre]), np.append(hints[1], found.radius)
        least = least_ball(truth, array, case.assumptions, readings[i], rng, hints)
        assert least.distance - 1e-3 <= found.distance <= least.distance + 1e-6


def test_the_ball_that_attains_it_explains_the_readings(make, truth):
    array, bound = make(USUAL)
    readings, _, _, _ = draw(USUAL, array, truth, 300, np.random.default_rng(3))
    shown = 0
    for scan in readings[np.isfinite(readings).any(axis=1)][:40]:
        found = bound.of(scan)
        if found.centre is None:
            continue
        shown += 1
        assert USUAL.radius_min <= found.radius <= USUAL.radius_max
        # It may graze the edge of a cone, to 0.1 µm: in from one that hears it, out from one that does not.
        larger, smaller = (
            predicted(array, found.centre[np.newaxis], np.array([found.radius + step]))
            for step in (1e-6, -1e-6)
        )
        ideal = np.where(np.isfinite(scan), larger, smaller)
        assert disagreement(array, ideal, scan, USUAL.error)[0] < 1.5e-3
        assert truth.exact(found.centre[np.newaxis])[0] - found.radius >= found.distance - 1e-3
    assert shown > 10


def test_the_price_of_the_gap(make, truth):
    """One echo at 0.2 m, exactly: the ball that only just grazes the cone, held against the mesh."""
    array, bound = make(EXACT)
    found = bound.of(silence(array, s0=0.2)).distance
    T_link_sensor, alpha, best = array.transforms_sensor_to_link[0], array.half_angles[0], math.inf
    for turn in np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False):
        along, across = 0.2, 0.05  # in the plane of the edge ray: on it, and square to it
        axial = along * math.cos(alpha) - across * math.sin(alpha)
        off = along * math.sin(alpha) + across * math.cos(alpha)
        local = np.array([axial, off * math.cos(turn), off * math.sin(turn)])
        centre = T_link_sensor[:3, :3] @ local + T_link_sensor[:3, 3]
        best = min(best, truth.exact(centre[np.newaxis])[0] - 0.05)
    assert best - 1e-3 <= found <= best + 1e-6
    assert found < math.hypot(0.2, 0.05) - 0.05 + 0.0045  # SCIENCE 4, and the ring's radius less the link's
    assert found < 0.2


def test_single_echoes_rise_and_fall_with_what_they_say(make):
    array, exact = make(EXACT)
    _, loose = make(Case(design="ur3", radius_min=0.05, radius_max=0.05, error=0.02))
    _, larger = make(Case(design="ur3", radius_min=0.05, radius_max=0.1, error=0.0))
    places = np.arange(0.03, 1.19, 0.037)
    scans = np.array([silence(array, s2=place) for place in places])
    bounds = exact.of_many(scans)
    assert (np.diff(bounds) > -1e-3).all()
    assert (loose.of_many(scans) <= bounds + 6e-4).all()
    assert (larger.of_many(scans) <= bounds + 6e-4).all()
    np.testing.assert_allclose([exact.of(scan).distance for scan in scans], bounds, atol=1e-12)


def test_silence_and_many(make):
    array, bound = make(USUAL)
    assert bound.silent == bound.of(silence(array)).distance == 0.0
    _, many = make(Case(design="ur3", radius_min=0.05, radius_max=0.15, error=0.01, many=True))
    assert many.of(silence(array, s0=0.2)).distance == 0.0


def test_covered_design_promises_something_of_silence(make):
    array, bound = make(CASES[6])
    assert 1.0 < bound.silent < 1.3
    assert bound.of_many(silence(array)[np.newaxis])[0] == bound.silent
    # A single echo near by is nobody's: all its neighbours would see a ball of 5 cm there.
    assert bound.of(silence(array, s40=0.1)).distance is None
    assert np.isnan(bound.of_many(silence(array, s40=0.1)[np.newaxis])[0])


def test_contradictions(make):
    array, bound = make(EXACT)
    assert bound.of(silence(array, s0=0.3, s4=0.3)).distance is None
    assert bound.of(silence(array, s0=0.3, s4=0.3)).centre is None
    assert math.isnan(bound.of_many(silence(array, s0=0.3, s4=0.3)[np.newaxis])[0])


def test_own_echoes_only_clear_their_cone(make):
    array, bound = make(USUAL)
    scan = silence(array, s0=0.3, s4=0.3)
    own = np.zeros(8, dtype=bool)
    own[4] = True
    known = bound.of(scan, own)
    alone = bound.of(silence(array, s0=0.3))
    assert 0.0 < known.distance <= alone.distance + 1e-3
    assert bound.of(scan, np.ones(8, dtype=bool)).distance == 0.0  # anything may hide
    assert bound.of(silence(array, s4=0.3), own).distance == 0.0


def test_a_reading_at_the_least_range_may_come_from_anything_nearer(make):
    array, bound = make(Case(design="clamped", radius_min=0.05, radius_max=0.05, error=0.0))
    assert bound.of(silence(array, s0=0.2)).distance < 0.01
    assert bound.of(silence(array, s0=0.21)).distance > 0.1
    assert bound.of(silence(array, s0=0.05)).distance < 0.01  # less than the device can say: as range_min


def test_more_echoes_of_many_balls_only_lower_it(make, truth):
    array, bound = make(CASES[6])
    readings, _, _, _ = draw(CASES[6], array, truth, 30, np.random.default_rng(5))
    bounds = bound.of_many(readings[:10])
    assert (bounds <= bound.silent + 1e-12).all()


def test_refuses_bad_readings(make, robot, surface):
    array, bound = make(USUAL)
    with pytest.raises(InputError):
        bound.of(np.zeros(7))
    with pytest.raises(InputError):
        bound.of(np.full(8, np.nan))
    with pytest.raises(InputError):
        bound.of(np.full(8, -0.1))
    with pytest.raises(InputError):
        bound.of_many(np.zeros((2, 7)))
    with pytest.raises(InputError):
        bound.of(silence(array, s0=0.2), np.zeros(3, dtype=bool))
    with pytest.raises(InputError, match="upper_arm_link"):
        LowerBound(array, LinkDistance(robot, "upper_arm_link"), USUAL.assumptions)


def test_a_reading_of_the_least_range_and_all_of_the_error_says_nothing():
    """0.02 + 0.06 − 0.06 comes out above 0.02 in floating point; what reads 0.02 may touch the sensor."""
    robot = Robot.load("ur3_covered")
    array = next(array for array in robot.sensor_arrays if array.link == "forearm_link")
    bound = LowerBound(
        array,
        LinkDistance(robot, array.link),
        AssumptionsConfig(radius_min_m=0.08, radius_max_m=0.1, reading_error_m=0.06, obstacles="many"),
    )
    assert array.ranges_min[0] < 0.08 - 0.06
    readings = np.full(len(array.indices), np.inf)
    readings[[7, 8, 12, 14, 18, 20]] = 0.0, 0.0, 0.3246, 0.08, 0.4267, 0.0
    nudged = readings.copy()
    nudged[14] = np.nextafter(0.08, 0.0)
    assert bound.of(readings).distance == bound.of(nudged).distance

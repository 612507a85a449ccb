import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from raycast import random_pose

from ssm_service.config import RingConfig
from ssm_service.errors import InputError
from ssm_service.model.rings import Ring
from ssm_service.model.shapes import Obstacle
from ssm_service.perception import estimate, estimators, scan

SILENT = math.inf


def make_ring(count=8, radius=0.0323, field_of_view_deg=20.0):
    return Ring.from_config(
        RingConfig(
            name="forearm",
            parent_frame="forearm_link",
            origin_m=(0.0, 0.0, 0.1),
            count=count,
            radius_m=radius,
            field_of_view_deg=field_of_view_deg,
            range_max_m=3.0,
            period_s=0.16,
        )
    )


def ideal_ranges(ring, radial, bearing, sensors):
    """Exact distances of a point in the ring's plane from the named sensors (from 1), else silence."""
    point = np.array([radial * math.cos(bearing), radial * math.sin(bearing), 0.0])
    ranges = np.full(ring.count, SILENT)
    for sensor in sensors:
        ranges[sensor - 1] = np.linalg.norm(point - ring.transform_sensors_to_ring[sensor - 1, :3, 3])
    return ranges, point


def wrapped(angle):
    return math.atan2(math.sin(angle), math.cos(angle))


def eight(**echoes):
    ranges = np.full(8, SILENT)
    for name, value in echoes.items():
        ranges[int(name[1:]) - 1] = value
    return ranges


@pytest.mark.parametrize("count", [3, 5, 8, 16])
def test_corrected_is_exact_for_a_point_between_any_two_neighbours(count):
    rng = np.random.default_rng(count)
    ring = make_ring(count=count)
    pitch = 2.0 * math.pi / count
    for first in range(count):
        for _ in range(10):
            share = rng.uniform(0.02, 0.98)
            second = (first + 1) % count
            gap = rng.uniform(0.01, 1.0)
            bearing = (first + share) * pitch
            pose = random_pose(rng)
            ranges, point = ideal_ranges(ring, ring.radius + gap, bearing, (first + 1, second + 1))
            found = estimate(ring, ranges, pose)
            assert found.corrected is not None
            assert found.corrected.distance == pytest.approx(gap, abs=1e-9)
            assert wrapped(found.corrected.bearing - bearing) == pytest.approx(0.0, abs=1e-9)
            assert -math.pi < found.corrected.bearing <= math.pi
            assert found.corrected.position == pytest.approx(pose[:3, :3] @ point + pose[:3, 3], abs=1e-9)
            nearer_first = share < 0.5
            expected = (first + 1, second + 1) if nearer_first else (second + 1, first + 1)
            assert found.corrected.sensors == found.as_printed.sensors == expected
            assert found.reasons == {}


def test_corrected_through_the_reading_model_of_a_widened_ring():
    ring = make_ring(field_of_view_deg=160.0)
    rng = np.random.default_rng(2)
    for _ in range(60):
        gap, bearing = rng.uniform(0.05, 1.0), rng.uniform(-math.pi, math.pi)
        pose = random_pose(rng)
        radial = ring.radius + gap
        point = pose[:3, :3] @ [radial * math.cos(bearing), radial * math.sin(bearing), 0.0] + pose[:3, 3]
        ball = Obstacle(id="p", shape="sphere", size=(1e-9,), position=tuple(point))
        ranges = scan([ball], pose @ ring.transform_sensors_to_ring, ring.half_angle, ring.range_max)
        assert np.isfinite(ranges).sum() >= 2
        found = estimate(ring, ranges, pose)
        assert found.corrected.distance == pytest.approx(gap, abs=1e-7)
        assert found.corrected.position == pytest.approx(point, abs=1e-7)
        assert wrapped(found.corrected.bearing - bearing) == pytest.approx(0.0, abs=1e-6)
        assert found.nearest.distance >= gap - 1e-7


def test_as_printed_is_short_by_about_the_radius():
    ring = make_ring()
    ranges, _ = ideal_ranges(ring, ring.radius + 0.268, math.pi / 8, (1, 2))
    found = estimate(ring, ranges, np.eye(4))
    assert found.corrected.distance == pytest.approx(0.268, abs=1e-9)
    assert found.as_printed.distance == pytest.approx(0.239, abs=5e-4)
    assert found.as_printed.position is None
    assert found.as_printed.bearing is None
    for gap, share in itertools.product((0.05, 0.2, 0.6, 1.0), (0.1, 0.5, 0.8)):
        ranges, _ = ideal_ranges(ring, ring.radius + gap, share * math.pi / 4, (1, 2))
        found = estimate(ring, ranges, np.eye(4))
        short = found.corrected.distance - found.as_printed.distance
        assert 0.45 * ring.radius < short < 1.2 * ring.radius
        if gap >= 0.2 and share == 0.5:
            assert short == pytest.approx(ring.radius, rel=0.15)


def test_as_printed_is_the_papers_formula_for_eight_sensors():
    ring = make_ring(radius=0.05)
    r, d1, d2 = 0.05, 0.2, 0.21
    cos = (d1**2 + (2 - math.sqrt(2)) * r**2 - d2**2) / (2 * d1 * r * math.sqrt(2 - math.sqrt(2)))
    phi = math.acos(cos)
    printed = math.sqrt(r**2 + d1**2 - 2 * d1 * r * cos) - r
    corrected = math.sqrt(r**2 + d1**2 - 2 * d1 * r * math.cos(phi + 3 * math.pi / 8)) - r
    found = estimate(ring, eight(s4=d1, s3=d2), np.eye(4))
    assert found.as_printed.distance == pytest.approx(printed, abs=1e-12)
    assert found.corrected.distance == pytest.approx(corrected, abs=1e-12)


def test_as_printed_is_given_as_it_is_even_when_negative():
    ring = make_ring()
    ranges, _ = ideal_ranges(ring, ring.radius + 0.005, math.pi / 8, (1, 2))
    found = estimate(ring, ranges, np.eye(4))
    assert found.corrected.distance == pytest.approx(0.005, abs=1e-9)
    assert found.as_printed.distance < 0.0


@pytest.mark.parametrize("first", range(1, 9))
def test_the_second_sensor_on_either_side_mirrors_the_bearing(first):
    ring = make_ring()
    after, before = first % 8 + 1, (first - 2) % 8 + 1
    own = (first - 1) * math.pi / 4
    one = estimate(ring, eight(**{f"s{first}": 0.2, f"s{after}": 0.21}), np.eye(4))
    other = estimate(ring, eight(**{f"s{first}": 0.2, f"s{before}": 0.21}), np.eye(4))
    assert one.corrected.sensors == (first, after)
    assert other.corrected.sensors == (first, before)
    assert one.corrected.distance == pytest.approx(other.corrected.distance, abs=1e-12)
    offset = wrapped(one.corrected.bearing - own)
    assert 0.0 < offset < math.pi / 8
    assert wrapped(other.corrected.bearing - own) == pytest.approx(-offset, abs=1e-12)


def test_the_lesser_neighbour_is_taken_and_other_sensors_do_not_matter():
    ring = make_ring()
    found = estimate(ring, eight(s1=0.2, s2=0.22, s8=0.21, s5=0.205), np.eye(4))
    assert found.corrected.sensors == (1, 8)
    assert estimate(ring, eight(s1=0.2, s2=0.21, s8=0.22), np.eye(4)).corrected.sensors == (1, 2)
    assert estimate(ring, eight(s1=0.2, s2=0.21, s8=0.21), np.eye(4)).corrected.sensors == (1, 2)
    assert estimate(ring, eight(s7=0.2, s8=0.2), np.eye(4)).corrected.sensors == (7, 8)


@pytest.mark.parametrize("first", range(1, 9))
def test_nearest_is_the_least_reading_in_its_sensors_direction(first):
    ring, pose = make_ring(), random_pose(np.random.default_rng(first))
    found = estimate(ring, eight(**{f"s{first}": 0.3, f"s{(first + 3) % 8 + 1}": 0.4}), pose).nearest
    sensor = pose @ ring.transform_sensors_to_ring[first - 1]
    assert found.distance == 0.3
    assert found.position == pytest.approx(sensor[:3, 3] + 0.3 * sensor[:3, 0], abs=1e-12)
    assert wrapped(found.bearing - (first - 1) * math.pi / 4) == pytest.approx(0.0, abs=1e-12)
    assert -math.pi < found.bearing <= math.pi
    assert found.sensors == (first,)


def test_bearing_of_the_opposite_sensor_is_plus_pi():
    assert estimate(make_ring(), eight(s5=0.3), np.eye(4)).nearest.bearing == math.pi


@pytest.mark.parametrize("turns", [-1.5, -0.5, 0.5, 1.5])
def test_bearings_lie_above_minus_pi(turns):
    assert estimators._wrapped(2.0 * math.pi * turns) == math.pi


def test_contact_where_the_triangle_closes_to_nothing_divides_by_nothing():
    ring = make_ring()
    chord = 2.0 * ring.radius * math.sin(math.pi / 8)
    found = estimate(ring, eight(s8=0.0, s1=chord), np.eye(4))
    assert found.reasons == {"as_printed": "no_triangle", "corrected": "no_triangle"}
    assert found.nearest.distance == 0.0


@pytest.mark.parametrize(
    ("echoes", "reason"),
    [
        ({"s1": 0.2}, "one_echo"),
        ({"s1": 0.0}, "one_echo"),
        ({"s1": 0.2, "s3": 0.2}, "not_neighbours"),
        ({"s1": 0.2, "s4": 0.25, "s5": 0.25}, "not_neighbours"),
        ({"s1": 0.2, "s2": 0.3}, "no_triangle"),  # the readings differ by more than the chord
        ({"s8": 0.0, "s1": 0.01}, "no_triangle"),
        ({"s8": 0.0, "s1": 0.0}, "no_triangle"),
        ({"s1": 1e-320, "s2": 0.0247}, "no_triangle"),
        ({"s1": 0.001, "s2": 0.002}, "no_triangle"),  # the readings together are shorter than the chord
    ],
)
def test_reasons(echoes, reason):
    found = estimate(make_ring(), eight(**echoes), np.eye(4))
    assert found.as_printed is None
    assert found.corrected is None
    assert found.nearest is not None
    assert found.reasons == {"as_printed": reason, "corrected": reason}
    assert found.nearest.distance == min(echoes.values())


def test_an_obstacle_inside_the_link_is_no_triangle_for_corrected_only():
    ring = make_ring()
    chord = 2 * ring.radius * math.sin(math.pi / 8)
    found = estimate(ring, eight(s1=0.5001 * chord, s2=0.5001 * chord), np.eye(4))
    assert found.corrected is None
    assert found.reasons == {"corrected": "no_triangle"}
    assert found.as_printed is not None


def test_silence_gives_nothing():
    found = estimate(make_ring(), np.full(8, SILENT), np.eye(4))
    assert (found.as_printed, found.corrected, found.nearest) == (None, None, None)
    assert found.reasons == dict.fromkeys(("as_printed", "corrected", "nearest"), "no_echo")


def test_rings_of_one_and_two_sensors():
    found = estimate(make_ring(count=1), np.array([0.2]), np.eye(4))
    assert found.nearest.distance == 0.2
    assert found.reasons == {"as_printed": "one_echo", "corrected": "one_echo"}
    ring = make_ring(count=2)
    ranges, _ = ideal_ranges(ring, ring.radius + 0.3, 1.2, (1, 2))
    found = estimate(ring, ranges, np.eye(4)).corrected
    assert found.distance == pytest.approx(0.3, abs=1e-9)
    assert found.position is None  # two sensors face to face do not tell the sides apart
    assert found.bearing is None


@settings(derandomize=True, deadline=None, max_examples=200)
@given(
    ranges=st.lists(st.one_of(st.just(SILENT), st.floats(0.0, 3.0)), min_size=8, max_size=8),
    shift=st.integers(0, 7),
)
def test_every_scan_gives_an_estimate_or_a_reason_and_turns_with_the_ring(ranges, shift):
    ring = make_ring()
    found = estimate(ring, np.array(ranges), np.eye(4))
    for name in ("as_printed", "corrected", "nearest"):
        value = getattr(found, name)
        assert (value is None) == (name in found.reasons)
        if value is None:
            continue
        assert math.isfinite(value.distance)
        if value.position is not None:
            assert value.distance >= 0.0
            x, y, z = value.position
            assert math.hypot(x, y) == pytest.approx(ring.radius + value.distance, abs=1e-9)
            assert wrapped(math.atan2(y, x) - value.bearing) == pytest.approx(0.0, abs=1e-9)
            assert z == 0.0
    if len(set(ranges) - {SILENT}) < sum(r < SILENT for r in ranges):
        return  # equal readings: the first in the ring's order is taken, which does not turn
    turned = estimate(ring, np.roll(ranges, shift), np.eye(4))
    for name in ("as_printed", "corrected", "nearest"):
        before, after = getattr(found, name), getattr(turned, name)
        assert (before is None) == (after is None)
        if before is None:
            continue
        assert after.distance == pytest.approx(before.distance, abs=1e-12)
        assert after.sensors == tuple((s - 1 + shift) % 8 + 1 for s in before.sensors)
        if before.bearing is not None:
            turn = wrapped(after.bearing - before.bearing - shift * math.pi / 4)
            assert turn == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("ranges", "pose", "cause", "where"),
    [
        (np.full(7, 1.0), np.eye(4), "wrong_length", "ranges"),
        (np.full(8, np.nan), np.eye(4), "not_finite", "ranges"),
        (np.full(8, -1.0), np.eye(4), "out_of_range", "ranges"),
        (np.full(8, -np.inf), np.eye(4), "out_of_range", "ranges"),
        (np.full(8, 1.0), np.eye(3), "wrong_length", "transform_ring_to_base"),
        (np.full(8, 1.0), np.full((4, 4), np.nan), "not_finite", "transform_ring_to_base"),
    ],
)
def test_bad_input_is_refused(ranges, pose, cause, where):
    with pytest.raises(InputError) as caught:
        estimate(make_ring(), ranges, pose)
    assert (caught.value.cause, caught.value.where) == (cause, where)

"""Coverage against closed forms, sampling, the reading model and Coal."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from coverage_kit import cones_round, sensed_ball
from numpy.typing import NDArray

from ssm_service.errors import InputError
from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.perception import sphere_readings
from ssm_service.perception.coverage import (
    SensedLink,
    clear_distance,
    gap_edges,
    largest_unseen,
    main_ring,
    place_shares,
    ring_shares,
    sensed_links,
)
from ssm_service.perception.coverage_cones import Cones

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def ur3() -> Robot:
    return Robot.load("ur3")


@pytest.fixture(scope="module")
def covered() -> Robot:
    return Robot.load("ur3_covered")


@pytest.fixture(scope="module")
def covered_links(covered: Robot) -> tuple[SensedLink, ...]:
    return sensed_links(covered)


def seen(cones: Cones, centre: Array, radius: float) -> bool:
    """Ask the reading model, sensor by sensor."""
    for apex, axis, half, reach in zip(
        cones.apexes, cones.axes, cones.half_angles, cones.reaches, strict=True
    ):
        along = float((centre - apex) @ axis)
        beside = float(np.linalg.norm(centre - apex - along * axis))
        if sphere_readings(np.array([along, beside, 0.0]), radius, float(half)) <= reach:
            return True
    return False


def test_a_ball_is_seen_exactly_where_the_reading_model_has_an_echo(ur3: Robot) -> None:
    (link,) = sensed_links(ur3)
    rng = np.random.default_rng(3)
    centres = rng.uniform(-0.6, 0.8, (4000, 3))
    centres[:500] *= 2.5  # beyond the range
    for radius in (0.02, 0.05, 0.3):
        found = link.cones.least_distances(centres) <= radius
        assert found.tolist() == [seen(link.cones, centre, radius) for centre in centres]
        assert (link.cones.counts(centres, np.array([radius]))[0] > 0).tolist() == found.tolist()
        assert 0.02 < found.mean() < 0.98


def test_distance_from_the_cones_changes_no_faster_than_the_place() -> None:
    cones = cones_round(5, 0.05, 25.0, 0.7)
    rng = np.random.default_rng(5)
    a = rng.uniform(-1.0, 1.0, (3000, 3))
    b = a + rng.normal(0.0, 0.05, (3000, 3))
    change = np.abs(cones.least_distances(a) - cones.least_distances(b))
    assert (change <= np.linalg.norm(a - b, axis=1) + 1e-12).all()


def test_a_silence_is_certain_only_up_to_the_range_less_the_error(ur3: Robot) -> None:
    exact, cautious = (sensed_links(ur3, error)[0].cones for error in (0.0, 0.06))
    np.testing.assert_allclose(exact.reaches, 1.2)
    np.testing.assert_allclose(cautious.reaches, 1.14)
    np.testing.assert_allclose(sensed_links(ur3)[0].cones.reaches, 1.14)  # the file's assumptions
    with pytest.raises(InputError):
        sensed_links(ur3, 1.2)


def test_the_arm_in_the_way_takes_reach_and_gives_none(covered: Robot) -> None:
    free, folded = (
        sensed_links(covered, position=position)
        for position in (None, np.array([0.0, -1.2, 2.4, 0.0, 0.0, 0.0]))
    )
    less = [a.cones.reaches - b.cones.reaches for a, b in zip(free, folded, strict=True)]
    assert all((row >= 0.0).all() for row in less)
    assert any((row > 0.0).any() for row in less)


def test_nothing_is_clear_where_a_ball_can_touch_unseen() -> None:
    # One sensor on the side of a ball looks up: below, a ball touches unseen.
    link = sensed_ball(0.05, cones_round(1, 0.05, 30.0, 1.0, tilt_deg=89.0))
    found = clear_distance(link, 0.05, 0.4)
    assert found.lower == 0.0
    assert found.upper is not None
    assert found.upper < 1e-3
    assert found.witness is not None
    assert not seen(link.cones, np.array(found.witness), 0.05)


@pytest.mark.parametrize("radius", [0.03, 0.05, 0.08])
def test_clear_distance_between_opposite_hemispheres_has_a_closed_form(radius: float) -> None:
    # Two sensors of half angle 80° on top and at the bottom of a ball of radius a look up and down. A ball is
    # least seen in the equator's plane: with ρ from the centre, its centre is ρ·sin(10°) + a·cos(10°)... off
    # the edge ray, which passes (0, ±a) at 80° from the axis. It goes unseen where that is above R.
    a, half = 0.02, math.radians(80.0)
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    cones = Cones(apexes=a * axes, axes=axes, half_angles=np.full(2, half), reaches=np.full(2, 5.0))
    link = sensed_ball(a, cones)
    beside = lambda rho: rho * math.cos(half) + a * math.sin(half)  # noqa: E731
    expected = (radius - a * math.sin(half)) / math.cos(half) - a - radius
    assert beside(expected + a + radius) == pytest.approx(radius)
    found = clear_distance(link, radius, 0.5)
    if expected >= 0.5:
        assert found.lower == 0.5
        assert found.witness is None
    else:
        assert found.lower <= max(expected, 0.0) + 1e-9
        assert found.lower >= expected - 0.012  # the boundary is crossed at a slope of cos 80°
        assert found.upper is not None
        assert found.upper >= max(expected, 0.0) - 1e-3
        assert found.upper <= max(expected, 0.0) + 0.012


def test_largest_unseen_ball_has_a_closed_form() -> None:
    # In the same scene a ball of radius R touches in the equator's plane unseen while
    # (a + R)·cos α + a·sin α > R.
    a, half = 0.02, math.radians(60.0)
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    cones = Cones(apexes=a * axes, axes=axes, half_angles=np.full(2, half), reaches=np.full(2, 5.0))
    expected = a * (math.cos(half) + math.sin(half)) / (1.0 - math.cos(half))
    found = largest_unseen(sensed_ball(a, cones), cap=0.5, resolution=0.0005)
    assert found.lower <= expected + 1e-9
    assert found.upper >= expected - 1e-9
    assert found.upper - found.lower < 0.002
    assert found.witness is not None


def test_without_an_end_to_what_is_unseen_there_is_no_upper_bound(ur3: Robot) -> None:
    found = largest_unseen(sensed_links(ur3)[0], cap=0.3)
    assert found.upper == math.inf
    assert found.lower > 0.29


def test_cones_that_tile_the_plane_leave_nothing_unseen_in_it(ur3: Robot) -> None:
    (link,), array = sensed_links(ur3, 0.0), ur3.sensor_arrays[0]
    ring, transform = main_ring(array)
    wide = replace_half_angles(link, math.pi / 8.0)
    edges = gap_edges(0.4)
    shares = ring_shares(wide, ring, transform, 0.05, edges, axial=0.0)
    assert shares.upper[:, 0].max() == 0.0
    narrow = ring_shares(link, ring, transform, 0.05, edges, axial=0.0)
    assert narrow.lower[-1, 0] > 0.2


def test_share_unseen_in_the_plane_has_a_closed_form(ur3: Robot) -> None:
    # Of a pitch of 2β, unseen is what is more than R off the edge rays: ρ·sin(φ − α) + r·sin α > R.
    (link,), array = sensed_links(ur3, 0.0), ur3.sensor_arrays[0]
    ring, transform = main_ring(array)
    radius, beta, alpha = 0.05, math.pi / 8.0, ring.half_angle
    gaps = np.linspace(0.3, 0.4, 2001)
    rho = ring.radius + radius + gaps
    edge = alpha + np.arcsin(np.minimum(1.0, (radius - ring.radius * math.sin(alpha)) / rho))
    expected = float(np.mean(np.maximum(0.0, 1.0 - edge / beta)))
    shares = ring_shares(link, ring, transform, radius, np.array([0.3, 0.4]), axial=0.0, resolution=0.001)
    assert shares.shares[0, 0] == pytest.approx(expected, abs=shares.errors[0, 0] + 1e-6)
    assert shares.errors[0, 0] < 0.006


def test_the_published_shares_of_the_paper_s_ring(ur3: Robot) -> None:
    """SCIENCE 3: seen by two at gaps of 1 to 5 cm 16 %, to 10 cm 5 %, beyond none; about 40 % by none."""
    (link,), array = sensed_links(ur3, 0.0), ur3.sensor_arrays[0]
    ring, transform = main_ring(array)
    shares = ring_shares(
        link, ring, transform, 0.05, np.array([0.01, 0.05, 0.1, 0.3, 0.5]), 0.1, resolution=0.004
    )
    by_two = shares.shares[:, 2]
    assert by_two[0] == pytest.approx(0.16, abs=0.01)
    assert by_two[1] == pytest.approx(0.05, abs=0.01)
    assert by_two[2:].max() < 0.002
    assert shares.shares[:, 3].max() == 0.0
    np.testing.assert_allclose(shares.shares[:, 0], 0.4, atol=0.035)


def test_shares_of_directions_agree_with_sampling(ur3: Robot) -> None:
    (link,), array = sensed_links(ur3, 0.0), ur3.sensor_arrays[0]
    ring, transform = main_ring(array)
    edges = np.array([0.0, 0.05, 0.2])
    shares = ring_shares(link, ring, transform, 0.05, edges, 0.1, resolution=0.008)
    rng = np.random.default_rng(8)
    for index in range(2):
        count = 40_000
        gap = rng.uniform(*edges[index : index + 2], count)
        bearing, z = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(-0.1, 0.1, count)
        rho = ring.radius + 0.05 + gap
        local = np.stack([rho * np.cos(bearing), rho * np.sin(bearing), z], axis=1)
        centres = local @ transform[:3, :3].T + transform[:3, 3]
        by = np.minimum(link.cones.counts(centres, np.array([0.05]))[0], 3)
        sampled = np.bincount(by, minlength=4) / count
        assert (sampled >= shares.lower[index] - 0.01).all()
        assert (sampled <= shares.upper[index] + 0.01).all()
        np.testing.assert_allclose(sampled, shares.shares[index], atol=0.012)


def test_shares_of_places_agree_with_sampling_within_their_bounds() -> None:
    link = sensed_ball(0.05, cones_round(6, 0.055, 20.0, 0.8))
    edges = np.array([0.0, 0.1, 0.3])
    coarse, fine = (place_shares(link, 0.05, edges, resolution) for resolution in (0.02, 0.01))
    rng = np.random.default_rng(9)
    centres = rng.uniform(-0.4, 0.4, (200_000, 3))
    gaps = np.linalg.norm(centres, axis=1) - 0.05 - 0.05
    by = np.minimum(link.cones.counts(centres, np.array([0.05]))[0], 3)
    for index in range(2):
        inside = (gaps >= edges[index]) & (gaps < edges[index + 1])
        sampled = np.bincount(by[inside], minlength=4) / inside.sum()
        for shares in (coarse, fine):
            np.testing.assert_allclose(sampled, shares.shares[index], atol=0.02)
            assert (sampled >= shares.lower[index] - 0.01).all()
            assert (sampled <= shares.upper[index] + 0.01).all()
    assert (fine.errors <= coarse.errors + 1e-12).all()
    assert fine.errors.max() < 0.7 * coarse.errors.max()
    np.testing.assert_allclose(fine.shares.sum(axis=1), 1.0, atol=1e-9)


def test_the_covered_design_is_proved_to_leave_no_blind_spot(covered_links: tuple[SensedLink, ...]) -> None:
    assert [link.name for link in covered_links] == ["upper_arm_link", "forearm_link"]
    for link in covered_links:
        found = clear_distance(link, 0.05, 0.355)
        assert found.witness is None
        assert found.lower == 0.355
        largest = largest_unseen(link)
        assert largest.upper < 0.05


def test_the_covered_design_holds_at_random_places(covered_links: tuple[SensedLink, ...]) -> None:
    rng = np.random.default_rng(11)
    for link in covered_links:
        box = link.body.box
        centres = rng.uniform(box[:3] - 0.405, box[3:] + 0.405, (40_000, 3))
        near, _ = link.distances(centres)
        centres = centres[(near >= 0.05) & (near <= 0.4)]
        assert len(centres) > 10_000
        assert all(seen(link.cones, centre, 0.05) for centre in centres[:3000])
        assert (link.cones.least_distances(centres) <= 0.05).all()


def test_the_covered_sensors_stand_outside_of_the_links_and_look_past_their_own(
    covered: Robot, covered_links: tuple[SensedLink, ...]
) -> None:
    from ssm_service.model.link_samples import LinkGeometry

    for link in covered_links:
        geometry = LinkGeometry(covered, link.name)
        _, squared = geometry.nearest(link.cones.apexes.copy(), 0.001)
        assert np.sqrt(squared).min() > 0.004
        outside = link.cones.apexes + 0.5 * link.cones.axes  # the way out is free
        assert (link.body.lower(outside) > 0.3).all()
        assert (link.cones.counts(link.points, np.zeros(1)) == 0).all()


@pytest.mark.parametrize(("link_index", "sensor"), [(0, 0), (0, 7), (0, 13), (1, 1), (1, 12), (1, 18)])
def test_a_planted_hole_is_found_and_is_real(
    covered: Robot, covered_links: tuple[SensedLink, ...], link_index: int, sensor: int
) -> None:
    whole = covered_links[link_index]
    link = whole.with_cones(whole.cones.without(sensor))
    found = clear_distance(link, 0.05, 0.355)
    assert found.witness is not None
    assert found.upper is not None
    assert 0.0 <= found.lower <= found.upper <= 0.355
    centre = np.array(found.witness)
    assert not seen(link.cones, centre, 0.05)
    assert seen(whole.cones, centre, 0.05)
    position = covered.rest_position
    T_base_link = covered.link_transforms(position)[link.name]
    model = DistanceModel(covered)
    ball = Obstacle(
        id="ball",
        shape="sphere",
        size=(0.05,),
        position=tuple((T_base_link[:3, :3] @ centre + T_base_link[:3, 3]).tolist()),
    )
    model.set_obstacles([ball])
    nearest = model.nearest(position, link=link.name)
    assert nearest is not None
    exact = nearest.distance
    assert exact == pytest.approx(found.upper, abs=5e-4)
    assert -1e-6 <= exact <= 0.355


def test_the_same_numbers_twice(ur3: Robot) -> None:
    first, second = (
        (clear_distance(link, 0.05, 0.3), place_shares(link, 0.05, gap_edges(0.2), 0.016))
        for link in (sensed_links(ur3)[0], sensed_links(Robot.load("ur3"))[0])
    )
    assert first[0] == second[0]
    assert first[1].shares.tobytes() == second[1].shares.tobytes()
    assert first[1].upper.tobytes() == second[1].upper.tobytes()


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.inf, math.nan])
def test_nonsense_is_refused(wrong: float) -> None:
    link = sensed_ball(0.05, cones_round(3, 0.05, 20.0, 0.8))
    with pytest.raises(InputError):
        clear_distance(link, wrong, 0.3)
    with pytest.raises(InputError):
        largest_unseen(link, cap=wrong)
    with pytest.raises(InputError):
        place_shares(link, 0.05, np.array([0.0, 0.1]), wrong)


def replace_half_angles(link: SensedLink, half_angle: float) -> SensedLink:
    return link.with_cones(replace(link.cones, half_angles=np.full(link.cones.count, half_angle)))

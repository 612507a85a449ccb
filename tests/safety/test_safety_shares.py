"""Shares of speed: their zones, levels of stopping and the scaling of a wanted motion, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssm_service.safety import Zone
from ssm_service.safety.closing import Closing
from ssm_service.safety.reaction import ReactionTime
from ssm_service.safety.speeds import greatest_scaling, zone_of
from ssm_service.safety.stopping import StoppingLevels

LEVELS = StoppingLevels(
    shares=np.array([0.25, 0.5, 1.0]), times=np.array([0.1, 0.2, 0.3]), gains=np.array([0.05, 0.1, 0.15])
)


@pytest.mark.parametrize(
    ("share", "zone"),
    [
        (2.0, Zone.GREEN),
        (1.0, Zone.GREEN),
        (math.nextafter(1.0, 0.0), Zone.YELLOW),
        (0.25, Zone.YELLOW),
        (math.nextafter(0.25, 0.0), Zone.RED),
        (math.ulp(0.0), Zone.RED),
        (0.0, Zone.STOP),
        (-0.1, Zone.STOP),
        (math.nan, Zone.STOP),
    ],
)
def test_the_edges_of_the_zones_belong_to_the_milder_one_but_standing_is_a_stop(
    share: float, zone: Zone
) -> None:
    assert zone_of(share, 0.25) is zone


@pytest.mark.parametrize(
    ("share", "level"),
    [(0.0, 0), (0.25, 0), (0.26, 1), (0.5, 1), (0.51, 2), (1.0, 2), (1.5, 2), (math.nan, 2)],
)
def test_a_share_counts_as_the_next_level_up_and_the_unknown_as_the_last(share: float, level: int) -> None:
    assert LEVELS.level_at(share) == level


def test_retreat_and_rest_are_never_slowed() -> None:
    for closing in ([-0.5, -0.1], [0.0, -2.0], [0.0, 0.0]):
        assert greatest_scaling(np.array(closing), 1.0, np.zeros((2, 3)), LEVELS) == 1.0


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_closing_speed_that_is_no_number_stops(wrong: float) -> None:
    assert greatest_scaling(np.array([wrong, -0.1]), 0.5, np.ones((2, 3)), LEVELS) == 0.0


def test_the_pair_that_allows_least_counts_on_each_level_and_the_best_level_is_taken() -> None:
    by_level = np.array([[0.4, 0.3, 0.2], [0.8, 0.5, 0.1]])
    closing = np.array([1.0, 1.0])
    # On the first level 0.4 of the motion, but with half of a joint's limit at most half of it may be used:
    # s·0.5 ≤ 0.25. On the second min(0.3, 0.5), on the third min(0.2, 0.1).
    assert greatest_scaling(closing, 0.5, by_level, LEVELS) == pytest.approx(0.4, abs=1e-9)
    # With all of a joint's limit the first level holds up to a quarter; the second gives 0.3.
    assert greatest_scaling(closing, 1.0, by_level, LEVELS) == pytest.approx(0.3, abs=1e-9)
    # A pair that does not come closer has no say.
    closing = np.array([1.0, -1.0])
    assert greatest_scaling(closing, 0.0, by_level * [[1.0], [0.0]], LEVELS) == pytest.approx(0.4, abs=1e-9)


def test_it_is_never_rounded_up_and_whole_where_there_is_room() -> None:
    by_level = np.array([[0.1, 0.1, 0.1]])
    for closing in np.linspace(0.11, 3.0, 500):
        found = greatest_scaling(np.array([closing]), 0.0, by_level, LEVELS)
        assert found * closing <= 0.1
        assert found * closing == pytest.approx(0.1, rel=1e-9)
    assert greatest_scaling(np.array([0.05]), 0.2, by_level, LEVELS) == 1.0
    assert greatest_scaling(np.array([0.1]), 0.2, by_level, LEVELS) == 1.0


def test_the_reaction_time_is_the_sum_of_all_terms() -> None:
    time = ReactionTime(sensor_period=0.1, input_age=0.02, tick=0.004, transport=0.0008, robot=0.00016)
    assert time.total == pytest.approx(0.12496, abs=1e-15)
    assert time.terms() == {
        "sensor_period": 0.1,
        "input_age": 0.02,
        "tick": 0.004,
        "transport": 0.0008,
        "robot": 0.00016,
        "total": time.total,
    }


GRADIENTS = np.array([[0.5, -2.0], [9.0, 9.0], [-1.0, 0.25]])
CORNERS = np.array([[[[3.0, 0.0], [0.0, 4.0], [0.0, 0.0]], [[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]]])
MIXED = Closing(gradients=GRADIENTS, undirected=np.array([False, True, False]), jacobians=CORNERS)


def test_pairs_with_a_direction_close_along_it() -> None:
    directed = Closing.directed(GRADIENTS)
    assert not directed.undirected.any()
    assert directed.undirected.shape == (3,)
    np.testing.assert_allclose(directed.at(np.array([2.0, 1.0])), [-1.0, 27.0, -1.75])
    np.testing.assert_allclose(directed.greatest(np.array([2.0, 1.0])), [3.0, 27.0, 2.25])


def test_a_pair_without_a_direction_closes_as_fast_as_its_fastest_point_moves() -> None:
    np.testing.assert_allclose(MIXED.at(np.array([1.0, 1.0])), [-1.5, 5.0, -0.75])
    np.testing.assert_allclose(MIXED.at(np.array([0.0, -1.0])), [2.0, 4.0, -0.25])
    np.testing.assert_allclose(MIXED.greatest(np.array([1.0, 2.0])), [4.5, 11.0, 1.5])
    rng = np.random.default_rng(6)
    limits = np.array([1.0, 2.0])
    greatest = MIXED.greatest(limits)
    for velocity in rng.uniform(-limits, limits, (200, 2)):
        assert (MIXED.at(velocity) <= greatest + 1e-12).all()


@pytest.mark.parametrize("index", range(3))
def test_one_pair_alone_is_as_among_the_others(index: int) -> None:
    alone = MIXED.pair(index)
    velocity = np.array([0.7, -0.4])
    np.testing.assert_allclose(alone.at(velocity), MIXED.at(velocity)[index : index + 1])
    np.testing.assert_allclose(alone.greatest(np.abs(velocity)), MIXED.greatest(np.abs(velocity))[[index]])
    assert not np.shares_memory(alone.gradients, MIXED.gradients)


def of_many(directions: list[bool], *, joints: int = 6, corners: int = 4) -> Closing:
    """Return drawn pairs."""
    random, undirected = np.random.default_rng(12), ~np.array(directions)
    return Closing(
        gradients=random.normal(0.0, 0.3, (len(directions), joints)),
        undirected=undirected,
        jacobians=random.normal(0.0, 0.3, (int(undirected.sum()), corners, 3, joints)),
    )


# Seven pairs, two of them of four points, six joints: no two axes are as long as each other.
SEVEN = of_many([True, False, True, True, False, True, True])


def test_each_of_several_pairs_without_a_direction_has_the_speed_of_its_own_points() -> None:
    velocity = np.array([0.3, -1.1, 0.7, 0.2, -0.4, 0.9])
    speeds, greatest = SEVEN.at(velocity), SEVEN.greatest(np.abs(velocity))
    for index, points in zip((1, 4), SEVEN.jacobians, strict=True):
        moved = [sum(J[:, j] * velocity[j] for j in range(6)) for J in points]
        assert speeds[index] == pytest.approx(max(math.hypot(*v) for v in moved))
        # The joints' shares of a point's speed, all of them in one direction, are the most that it can have.
        most = [sum(math.hypot(*J[:, j]) * abs(velocity[j]) for j in range(6)) for J in points]
        assert greatest[index] == pytest.approx(max(most))
    for index in (0, 2, 3, 5, 6):
        terms = SEVEN.gradients[index] * velocity
        assert speeds[index] == pytest.approx(math.fsum(terms))
        assert greatest[index] == pytest.approx(math.fsum(abs(terms)))


def test_the_pairs_one_by_one_are_together_the_same_again() -> None:
    alone = [SEVEN.pair(index) for index in range(7)]
    for field in ("gradients", "undirected", "jacobians"):
        together = np.concatenate([getattr(pair, field) for pair in alone])
        assert np.array_equal(together, getattr(SEVEN, field))
        # A pair alone is a Closing like any other: taking its only pair changes nothing.
        for pair in alone:
            assert np.array_equal(getattr(pair.pair(0), field), getattr(pair, field))


def test_pairs_that_all_have_a_direction_are_those_of_which_none_has_none() -> None:
    directed, drawn = Closing.directed(SEVEN.gradients), of_many([True] * 7)
    assert directed.undirected.dtype == np.bool_
    assert np.array_equal(~directed.undirected, np.ones(7))
    assert len(directed.jacobians) == directed.undirected.sum() == 0
    assert directed.jacobians.shape[2:] == drawn.jacobians.shape[2:] == (3, 6)


def test_the_words_of_the_zones() -> None:
    assert [zone.word for zone in Zone] == ["green", "yellow", "red", "stop"]

"""All pairs of a tick, by hand: which limits, by what terms, and how far a velocity may be kept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ssm_service.monitor.separated import Limit, PairTable, Separated
from ssm_service.monitor.separation import _left, _limiting
from ssm_service.safety import Closing, ReactionTime, StoppingLevels, Zone, greatest_scaling

LEVELS = StoppingLevels(
    shares=np.array([0.5, 1.0]), times=np.array([0.25, 0.5]), gains=np.array([0.125, 0.375])
)
GRADIENTS = np.array([[0.5, -0.25], [0.0, 0.75], [0.0, 0.0]])
JACOBIANS = np.array([[[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]]])
BY_LEVEL = np.array([[0.4, 0.2], [0.3, 0.1], [0.6, 0.5]])


def reaction(first: float) -> ReactionTime:
    return ReactionTime(sensor_period=first, input_age=0.0, tick=0.0, transport=0.0, robot=0.0)


def separated(**changes: Any) -> Separated:
    closing = Closing(gradients=GRADIENTS, undirected=np.array([False, False, True]), jacobians=JACOBIANS)
    table = PairTable(
        ids=("ball", "arm"),
        link=np.array([1, 0, 2]),
        obstacle=np.array([1, 0, -1]),
        distance=np.array([0.5, 0.6, 0.7]),
        exact=np.array([True, True, False]),
        point_on_link=np.zeros((3, 3)),
        point_on_obstacle=np.zeros((3, 3)),
        normal=np.zeros((3, 3)),
        human_speed=np.array([1.0, 1.25, 1.5]),
        uncertainty=np.array([0.01, 0.02, 0.04]),
        reaction_time=np.array([0.1, 0.2, 0.4]),
        closing=closing,
    )
    values: dict[str, Any] = {
        "table": table,
        "links": ("a", "b", "c"),
        "closing_speed": np.array([0.5, -0.25, 1.0]),
        "max_closing_speed": np.array([0.4, 0.3, 0.6]),
        "shares": np.array([0.75, 0.5, 1.0]),
        "scaling": 0.5,
        "limiting": 1,
        "limit": Limit(closing=closing, by_level=BY_LEVEL, levels=LEVELS),
        "level": 0,
        "reactions": {"ranges": reaction(0.25), "obstacles": reaction(0.125)},
        "intrusion": 0.07,
        "robot_uncertainty": 0.09,
        "red_scaling": 0.25,
    }
    return Separated(**{**values, **changes})


def test_pairs_by_their_names():
    found = separated()
    assert len(found) == 3
    assert [found.link(pair) for pair in range(3)] == ["b", "a", "c"]
    assert [found.obstacle(pair) for pair in range(3)] == ["arm", "ball", None]
    assert [found.source(pair) for pair in range(3)] == ["obstacles", "obstacles", "ranges"]


def test_the_terms_of_a_pair_at_its_own_speed():
    for level, time, gain in ((0, 0.25, 0.125), (1, 0.5, 0.375)):
        found = separated(level=level)
        assert found.stopping_time == time
        terms = found.terms(0)
        assert terms.S_h == pytest.approx(1.0 * (0.1 + time))
        assert terms.S_r == pytest.approx(0.5 * 0.1)
        assert terms.S_s == pytest.approx(0.5 * gain)
        assert (terms.C, terms.Z_d, terms.Z_r) == (0.07, 0.01, 0.09)
        other = found.terms(2)
        assert other.S_h == pytest.approx(1.5 * (0.4 + time))
        assert other.S_r == pytest.approx(1.0 * 0.4)
        assert (other.C, other.Z_d, other.Z_r) == (0.07, 0.04, 0.09)


def test_the_reaction_time_is_that_of_what_limits_or_else_the_longest():
    assert separated().reaction == reaction(0.125)
    assert separated(limiting=2).reaction == reaction(0.25)
    assert separated(limiting=None).reaction == reaction(0.25)
    assert separated(limiting=None, reactions={}).reaction is None


def test_the_zone_is_that_of_the_least_share():
    for scaling, zone in ((1.0, Zone.GREEN), (0.5, Zone.YELLOW), (0.125, Zone.RED), (0.0, Zone.STOP)):
        assert separated(scaling=scaling).zone is zone


@pytest.mark.parametrize("pair", range(3))
def test_one_pair_alone_limits_as_it_does_among_all(pair: int):
    found = separated()
    alone = found.limit_of(pair)
    assert alone.levels is LEVELS
    assert np.array_equal(alone.by_level, BY_LEVEL[pair : pair + 1])
    assert not np.shares_memory(alone.by_level, found.limit.by_level)
    rng = np.random.default_rng(7)
    for velocity in rng.uniform(-2.0, 2.0, (20, 2)):
        assert np.array_equal(alone.closing.at(velocity), found.limit.closing.at(velocity)[pair : pair + 1])


def test_a_velocity_is_scaled_by_all_pairs_at_the_share_that_its_joints_have():
    limit = separated().limit
    rng = np.random.default_rng(8)
    for velocity in rng.uniform(-2.0, 2.0, (20, 2)):
        for share in (0.25, 0.75, 1.5):
            expected = greatest_scaling(limit.closing.at(velocity), share, BY_LEVEL, LEVELS)
            assert limit.scaling(velocity, share) == expected


@pytest.mark.parametrize(
    ("allowed", "greatest", "left"),
    [
        (0.5, 2.0, 0.25),
        (3.0, 2.0, 1.5),
        (0.0, 2.0, 0.0),
        (-0.5, 2.0, 0.0),
        (0.5, 0.0, np.inf),
        (0.0, 0.0, 0.0),
    ],
)
def test_what_a_pair_leaves_of_the_joint_speeds(allowed: float, greatest: float, left: float):
    assert _left(np.array([allowed]), np.array([greatest])).tolist() == [left]


def test_the_pair_that_leaves_least_limits_and_of_equal_ones_the_nearest():
    ones = np.ones(3)
    assert _limiting(np.empty(0), np.empty(0), np.empty(0)) is None
    assert _limiting(np.array([0.5, 0.25, 0.75]), ones, ones) == 1
    assert _limiting(np.array([0.5, 0.5, 0.75]), ones, np.array([0.3, 0.2, 0.1])) == 1
    assert _limiting(np.array([5.0, 4.0, 3.0]), np.array([1.0, 1.0, 0.5]), ones) == 1
    assert _limiting(np.array([-1.0, -2.0, 1.0]), ones, np.array([0.2, 0.3, 0.1])) == 0

"""From distances to speeds: closed forms, monotonicity, and the greatest scaling of a velocity."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssm_service.config import ReactionConfig
from ssm_service.safety import (
    Closing,
    Least,
    LeastHeld,
    ReactionTime,
    SeparationLaw,
    StoppingLevels,
    Zone,
    ZoneMachine,
    admissible_shares,
    greatest_scaling,
    level_speeds,
    max_closing_speeds,
    zone_of,
)

ONE = StoppingLevels(shares=np.array([1.0]), times=np.array([0.159]), gains=np.array([0.0626]))
THREE = StoppingLevels(
    shares=np.array([0.2, 0.6, 1.0]), times=np.array([0.08, 0.12, 0.16]), gains=np.array([0.02, 0.04, 0.07])
)


def full(count: int, value: float) -> np.ndarray:
    return np.full(count, value)


def law(levels: StoppingLevels, level: int, v_h: float, T_r: float, fixed: float) -> SeparationLaw:
    return SeparationLaw(
        human_speed=v_h,
        reaction_time=T_r,
        stopping_time=float(levels.times[level]),
        stopping_gain=float(levels.gains[level]),
        intrusion=fixed,
    )


def test_many_pairs_are_the_law_of_each() -> None:
    random = np.random.default_rng(1)
    distance, v_h = random.uniform(-0.2, 2.0, 300), random.uniform(0.0, 2.0, 300)
    T_r, fixed = random.uniform(0.0, 0.5, 300), random.uniform(0.0, 0.3, 300)
    speeds = level_speeds(distance, v_h, T_r, fixed, THREE)
    for i in range(300):
        for k in range(3):
            expected = law(THREE, k, v_h[i], T_r[i], fixed[i]).greatest_speed(distance[i])
            assert speeds[i, k] == pytest.approx(expected, abs=1e-9)
    assert (np.diff(speeds, axis=1) <= 0.0).all()


@pytest.mark.parametrize("distance", [math.nan, -math.inf, -1.0, 0.0])
def test_no_speed_where_nothing_is_known_or_nothing_is_left(distance: float) -> None:
    speeds = level_speeds(full(1, distance), full(1, 1.6), full(1, 0.1), full(1, 0.05), THREE)
    assert speeds.tolist() == [[0.0, 0.0, 0.0]]
    allowed = max_closing_speeds(speeds, full(1, 2.0), THREE)
    assert allowed.tolist() == [0.0]
    assert admissible_shares(allowed, full(1, 2.0)).tolist() == [0.0]


def test_the_very_distance_of_standing_still_allows_no_speed_even_where_any_would_do_beyond() -> None:
    ideal = StoppingLevels(shares=np.ones(1), times=np.array([0.25]), gains=np.zeros(1))
    edge = law(ideal, 0, 1.6, 0.0, 0.1).terms(0.0).S_p
    distance = np.array([math.nextafter(edge, 0.0), edge, math.nextafter(edge, 1.0)])
    with np.errstate(divide="ignore", invalid="ignore"):
        speeds = level_speeds(distance, full(3, 1.6), np.zeros(3), full(3, 0.1), ideal)
    assert speeds.tolist() == [[0.0], [0.0], [math.inf]]


def test_one_level_is_the_inverse_of_the_equation() -> None:
    speeds = level_speeds(full(1, 1.0), full(1, 1.6), full(1, 0.1), full(1, 0.055), ONE)
    allowed = max_closing_speeds(speeds, full(1, 0.01), ONE)
    assert law(ONE, 0, 1.6, 0.1, 0.055).terms(float(allowed[0])).S_p == pytest.approx(1.0, abs=1e-9)


def test_a_slow_robot_stops_sooner_and_so_may_come_nearer() -> None:
    """By hand: T_r = 0.1, v_h = 1, so 0.18, 0.22 and 0.26 m at standstill of the three levels."""
    allowed = []
    for distance in (0.17, 0.20, 0.25, 0.30, 1.0):
        speeds = level_speeds(full(1, distance), full(1, 1.0), full(1, 0.1), full(1, 0.0), THREE)
        allowed.append(float(max_closing_speeds(speeds, full(1, 2.0), THREE)[0]))
    # Of 2 m/s, a fifth is 0.4 and six tenths are 1.2.
    slow, middle, fast = 0.02 / 0.12, 0.03 / 0.14, 0.74 / 0.17
    assert allowed == pytest.approx([0.0, slow, 0.4, 0.08 / 0.14, fast])
    assert middle < 0.4  # so at 0.25 m the slowest level decides, by its share


def test_nearer_and_longer_and_less_certain_is_never_faster() -> None:
    random = np.random.default_rng(2)
    for levels in (ONE, THREE):
        row = np.array([0.6, 1.2, 0.15, 0.05])
        for _ in range(300):
            now = row * random.uniform(0.3, 2.5, 4)
            worse = now * np.array([random.uniform(0.5, 1.0), *random.uniform(1.0, 2.0, 3)])
            greatest = full(1, random.uniform(0.0, 3.0))
            speeds = [
                max_closing_speeds(level_speeds(*(full(1, x) for x in case), levels), greatest, levels)
                for case in (now, worse)
            ]
            assert speeds[1] <= speeds[0]


def test_the_share_of_a_pair() -> None:
    allowed = np.array([0.0, 0.5, 2.0, 0.5, 0.0, 0.5])
    greatest = np.array([1.0, 1.0, 1.0, 0.0, 0.0, math.nan])
    assert admissible_shares(allowed, greatest).tolist() == [0.0, 0.5, 1.0, 1.0, 0.0, 0.0]


def test_a_pair_that_allows_any_speed_slows_nothing() -> None:
    greatest = np.array([0.0, 1.0, 1e300, math.inf])
    assert admissible_shares(full(4, math.inf), greatest).tolist() == [1.0] * 4


def test_zones_of_shares() -> None:
    cases = {1.0: Zone.GREEN, 0.999: Zone.YELLOW, 0.25: Zone.YELLOW, 0.249: Zone.RED, 1e-9: Zone.RED}
    assert {share: zone_of(share, 0.25) for share in cases} == cases
    assert zone_of(0.0, 0.25) is zone_of(math.nan, 0.25) is Zone.STOP


def closing(random: np.random.Generator) -> Closing:
    """Return three directed pairs and, between them, an undirected one."""
    return Closing(
        gradients=random.normal(0.0, 0.3, (4, 6)),
        undirected=np.array([False, True, False, False]),
        jacobians=random.normal(0.0, 0.3, (1, 8, 3, 6)),
    )


def test_closing_speeds_of_directed_and_undirected_pairs() -> None:
    random = np.random.default_rng(3)
    pairs, velocity = closing(random), random.normal(0.0, 1.0, 6)
    speeds = pairs.at(velocity)
    assert speeds[[0, 2, 3]] == pytest.approx(pairs.gradients[[0, 2, 3]] @ velocity)
    assert speeds[1] == pytest.approx(max(np.linalg.norm(J @ velocity) for J in pairs.jacobians[0]))
    for index in range(4):
        assert pairs.pair(index).at(velocity) == pytest.approx(speeds[index : index + 1])
    limits = random.uniform(0.0, 2.0, 6)
    greatest = pairs.greatest(limits)
    assert greatest[0] == pytest.approx(pairs.at(limits * np.sign(pairs.gradients[0]))[0])
    for _ in range(200):
        assert (pairs.at(limits * random.uniform(-1.0, 1.0, 6)) <= greatest).all()


@pytest.mark.parametrize("levels", [ONE, THREE])
def test_the_box_of_joint_speeds_keeps_every_pair_admissible(levels: StoppingLevels) -> None:
    random, limits = np.random.default_rng(4), np.array([2.0, 2.0, 3.0, 3.0, 3.0, 3.0])
    for _ in range(50):
        pairs = closing(random)
        distance, greatest = random.uniform(0.3, 1.5, 4), pairs.greatest(limits)
        by_level = level_speeds(distance, full(4, 1.0), full(4, 0.1), full(4, 0.05), levels)
        share = float(admissible_shares(max_closing_speeds(by_level, greatest, levels), greatest).min())
        for _ in range(20):
            velocity = share * limits * random.uniform(-1.0, 1.0, 6)
            level = levels.level_at(float((np.abs(velocity) / limits).max()))
            for speed, d in zip(pairs.at(velocity), distance, strict=True):
                if share > 0.0:
                    assert law(levels, level, 1.0, 0.1, 0.05).terms(float(speed)).S_p <= d + 1e-12


@pytest.mark.parametrize("levels", [ONE, THREE])
def test_the_scaling_of_a_velocity_is_admissible_and_the_greatest(levels: StoppingLevels) -> None:
    random, found = np.random.default_rng(6), 0
    for _ in range(300):
        speeds, share = random.normal(0.0, 1.5, 5), float(random.uniform(0.1, 1.0))
        distance = random.uniform(0.28, 0.8, 5)
        by_level = level_speeds(distance, full(5, 1.0), full(5, 0.1), full(5, 0.0), levels)

        def admissible(
            s: float, speeds: np.ndarray = speeds, share: float = share, v: np.ndarray = by_level
        ) -> bool:
            return bool((s * speeds <= np.maximum(v[:, levels.level_at(s * share)], 0.0)).all())

        scaling = greatest_scaling(speeds, share, by_level, levels)
        assert admissible(scaling)
        if scaling < 1.0:
            found += 1
            beyond = [s for s in (1.001 * scaling, *np.linspace(scaling, 1.0, 50)[1:]) if s <= 1.0]
            assert not any(admissible(s) for s in beyond)
    assert found > 100


def test_retreat_is_never_slowed_and_the_unknown_never_moves() -> None:
    none = np.zeros((2, 3))
    assert greatest_scaling(np.array([-1.0, 0.0]), 1.0, none, THREE) == 1.0
    assert greatest_scaling(np.array([-1.0, 1e-9]), 1.0, none, THREE) == 0.0
    assert greatest_scaling(np.array([-1.0, math.nan]), 1.0, none + 9.0, THREE) == 0.0
    assert greatest_scaling(np.array([1.0, 1.0]), 0.0, none + 0.5, THREE) == pytest.approx(0.5)
    assert greatest_scaling(np.empty(0), 1.0, none[:0], THREE) == 1.0


def test_terms_of_the_reaction_time() -> None:
    config = ReactionConfig(robot_s=0.016, transport_s=0.02)
    times = {"sensor_period_s": 0.16, "input_age_s": 0.05, "tick_s": 0.002}
    usual = ReactionTime.of(config, **times, transport_s=0.0)
    assert usual.total == pytest.approx(0.16 + 0.05 + 0.002 + 0.02 + 0.016)
    terms = usual.terms()
    assert terms.pop("total") == usual.total == sum(terms.values())
    assert ReactionTime.of(config, **times, transport_s=0.03).transport == 0.03
    assert ReactionTime.of(config, **times, transport_s=0.01).transport == 0.02


def test_the_least_share_is_held_exactly_as_long_as_a_zone() -> None:
    random = np.random.default_rng(7)
    for window in (1, 2, 5, 13):
        held, machine, past = LeastHeld[str](window), ZoneMachine(window), [0.0] * window
        for tick in range(300):
            share = float(random.choice([0.0, 0.1, 0.5, 0.9, 1.0], p=[0.02, 0.08, 0.2, 0.2, 0.5]))
            past.append(share)
            least = held.step(Least(share=share, cause=str(share)))
            assert least.share == min(past[-window:]), (window, tick)
            assert least.cause in (None, str(least.share))
            assert zone_of(least.share, 0.25) is machine.step(zone_of(share, 0.25))


def test_of_equal_shares_the_newest_says_what_limits() -> None:
    held = LeastHeld[str](3)
    ticks = [(0.4, "a"), (0.4, "b"), (0.9, "c"), (0.4, "d"), (0.0, "e"), (0.0, "f"), (1.0, "g")]
    # Before the first tick it is 0 without a cause, for as long as any tick: until the third.
    causes = [held.step(Least(share=share, cause=cause)).cause for share, cause in ticks]
    assert causes == [None, None, "b", "d", "e", "f", "f"]

"""From sources and distances to the zone and its reasons, case by case, on values of the test's own."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ssm_service.config import ProfileConfig, SourceConfig, ZoneConfig
from ssm_service.model import ClosestPair, Robot
from ssm_service.monitor import Inputs, Nearest, Received
from ssm_service.monitor.assess import PERCEPTION, Seen, assess, compare, nearest_by_obstacles
from ssm_service.monitor.command import limited_velocity, separated_velocity, zone_speed_limit
from ssm_service.monitor.ranges import RangeReading
from ssm_service.monitor.reaction import (
    configured_reaction,
    reaction_times,
    standstill_distance,
    stopping_levels,
)
from ssm_service.monitor.separated import PairTable, joined
from ssm_service.motion import limit_velocity
from ssm_service.safety import Closing, SourceState, SourceStatus, Zone, ZoneProfile

RED, YELLOW = 0.2, 0.4


def profile(**keys: Any) -> ZoneProfile:
    steps = {
        "red": ZoneConfig(distance_m=RED, joint_speed_rad_s=0.18, speed_scaling=0.25),
        "yellow": ZoneConfig(distance_m=YELLOW, joint_speed_rad_s=0.24, speed_scaling=0.5),
    }
    return ZoneProfile(name="test", config=ProfileConfig(**{**steps, **keys}))


def sources(**required: bool) -> SimpleNamespace:
    return SimpleNamespace(
        **{
            name: SourceConfig(timeout_s=0.1, required=required.get(name, True))
            for name in ("joints", "ranges", "obstacles", "target")
        }
    )


def status(name: str, state: SourceState = SourceState.FRESH, age_s: float | None = 0.01) -> SourceStatus:
    return SourceStatus(name=name, state=state, age_s=age_s)


def thing(distance: float, source: str = "obstacles", link: str = "forearm_link") -> Nearest:
    return Nearest(
        source=source,
        link=link,
        obstacle=None if source == "ranges" else "ball",
        distance=distance,
        point_on_link=np.zeros(3),
        point_on_obstacle=np.ones(3),
        normal=np.array([1.0, 0.0, 0.0]),
    )


def reading(nearest: Nearest | None = None, **changes: Any) -> RangeReading:
    values: dict[str, Any] = {
        "nearest": nearest,
        "ranges": np.full(8, np.inf),
        "others": np.full(8, np.inf),
        "nearest_other": nearest,
        "least": {"forearm_link": math.inf if nearest is None else nearest.distance},
        "bounds": (),
        "silent": {},
        "unseen": False,
        "uncovered": False,
        "contradicted": False,
    }
    return RangeReading(**{**values, **changes})


FRESH = [status(name) for name in ("joints", "ranges", "obstacles", "target")]


def assessed(seen: Seen | None = None, statuses: list[SourceStatus] | None = None, **keys: Any) -> Any:
    separation = keys.pop("separation", Zone.GREEN)
    config = keys.pop("sources", sources())
    return assess(profile(**keys), config, statuses or FRESH, seen or Seen(), separation)


def test_nothing_near_and_everything_fresh_is_green():
    found = assessed()
    assert (found.zone, found.beside, found.reasons) == (Zone.GREEN, Zone.GREEN, [])
    assert (found.nearest, found.comparison) == (None, None)
    assert list(found.sources) == ["joints", "ranges", "obstacles", "target"]
    assert PERCEPTION == ("ranges", "obstacles")


@pytest.mark.parametrize(
    ("distance", "zone", "reasons"),
    [
        (YELLOW + 1e-9, Zone.GREEN, []),
        (YELLOW, Zone.YELLOW, ["distance"]),
        (RED + 1e-9, Zone.YELLOW, ["distance"]),
        (RED, Zone.RED, ["distance"]),
        (1e-9, Zone.RED, ["distance"]),
        (0.0, Zone.STOP, ["contact"]),
        (-0.1, Zone.STOP, ["contact"]),
        (math.nan, Zone.STOP, ["contact"]),
    ],
)
@pytest.mark.parametrize("source", PERCEPTION)
def test_a_distance_is_a_zone_and_a_reason(distance, zone, reasons, source):
    near = thing(distance, source)
    found = assessed(Seen(things=[near], reading=reading()))
    assert (found.zone, found.beside, found.reasons) == (zone, zone, reasons)
    assert found.nearest is near
    other = "ranges" if source == "obstacles" else "obstacles"
    assert found.sources[source].distance is near.distance
    assert found.sources[other].distance is None


def test_of_two_the_nearer_decides_and_each_has_its_report():
    far, near = thing(0.3, "ranges"), thing(0.1, "obstacles")
    found = assessed(Seen(things=[far, near]))
    assert (found.nearest, found.zone) == (near, Zone.RED)
    reports = found.sources
    assert (reports["ranges"].distance, reports["obstacles"].distance) == (0.3, 0.1)
    assert reports["joints"].distance is None


def test_contact_with_what_no_sensor_sees_is_uncovered():
    for source, unseen, there in itertools.product(PERCEPTION, (False, True), (False, True)):
        near = thing(0.0, source)
        seen = Seen(things=[near], reading=reading(near, unseen=unseen) if there else None)
        word = "uncovered" if source == "ranges" and unseen and there else "contact"
        assert assessed(seen).reasons == [word]
    near = thing(0.1, "ranges")
    assert assessed(Seen(things=[near], reading=reading(near, unseen=True))).reasons == ["distance"]


@pytest.mark.parametrize("name", ["joints", "ranges", "obstacles", "target"])
@pytest.mark.parametrize(
    ("state", "word"),
    [
        (SourceState.STALE, "stale"),
        (SourceState.INVALID, "invalid"),
        (SourceState.ABSENT, "waiting"),
    ],
)
@pytest.mark.parametrize("required", [False, True])
def test_what_is_not_known_is_a_stop_save_what_is_wanted(name, state, word, required):
    statuses = [status(one.name, state, None) if one.name == name else one for one in FRESH]
    found = assessed(statuses=statuses, sources=sources(**{name: required}))
    stops = name != "target" and (required or state is not SourceState.ABSENT)
    assert found.zone is (Zone.STOP if stops else Zone.GREEN)
    assert found.reasons == ([f"{word}:{name}"] if stops else [])
    report = found.sources[name]
    assert (report.status.state, report.status.age_s, report.required) == (state, None, required)


def test_the_separation_is_a_zone_and_a_reason_of_its_own():
    for separation, distance in itertools.product(Zone, (1.0, 0.3, 0.1, 0.0)):
        found = assessed(Seen(things=[thing(distance)]), separation=separation)
        beside = profile().zone_at(distance)
        assert (found.zone, found.beside) == (max(beside, separation), beside)
        assert ("separation" in found.reasons) == (separation is not Zone.GREEN)
    assert assessed(Seen(things=[thing(0.3)]), separation=Zone.RED).reasons == ["distance", "separation"]


def test_readings_that_contradict_every_obstacle_are_a_stop():
    found = assessed(Seen(reading=reading(contradicted=True)))
    assert (found.zone, found.beside, found.reasons) == (Zone.STOP, Zone.STOP, ["disagree"])


COMPARISON = compare(reading(thing(0.5, "ranges")), 0.5, "forearm_link", "nearest", 0.1)


@pytest.mark.parametrize("worth", ["off", "yellow", "red", "stop"])
@pytest.mark.parametrize("tracked", [False, True])
def test_an_uncovered_sector_is_worth_what_the_profile_says_where_nobody_else_looks(worth, tracked):
    seen = Seen(reading=reading(uncovered=True), comparison=COMPARISON if tracked else None)
    found = assessed(seen, uncovered=worth)
    counts = worth != "off" and not tracked
    assert found.zone is (Zone[worth.upper()] if counts else Zone.GREEN)
    assert found.reasons == (["uncovered"] if counts else [])
    assert assessed(Seen(reading=reading()), uncovered=worth).zone is Zone.GREEN


@pytest.mark.parametrize("worth", ["yellow", "red", "stop"])
def test_sources_that_disagree_are_worth_what_the_profile_says(worth):
    comparison = compare(reading(thing(0.5, "ranges")), 0.3, "forearm_link", "nearest", 0.1)
    assert comparison.disagrees
    found = assessed(Seen(reading=reading(), comparison=comparison), disagree_zone=worth)
    assert (found.zone, found.reasons) == (Zone[worth.upper()], ["disagree"])
    assert found.comparison is comparison
    twice = assessed(Seen(reading=reading(contradicted=True), comparison=comparison), disagree_zone=worth)
    assert (twice.zone, twice.reasons) == (Zone.STOP, ["disagree"])


def test_no_word_is_said_twice():
    near = thing(0.0, "ranges")
    seen = Seen(things=[near], reading=reading(near, unseen=True, uncovered=True))
    assert assessed(seen, uncovered="yellow").reasons == ["uncovered"]
    assert assessed(seen, uncovered="yellow").zone is Zone.STOP


@pytest.mark.parametrize(
    ("estimate", "least", "exact", "margin", "disagrees"),
    [
        (0.5, 0.5, 0.375, 0.125, False),
        (0.5, 0.5, 0.374, 0.125, True),
        (0.5, 0.5, 0.625, 0.125, False),
        (0.5, 0.5, 0.626, 0.125, True),
        (0.5, 0.5, None, 0.125, True),
        (None, math.inf, None, 0.125, False),
        (None, 0.5, 0.626, 0.125, True),
        (None, 0.5, 0.1, 0.125, False),
        (0.5, 0.5, 0.0, None, False),
        (0.125, 0.125, -0.3, 0.125, False),
        (0.126, 0.126, -0.3, 0.125, True),
    ],
)
def test_two_distances_contradict_each_other_by_more_than_the_margin(
    estimate, least, exact, margin, disagrees
):
    nearest = None if estimate is None else thing(estimate, "ranges")
    scan = reading(nearest, least={"forearm_link": least})
    found = compare(scan, exact, "forearm_link", "lower_bound", margin)
    assert found.disagrees is disagrees
    assert (found.link, found.estimator) == ("forearm_link", "lower_bound")
    assert (found.estimate, found.exact) == (estimate, exact)
    both = estimate is not None and exact is not None
    assert found.difference == (estimate - exact if both else None)


def test_an_estimate_of_another_link_says_nothing_of_this_one():
    scan = reading(thing(0.5, "ranges"), least={"forearm_link": 0.5})
    found = compare(scan, 0.1, "upper_arm_link", "nearest", 0.1)
    assert (found.estimate, found.difference, found.disagrees) == (None, None, False)


def test_the_exact_pair_as_the_nearest_thing():
    assert nearest_by_obstacles(None) is None
    pair = ClosestPair(
        link="forearm_link",
        obstacle="ball",
        distance=-0.25,
        point_on_link=np.array([1.0, 2.0, 3.0]),
        point_on_obstacle=np.array([4.0, 5.0, 6.0]),
        normal=np.array([0.0, 0.0, 1.0]),
    )
    found = nearest_by_obstacles(pair)
    assert found is not None
    assert (found.source, found.link, found.obstacle) == ("obstacles", "forearm_link", "ball")
    assert found.distance == -0.25
    assert found.point_on_link is pair.point_on_link
    assert found.point_on_obstacle is pair.point_on_obstacle
    assert found.normal is pair.normal


def test_the_reaction_time_of_each_source(robot: Robot):
    file = robot.config.file
    ring = robot.rings[0].period
    inputs = Inputs(
        joints=Received(age_s=0.03),
        ranges=Received(age_s=0.02, period_s=ring + 0.5),
        obstacles=Received(age_s=0.07, period_s=0.001),
        tick_s=0.004,
        transport_s=5.0,
    )
    both = reaction_times(robot, inputs, {"joints", "ranges", "obstacles"}, 0.002)
    assert list(both) == ["ranges", "obstacles"]
    ranges, obstacles = both["ranges"], both["obstacles"]
    assert (ranges.sensor_period, ranges.input_age) == (ring + 0.5, 0.03)
    assert (obstacles.sensor_period, obstacles.input_age) == (
        max(file.sources.obstacles.period_s, 0.001),
        0.07,
    )
    assert ranges.tick == obstacles.tick == 0.004
    assert ranges.transport == max(file.reaction.transport_s, 5.0)
    assert ranges.robot == file.reaction.robot_s
    assert set(reaction_times(robot, inputs, {"ranges"}, 0.002)) == {"ranges"}
    assert reaction_times(robot, inputs, {"joints", "target"}, 0.002) == {}
    slow = reaction_times(robot, inputs, {"obstacles"}, 0.01)["obstacles"]
    assert slow.tick == 0.01
    unknown = Inputs(ranges=Received(age_s=None), joints=Received(age_s=None))
    assert reaction_times(robot, unknown, {"ranges"}, 0.002)["ranges"].input_age == 0.0


def test_the_configured_reaction_time_has_no_ages(robot: Robot):
    file = robot.config.file
    found = configured_reaction(robot, "ranges", 0.003)
    assert found.sensor_period == max(robot.rings[0].period, file.sources.ranges.period_s)
    assert (found.input_age, found.tick) == (0.0, 0.003)
    assert (found.transport, found.robot) == (file.reaction.transport_s, file.reaction.robot_s)
    other = configured_reaction(robot, "obstacles", 0.003)
    assert other.sensor_period == file.sources.obstacles.period_s


def test_what_the_equation_demands_of_an_arm_at_rest(robot: Robot):
    config = robot.config.file.profiles["iso"].separation
    assert config is not None
    reaction = configured_reaction(robot, "ranges", 0.002).total
    stop = max(entry.time_s for entry in robot.config.file.stopping.values())
    uncertainty = max(config.human_uncertainty_m, max(ring.accuracy for ring in robot.rings))
    expected = (
        config.intrusion_m
        + config.robot_uncertainty_m
        + uncertainty
        + config.human_speed_m_s * (reaction + stop)
    )
    iso = ZoneProfile(name="iso", config=robot.config.file.profiles["iso"])
    assert standstill_distance(robot, iso, 0.002) == pytest.approx(expected, abs=1e-12)
    paper = ZoneProfile(name="kang2022", config=robot.config.file.profiles["kang2022"])
    assert standstill_distance(robot, paper, 0.002) == 0.0
    assert stopping_levels(robot).times[-1] == stop


def test_each_joints_limit_in_each_zone(robot: Robot):
    own = robot.velocity_limit
    assert zone_speed_limit(robot, profile(), Zone.STOP).tolist() == [0.0] * 6
    assert zone_speed_limit(robot, profile(), Zone.RED).tolist() == [0.18] * 6
    assert np.array_equal(zone_speed_limit(robot, profile(), Zone.GREEN), own)
    fast = ZoneConfig(distance_m=YELLOW, joint_speed_rad_s=3.0, speed_scaling=0.5)
    assert np.array_equal(zone_speed_limit(robot, profile(yellow=fast), Zone.YELLOW), np.minimum(own, 3.0))
    iso = ZoneProfile(name="iso", config=robot.config.file.profiles["iso"])
    for zone in (Zone.RED, Zone.YELLOW):
        np.testing.assert_allclose(zone_speed_limit(robot, iso, zone), own * iso.speed_scaling(zone))


def test_a_command_is_limited_by_the_robots_own_numbers(robot: Robot):
    limits = robot.config.file.limits
    rng = np.random.default_rng(3)
    for _ in range(50):
        wanted, previous = rng.uniform(-3.0, 3.0, (2, 6))
        position = rng.uniform(robot.position_lower, robot.position_upper)
        position[0] = robot.position_upper[0] - limits.position_margin_rad - 1e-3
        limit = rng.uniform(0.1, 3.0, 6)
        found = limited_velocity(
            robot, wanted, previous=previous, position=position, speed_limit=limit, period_s=0.01
        )
        expected = limit_velocity(
            wanted,
            previous=previous,
            position=position,
            speed_limit=limit,
            lower=robot.position_lower,
            upper=robot.position_upper,
            margin=limits.position_margin_rad,
            acceleration=limits.acceleration_rad_s2,
            dt=0.01,
        )
        assert np.array_equal(found, expected)


def test_the_least_scaling_of_all_limits_counts():
    wanted = np.array([0.5, -0.25])
    asked: list[Any] = []

    def limit(scaling: float) -> Any:
        return SimpleNamespace(scaling=lambda *what: asked.append(what) or scaling)

    step: Any = SimpleNamespace(share_of=lambda velocity: 0.75 if velocity is wanted else None)
    assert separated_velocity(None, [limit(0.5)], wanted) is wanted
    assert separated_velocity(step, [], wanted) is wanted
    assert asked == []
    assert separated_velocity(step, [limit(1.0), limit(1.0)], wanted) is wanted
    assert separated_velocity(step, [limit(0.75), limit(0.5)], wanted).tolist() == [0.25, -0.125]
    assert all(velocity is wanted and share == 0.75 for velocity, share in asked)


def table(first: float, count: int, undirected: bool) -> PairTable:
    column = first + np.arange(count, dtype=np.float64)
    return PairTable(
        ids=("ball",),
        link=np.arange(count),
        obstacle=np.arange(count) + 5,
        distance=column,
        exact=np.arange(count) % 2 == 0,
        point_on_link=column[:, np.newaxis] + np.zeros(3),
        point_on_obstacle=column[:, np.newaxis] + np.ones(3),
        normal=column[:, np.newaxis] - np.ones(3),
        human_speed=2.0 * column,
        uncertainty=3.0 * column,
        reaction_time=4.0 * column,
        closing=Closing(
            gradients=5.0 * column[:, np.newaxis] + np.zeros(2),
            undirected=np.full(count, undirected),
            jacobians=np.full((count if undirected else 0, 1, 3, 2), first),
        ),
    )


def test_tables_are_put_one_after_the_other():
    first, second = table(1.0, 2, False), table(10.0, 3, True)
    found = joined([first, second], 2)
    assert found.ids == first.ids
    for name in PairTable.__struct_fields__:
        if name in ("ids", "closing"):
            continue
        both = np.concatenate([getattr(first, name), getattr(second, name)])
        assert np.array_equal(getattr(found, name), both)
    assert np.array_equal(found.closing.gradients[:2], first.closing.gradients)
    assert np.array_equal(found.closing.gradients[2:], second.closing.gradients)
    assert found.closing.undirected.tolist() == [False, False, True, True, True]
    assert found.closing.jacobians is second.closing.jacobians
    assert joined([first], 2) is first


def test_a_table_of_nothing_has_the_shapes_of_one():
    none = joined([], 4)
    assert none.ids == ()
    for name in ("link", "obstacle", "distance", "exact", "human_speed", "uncertainty", "reaction_time"):
        assert getattr(none, name).shape == (0,)
    for name in ("point_on_link", "point_on_obstacle", "normal"):
        assert getattr(none, name).shape == (0, 3)
    assert none.link.dtype == none.obstacle.dtype == np.intp
    assert none.exact.dtype == np.bool_
    assert none.closing.gradients.shape == (0, 4)
    assert none.closing.at(np.ones(4)).shape == (0,)

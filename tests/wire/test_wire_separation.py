"""The terms of the separation distance on the wire are those of the decision, pair by pair."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import Decision, Inputs, JointSample, Monitor, Received
from ssm_service.wire.convert import separation_message, separation_pairs, zone_message

NAMES = ["joint"]


def decided(robot: Robot, profile: str, joints: bool = True) -> Decision:
    ball = Obstacle(id="ball", shape="sphere", size=(0.1,), position=(1.2, 0.0, 0.3))
    sample = JointSample(position=np.array([0.0, -1.0, 1.0, 0.0, 0.0, 0.0]), velocity=np.full(6, 0.05))
    monitor = Monitor(robot, profile=profile)
    inputs = Inputs(
        joints=Received(value=sample if joints else None, age_s=0.001 if joints else None),
        ranges=Received(value=np.full(robot.sensor_count, np.inf), age_s=0.01),
        obstacles=Received(value=(ball,), age_s=0.02),
    )
    return monitor.step(inputs)


@pytest.fixture(scope="module")
def by_equation(robot: Robot) -> Decision:
    return decided(robot, "iso")


def test_every_pair_is_told_with_all_its_terms(by_equation: Decision) -> None:
    separated = by_equation.separation
    assert separated is not None
    count = len(separated.table.distance)
    assert count >= 8
    pairs = separation_pairs(separated, range(count))
    message = separation_message(by_equation, pairs, producer="p", stamp_ns=7, robot="ur3", profile="iso")
    assert (message.producer, message.seq, message.stamp_ns) == ("p", by_equation.tick, 7)
    assert (message.robot, message.profile) == ("ur3", "iso")
    assert set(message.reaction) == set(separated.reactions)
    for terms in message.reaction.values():
        parts = [value for name, value in terms.items() if name != "total"]
        assert terms["total"] == pytest.approx(sum(parts), abs=1e-12)
    for index, pair in enumerate(message.pairs):
        assert pair.link == separated.link(index)
        assert pair.obstacle == separated.obstacle(index)
        assert pair.distance == separated.table.distance[index]
        terms = dict(pair.separation)
        assert terms.pop("S_p") == pytest.approx(sum(terms.values()), abs=1e-12)
        assert terms["S_h"] == pytest.approx(pair.human_speed * (pair.reaction_time + pair.stopping_time))
    assert msgspec.json.decode(msgspec.json.encode(message), type=type(message)) == message


def test_the_zone_names_the_pair_that_limits_and_its_reaction_time(by_equation: Decision) -> None:
    separated = by_equation.separation
    assert separated is not None
    zone = zone_message(
        by_equation, producer="p", stamp_ns=0, valid_for_ns=1, robot="ur3", profile="iso", name=NAMES
    )
    limiting = separated.limiting
    assert zone.limiting is not None
    assert limiting is not None
    (pair,) = separation_pairs(separated, range(limiting, limiting + 1))
    assert (zone.limiting.link, zone.limiting.source) == (pair.link, pair.source)
    assert zone.limiting.max_closing_speed == pair.max_closing_speed
    assert zone.limiting.separation == pair.separation
    assert zone.reaction is not None
    assert zone.reaction["total"] == pytest.approx(pair.reaction_time)


@pytest.mark.parametrize(("profile", "joints"), [("kang2022", True), ("iso", False)])
def test_without_the_equation_or_without_joints_there_are_no_terms(
    robot: Robot, profile: str, joints: bool
) -> None:
    decision = decided(robot, profile, joints)
    zone = zone_message(
        decision, producer="p", stamp_ns=0, valid_for_ns=1, robot="ur3", profile=profile, name=NAMES
    )
    assert zone.limiting is None
    message = separation_message(decision, [], producer="p", stamp_ns=0, robot="ur3", profile=profile)
    assert message.pairs == []
    if decision.separation is None:
        assert message.reaction == {}
        assert zone.reaction is None

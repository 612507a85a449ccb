"""Separation, limiting pair and reaction time on the wire."""

from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest

from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import Decision, EvaluationInput, Inputs, JointSample, Monitor, Received
from ssm_service.wire import evaluate_message, separation_message, separation_pairs, zone_message
from ssm_service.wire import messages as m

TERMS = ["S_p", "S_h", "S_r", "S_s", "C", "Z_d", "Z_r"]
POSE = np.array([0.4, -1.1, 1.0, 0.0, 0.0, 0.0])
JOINTS = JointSample(position=POSE, velocity=np.array([0.3, 0.0, -0.2, 0.0, 0.0, 0.0]))
BALL = Obstacle(id="ball", shape="sphere", size=(0.05,), position=(0.9, 0.1, 0.4))


@pytest.fixture(scope="module")
def iso() -> Monitor:
    return Monitor(Robot.load("ur3"), profile="iso")


def decide(monitor: Monitor, obstacles: tuple[Obstacle, ...] | None, echo: float = np.inf) -> Decision:
    return monitor.step(
        Inputs(
            joints=Received(value=JOINTS, age_s=0.001),
            ranges=Received(value=np.array([echo] + [np.inf] * 7), age_s=0.01),
            obstacles=Received() if obstacles is None else Received(value=obstacles, age_s=0.02),
        )
    )


def zone_of(decision: Decision) -> m.Zone:
    message = zone_message(
        decision, producer="p", stamp_ns=1, valid_for_ns=2, robot="ur3", profile="iso", name=["a"]
    )
    return msgspec.json.decode(msgspec.json.encode(message), type=m.Zone)


def pairs_of(decision: Decision) -> list[m.SeparationPair]:
    found = decision.separation
    assert found is not None
    return separation_pairs(found, range(len(found)))


def test_the_zone_names_what_limits_it_and_the_reaction_time(iso: Monitor) -> None:
    decision = decide(iso, (BALL,))
    zone, pairs = zone_of(decision), pairs_of(decision)
    assert zone.limiting is not None
    assert zone.reaction is not None
    assert list(zone.limiting.separation) == TERMS
    assert list(zone.reaction) == ["sensor_period", "input_age", "tick", "transport", "robot", "total"]
    (same,) = [pair for pair in pairs if pair.link == zone.limiting.link]
    assert (
        (same.source, same.obstacle)
        == (zone.limiting.source, zone.limiting.obstacle)
        == ("obstacles", "ball")
    )
    assert same.separation == zone.limiting.separation
    assert same.max_closing_speed == zone.limiting.max_closing_speed
    assert same.reaction_time == pytest.approx(zone.reaction["total"])


def test_every_pair_with_terms_that_add_up(iso: Monitor) -> None:
    decision = decide(iso, (BALL,), echo=0.9)
    message = separation_message(
        decision, pairs_of(decision), producer="p", stamp_ns=1, robot="ur3", profile="iso"
    )
    read = msgspec.json.decode(msgspec.json.encode(message), type=m.Separation)
    assert read == message
    assert (read.seq, set(read.reaction)) == (decision.tick, {"ranges", "obstacles"})
    assert len(read.pairs) == 9
    for pair in read.pairs:
        terms = pair.separation
        assert terms["S_p"] == pytest.approx(sum(terms[name] for name in TERMS[1:]))
        assert terms["S_h"] == pytest.approx(pair.human_speed * (pair.reaction_time + pair.stopping_time))
        assert pair.reaction_time == pytest.approx(read.reaction[pair.source]["total"])
    assert (read.pairs[-1].source, read.pairs[-1].obstacle, read.pairs[-1].exact) == ("ranges", None, False)


def test_a_profile_without_separation_says_nothing_of_it() -> None:
    decision = decide(Monitor(Robot.load("ur3"), profile="kang2022"), (BALL,))
    zone = zone_of(decision)
    assert (zone.limiting, zone.reaction) == (None, None)
    message = separation_message(decision, [], producer="p", stamp_ns=1, robot="ur3", profile="kang2022")
    assert (message.reaction, message.pairs) == ({}, [])


def test_nothing_near_is_no_limiting_pair(iso: Monitor) -> None:
    zone = zone_of(decide(iso, ()))
    assert zone.limiting is None
    assert zone.reaction is not None
    assert zone.reaction["sensor_period"] == 0.16


def test_every_number_is_finite_where_coal_failed(iso: Monitor) -> None:
    decision = decide(iso, (BALL,))
    assert decision.separation is not None
    decision.separation.table.distance[0] = -np.inf
    text = json.dumps([msgspec.to_builtins(pair) for pair in pairs_of(decision)], allow_nan=False)
    assert json.loads(text)[0]["distance"] == 0.0


def test_evaluate_has_the_terms_of_each_pair(iso: Monitor) -> None:
    answer = evaluate_message(
        iso.evaluate(EvaluationInput(joints=JOINTS, velocity_known=True, obstacles=(BALL,)))
    )
    for pair in answer.pairs:
        assert pair.separation is not None
        assert list(pair.separation) == TERMS
        assert pair.max_closing_speed is not None

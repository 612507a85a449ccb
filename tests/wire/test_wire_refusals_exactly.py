"""Each refusal says which field, what stood there and what may stand there, in the error's attributes."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from wire_samples import VALID, changed, obstacle

from ssm_service.errors import InputError
from ssm_service.model import Obstacle, Robot
from ssm_service.wire import Decoder, SealedDecoder, all_finite, obstacles_from, optional_readings
from ssm_service.wire import messages as m
from ssm_service.wire.decode import _CAUSES
from ssm_service.wire.gate import ProducerGate, old_seq


def said(action: Callable[..., Any], *arguments: Any, **named: Any) -> tuple[Any, ...]:
    """What a refusal says: cause, field, found, allowed, fault."""
    with pytest.raises(InputError) as caught:
        action(*arguments, **named)
    error = caught.value
    return error.cause, error.where, error.found, error.allowed, error.fault


@pytest.mark.parametrize("decoder", [Decoder(m.Ranges, 10), SealedDecoder(m.Ranges, "key", 10)])
def test_a_payload_may_be_as_long_as_the_limit(decoder):
    arguments = ((), {}) if isinstance(decoder, Decoder) else ((None,), {"required": False})
    fault = "" if isinstance(decoder, Decoder) else "insertion"
    expected = ("too_large", "payload", "11 bytes", "at most 10 bytes", fault)
    assert said(decoder.decode, b" " * 11, *arguments[0], **arguments[1]) == expected
    assert said(decoder.decode, b" " * 10, *arguments[0], **arguments[1])[0] == "not_json"


def test_what_is_no_json_is_refused_in_the_words_of_the_parser():
    with pytest.raises(msgspec.DecodeError) as parser:
        msgspec.json.decode(b"{")
    found = str(parser.value)
    assert said(Decoder(m.Ranges).decode, b"{") == (
        "not_json",
        "payload",
        found,
        "one JSON object in UTF-8",
        "",
    )


@pytest.mark.parametrize(
    ("kind", "payload", "cause", "where", "allowed"),
    [
        (m.Ranges, changed("ranges", seq=-1), "out_of_range", "seq", "`int` >= 0"),
        (m.Ranges, changed("ranges", seq="1"), "wrong_type", "seq", "`int`, got `str`"),
        (m.Ranges, changed("ranges", seq=None), "wrong_type", "seq", "`int`, got `null`"),
        (m.Ranges, changed("ranges", producer=""), "wrong_length", "producer", "`str` of length >= 1"),
        (m.Ranges, {}, "missing_field", "Ranges", "Object missing required field `producer`"),
        (m.Ranges, [], "wrong_type", "Ranges", "`object`, got `array`"),
        (m.Ranges, changed("ranges", x=1), "unknown_field", "Ranges", "Object contains unknown field `x`"),
        (m.Target, changed("target", kind="speed"), "unknown_word", "kind", "Invalid enum value 'speed'"),
        (
            m.Obstacles,
            obstacle(shape="cone"),
            "unknown_shape",
            "obstacles[0].shape",
            "Invalid enum value 'cone'",
        ),
        (m.Obstacles, obstacle(size=["x"]), "wrong_type", "obstacles[0].size[0]", "`float`, got `str`"),
    ],
)
def test_the_place_and_what_may_stand_there_come_from_the_schema(kind, payload, cause, where, allowed):
    text = json.dumps(payload)
    found = text[:80] + "…" if len(text) > 80 else text
    assert said(Decoder(kind).decode, text.encode()) == (cause, where, found, allowed, "")


def test_every_phrase_of_the_parser_has_a_cause_that_health_counts():
    words = {cause for _, cause in _CAUSES}
    assert words == {
        "missing_field",
        "unknown_field",
        "unknown_word",
        "wrong_type",
        "wrong_length",
        "out_of_range",
    }


def test_a_sender_s_own_words_are_cut_to_300_letters():
    (_, where, _, allowed, _) = said(Decoder(m.Ranges).decode, json.dumps({"y" * 1000: 1}).encode())
    assert where == "Ranges"
    assert len(allowed) == 300
    assert allowed.endswith("y…")
    short = "y" * (300 - len("Object contains unknown field ``"))
    (_, _, _, allowed, _) = said(Decoder(m.Ranges).decode, json.dumps({short: 1}).encode())
    assert allowed == f"Object contains unknown field `{short}`"


def test_bytes_that_are_no_text_are_shown_by_a_sign_for_them():
    (_, _, found, _, _) = said(Decoder(m.Ranges).decode, b'{"seq": "\xff"}')
    assert "\ufffd" in found or "byte" in found


@pytest.mark.parametrize(
    ("payload", "cause", "where", "found"),
    [
        ({"position": [0.0, "x"]}, "wrong_type", "position[1]", "x"),
        ({"position": [0.0], "name": [1]}, "wrong_type", "name[0]", 1),
        (
            {"position": [0.0], "target": {"kind": "speed", "value": []}},
            "unknown_word",
            "target.kind",
            "speed",
        ),
    ],
)
def test_an_explained_refusal_names_the_value(payload, cause, where, found):
    answer = said(Decoder(m.EvaluateInput, explain=True).decode, json.dumps(payload).encode())
    assert answer[:3] == (cause, where, found)
    assert answer[3]
    assert "`" not in answer[3]


def test_an_explained_refusal_cuts_what_a_sender_wrote():
    payload = {"position": [0.0], "z" * 1000: 1}
    (cause, where, _, allowed, _) = said(
        Decoder(m.EvaluateInput, explain=True).decode, json.dumps(payload).encode()
    )
    assert (cause, len(where)) == ("unknown_field", 300)
    assert len(allowed) <= 300


def test_a_number_beyond_every_double_is_refused_with_and_without_an_explanation():
    payload = b'{"position": [0.0], "target": {"kind": "twist", "value": [' + b"9" * 400 + b"]}}"
    for explain in (False, True):
        answer = said(Decoder(m.EvaluateInput, explain=explain).decode, payload)
        assert answer[:2] == ("out_of_range", "target.value[0]")


def entry(**fields: Any) -> m.ObstacleEntry:
    return msgspec.convert(obstacle(**fields)["obstacles"][0], m.ObstacleEntry)


def test_an_obstacle_is_refused_with_its_index_and_otherwise_as_it_refuses_itself():
    entries = [entry(), entry(id="b", size=[0.0])]
    cause, where, found, allowed, _ = said(obstacles_from, entries)
    assert (cause, where) == ("out_of_range", "obstacles[1].size")
    with pytest.raises(InputError) as own:
        Obstacle(id="b", shape="sphere", size=(0.0,), position=(0.4, 0.0, 0.3))
    assert (found, allowed) == (own.value.found, own.value.allowed)


def test_two_obstacles_of_one_id_are_refused_by_all_ids():
    entries = [entry(), entry(id="b"), entry()]
    expected = ("repeated_id", "obstacles", ["ball", "b", "ball"], "each id once", "")
    assert said(obstacles_from, entries) == expected


def test_an_obstacle_has_what_its_entry_says():
    turned = (0.5, 0.5, 0.5, 0.5)
    fields = {"shape": "capsule", "size": [0.05, 0.4], "quaternion_xyzw": turned, "velocity": [0.1, 0.2, 0.3]}
    (made,) = obstacles_from([entry(**fields)])
    assert (made.id, made.shape, made.size) == ("ball", "capsule", (0.05, 0.4))
    assert made.position == (0.4, 0.0, 0.3)
    assert (made.quaternion_xyzw, made.velocity) == (turned, (0.1, 0.2, 0.3))


def test_a_reading_that_is_no_number_is_named():
    cause, where, found, allowed, _ = said(optional_readings, np.array([0.5, np.inf, np.nan]))
    assert (cause, where, allowed) == ("not_finite", "ranges[2]", "a number, or inf for no echo")
    assert np.isnan(found)


def test_a_repeated_and_an_older_tick_and_a_second_producer():
    allowed = "above 7, the last one accepted"
    for seq, fault in ((7, "repetition"), (6, "sequence")):
        error = old_seq(seq, 7)
        assert (error.cause, error.where, error.found, error.allowed) == ("old_seq", "seq", seq, allowed)
        assert error.fault == fault
    gate = ProducerGate(1.0)
    gate.accept("p", 7, 0.0)
    expected = ("second_producer", "producer", "q", "only p while it is fresh", "insertion")
    assert said(gate.check, "q", 1, 1.0) == expected
    gate.check("q", 1, 1.0000001)


@pytest.mark.parametrize(
    ("value", "finite"),
    [
        (1.0, True),
        (float("nan"), False),
        (float("-inf"), False),
        ({"a": [1, (2.0, {"b": float("inf")})]}, False),
        ({"a": [1, (2.0, {"b": 3.0})], "c": None, "d": "inf"}, True),
        ({"a": float("inf"), "b": 1.0}, False),
        ([1.0, float("inf")], False),
        ((float("inf"), 1.0), False),
        ([], True),
        ({}, True),
        (10**400, True),
    ],
)
def test_every_number_inside_counts(value, finite):
    assert all_finite(value) is finite


def test_a_joint_state_is_read_by_its_names(accept, robot: Robot):
    shuffled = list(reversed(robot.joint_names))
    message = changed(
        "joints",
        name=shuffled,
        position=[0.6, 0.5, 0.4, 0.3, 0.2, 0.1],
        velocity=[0.06, 0.05, 0.04, 0.03, 0.02, 0.01],
    )
    value = accept("joints", json.dumps(message).encode())
    assert value.position.tolist() == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert value.velocity.tolist() == [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]


def test_a_target_is_read_whole(accept):
    value = accept("target", json.dumps(changed("target", controller="field3d")).encode())
    assert (value.kind, value.controller) == ("position", "field3d")
    assert np.asarray(value.value).tolist() == VALID["target"]["value"]

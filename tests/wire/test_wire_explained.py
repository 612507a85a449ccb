"""Refusals that name the very value, for whoever waits for one answer instead of draining a flood."""

from __future__ import annotations

import json

import pytest
from wire_samples import VALID

from ssm_service.errors import InputError
from ssm_service.wire import Decoder
from ssm_service.wire.messages import EvaluateInput, Obstacles


def refusals(kind, payload) -> tuple[InputError, InputError]:
    """Return the refusal without and with an explanation."""
    data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    found = []
    for explain in (False, True):
        with pytest.raises(InputError) as caught:
            Decoder(kind, explain=explain).decode(data)
        found.append(caught.value)
    short, long = found
    assert short.cause == long.cause
    return short, long


@pytest.mark.parametrize(
    ("payload", "cause", "where", "value"),
    [
        ({"position": "here"}, "wrong_type", "position", "here"),
        ({"position": [0.0, "x"]}, "wrong_type", "position[1]", "x"),
        ({}, "missing_field", "position", None),
        ({"position": [0.0], "frob": 3}, "unknown_field", "frob", "an unknown key"),
    ],
)
def test_the_value_and_its_place_are_named(payload, cause, where, value):
    short, long = refusals(EvaluateInput, payload)
    assert long.cause == cause
    assert long.where == where
    assert long.allowed
    if value is not None:
        assert long.found == value
    assert short.found == json.dumps(payload)


def test_an_unknown_shape_is_named_with_those_that_are_known():
    wrong = json.loads(json.dumps(VALID["obstacles"]))
    wrong["obstacles"][0]["shape"] = "cube"
    _, long = refusals(Obstacles, wrong)
    assert (long.cause, long.where, long.found) == ("unknown_shape", "obstacles[0].shape", "cube")
    assert "sphere" in long.allowed


@pytest.mark.parametrize(
    "text",
    [
        '{"position": "here", "frob": 3}',  # two things are wrong, and the other check begins with the other
        '{"position": "here", "name": ',  # what is wrong comes before it breaks off
    ],
)
def test_without_the_same_place_the_message_itself_is_shown(text):
    short, long = refusals(EvaluateInput, text.encode())
    assert (long.cause, long.where) == ("wrong_type", "position")
    assert str(long) == str(short)
    assert long.found == text


def test_a_long_message_is_shown_by_its_beginning():
    text = json.dumps({"position": "here" * 30})
    short, _ = refusals(EvaluateInput, text.encode())
    assert short.found == text[:80] + "…"
    just = json.dumps({"position": "h" * (80 - len('{"position": ""}'))})
    short, _ = refusals(EvaluateInput, just.encode())
    assert (len(just), short.found) == (80, just)


def test_a_short_message_is_shown_whole_and_bytes_that_are_no_text_too():
    short, _ = refusals(EvaluateInput, b'{"position": 1}')
    assert short.found == '{"position": 1}'
    with pytest.raises(InputError) as caught:
        Decoder(EvaluateInput, explain=True).decode(b'{"position": [0.0], "na\xff": 1}')
    assert caught.value.where

"""What goes into an ``evaluate`` query, and what is made of the answer."""

from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest

from ssm_service.client.chunks import CHUNK_INPUTS, CHUNK_OBSTACLES, chunks, encoded, outputs
from ssm_service.errors import InputError, ServiceError
from ssm_service.wire import messages as m

BALL = {"id": "a", "shape": "sphere", "size": [0.1], "position": [1.0, 0.0, 0.0]}
OUTPUT = {
    "zone": "red",
    "distance": 0.1,
    "speed_limit": [0.18],
    "speed_scaling": 0.25,
    "reasons": ["distance"],
    "pairs": [],
    "estimates": None,
    "frames": {"sensors": [], "end_effector": np.eye(4).tolist()},
    "jacobian": [],
    "command": None,
}


def test_what_is_left_out_is_not_sent_as_null():
    assert encoded({"position": np.array([1.5]), "name": None}) == b'{"position":[1.5]}'
    assert encoded([None, np.float64(0.5), np.int64(3)]) == b"[null,0.5,3]"


@pytest.mark.parametrize("value", [object(), {"position": [object()]}, 1j])
def test_what_json_cannot_say_is_refused_by_its_place(value):
    with pytest.raises(InputError) as caught:
        encoded(value, "there")
    error = caught.value
    assert (error.cause, error.where, error.allowed) == ("wrong_type", "there", "what JSON can say")
    assert error.found == repr(value)


def test_a_number_that_is_none_is_refused_by_its_place():
    value = {"ranges": [float("inf")]}
    with pytest.raises(InputError) as caught:
        encoded(value)
    error = caught.value
    assert (error.cause, error.where) == ("not_finite", "payload")
    assert (error.found, error.allowed) == (value, "finite numbers or null")


def test_messages_and_mappings_make_the_same_chunks():
    messages = [
        m.EvaluateInput(position=[0.5], obstacles=[msgspec.convert(BALL, m.ObstacleEntry)]),
        m.EvaluateInput(position=[0.5]),
    ]
    (chunk,) = chunks(messages)
    assert chunk.count == 2
    decoded = msgspec.json.decode(chunk.payload, type=list[m.EvaluateInput])
    assert decoded == messages


@pytest.mark.parametrize("count", [1, CHUNK_INPUTS, CHUNK_INPUTS + 1, 2 * CHUNK_INPUTS + 1])
def test_chunks_are_full_but_for_the_last(count):
    found = list(chunks([{"position": [float(index)]} for index in range(count)]))
    assert [chunk.count for chunk in found[:-1]] == [CHUNK_INPUTS] * (len(found) - 1)
    assert sum(chunk.count for chunk in found) == count
    sent = [entry["position"][0] for chunk in found for entry in json.loads(chunk.payload)]
    assert sent == list(range(count))


def test_obstacles_fill_a_chunk_to_the_last_place():
    def of(number, kind=list):
        return {"position": [0.0], "obstacles": kind([BALL] * number)}

    half = CHUNK_OBSTACLES // 2
    assert [chunk.count for chunk in chunks([of(half), of(half, tuple), of(0), of(1)])] == [3, 1]
    assert [chunk.count for chunk in chunks([of(half), of(half + 1)])] == [1, 1]
    assert [chunk.count for chunk in chunks([{"obstacles": 7}, of(CHUNK_OBSTACLES)])] == [2]


def test_answers_are_outputs_and_errors_in_their_order():
    first, second = outputs(json.dumps([OUTPUT, {"error": "no"}]).encode(), 2)
    assert isinstance(first, m.EvaluateOutput)
    assert (first.zone, first.distance) == ("red", 0.1)
    assert second == m.EvaluateError(error="no")


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b'[{"error": "no"}]', "answered 1 of 2"),
        (b"[]", "answered 0 of 2"),
        (b"{}", "malformed"),
        (b"[", "malformed"),
        (b'[{"error": "no"}, {"zone": "red"}]', "malformed"),
    ],
)
def test_an_answer_that_is_not_one_for_each_is_an_error(answer, words):
    with pytest.raises(ServiceError, match=words):
        outputs(answer, 2)

"""Round trips, encodings and the published schemas."""

from __future__ import annotations

import json
from typing import Any

import jsonschema
import msgspec
import numpy as np
import pytest
from wire_samples import VALID

from ssm_service.errors import InputError
from ssm_service.monitor import Evaluator, Inputs, Monitor, Received, zone_profile
from ssm_service.wire import (
    all_finite,
    command_message,
    encoding_of,
    evaluate_message,
    frames_message,
    json_schemas,
    names_another,
    optional_readings,
    question_from,
    zone_message,
)
from ssm_service.wire import messages as m

HEADS = {"producer": "service", "stamp_ns": 1, "valid_for_ns": 20_000_000, "robot": "ur3"}


DOCUMENT = json.loads(json.dumps(json_schemas()))


def validate(value: Any, name: str) -> None:
    validator = jsonschema.Draft202012Validator({**DOCUMENT, "$ref": f"#/$defs/{name}"})
    validator.validate(value)


def decided(robot, accept, position: list[float]):
    """Decide until the zone is steady."""
    monitor = Monitor(robot)
    ball = {**VALID["obstacles"]["obstacles"][0], "position": position}
    sent = {
        **VALID,
        "ranges": {**VALID["ranges"], "ranges": [None] * 8},
        "obstacles": {**VALID["obstacles"], "obstacles": [ball]},
    }
    values = {source: accept(source, json.dumps(message).encode()) for source, message in sent.items()}
    inputs = Inputs(**{source: Received(value=value, age_s=0.01) for source, value in values.items()})
    for _ in range(monitor.profile.config.recovery_ticks + 10):
        decision = monitor.step(inputs)
    return decision


@pytest.fixture(scope="module")
def outputs(robot, accept) -> list[m.Message]:
    """Messages that the service sends, in all zones and at the start."""
    messages: list[m.Message] = []
    decisions = [Monitor(robot).step(Inputs())]
    decisions += [decided(robot, accept, [x, 0.0, 0.3]) for x in (0.0, 0.5, 0.8, 3.0)]
    for decision in decisions:
        names = list(robot.joint_names)
        messages.append(zone_message(decision, profile="kang2022", name=names, **HEADS))
        messages.append(command_message(decision, name=names, **HEADS))
    evaluator = Evaluator(robot, zone_profile(robot, None))
    position = [0.0, -1.0, 1.0, 0.0, 0.0, 0.0]
    target = m.EvaluateTarget(kind="position", value=[0.3, 0.1, 0.4])
    entries = msgspec.convert(VALID["obstacles"]["obstacles"], list[m.ObstacleEntry])
    questions = (
        m.EvaluateInput(position=position),
        m.EvaluateInput(position=position, ranges=[0.5, 0.6, None, None, None, None, None, None]),
        m.EvaluateInput(position=position, velocity=[0.1] * 6, obstacles=entries, target=target),
        m.EvaluateInput(position=position, ranges=[None] * 8, obstacles=[], target=target),
    )
    messages += [
        evaluate_message(evaluator.evaluate(question_from(robot, question))) for question in questions
    ]
    messages.append(frames_message(robot, "ur3", np.array(position)))
    messages.append(m.EvaluateError(error="no"))
    return messages


def test_every_zone_occurs_among_the_outputs(outputs):
    words = {message.zone for message in outputs if isinstance(message, m.Zone)}
    assert words == {"stop", "red", "yellow", "green"}


def test_every_output_is_finite_round_trips_and_fits_its_schema(outputs):
    kinds = set()
    for message in outputs:
        text = msgspec.json.encode(message)
        assert all_finite(msgspec.to_builtins(message))
        assert msgspec.json.decode(text, type=type(message)) == message
        validate(json.loads(text), type(message).__name__)
        kinds.add(type(message))
    assert kinds == {m.Zone, m.VelocityCommand, m.EvaluateOutput, m.FramesReply, m.EvaluateError}


@pytest.mark.parametrize("source", VALID)
def test_every_input_round_trips_and_fits_its_schema(source):
    kind = m.INPUTS[source]
    message = msgspec.json.decode(json.dumps(VALID[source]), type=kind)
    text = msgspec.json.encode(message)
    assert msgspec.json.decode(text, type=kind) == message
    validate(json.loads(text), kind.__name__)
    validate(VALID[source], kind.__name__)


@pytest.mark.parametrize("source", VALID)
def test_the_schema_refuses_what_the_decoder_refuses(source):
    name = m.INPUTS[source].__name__
    for wrong in (
        {},
        [],
        {**VALID[source], "extra": 1},
        {**VALID[source], "seq": -1},
        {**VALID[source], "seq": "1"},
        {**VALID[source], "producer": ""},
        {key: value for key, value in VALID[source].items() if key != "stamp_ns"},
    ):
        with pytest.raises(jsonschema.ValidationError):
            validate(wrong, name)


def test_the_schemas_are_schemas_of_all_messages():
    jsonschema.Draft202012Validator.check_schema(DOCUMENT)
    assert {kind.__name__ for kind in m.ALL} <= set(DOCUMENT["$defs"])


def test_encodings_are_exactly_what_is_promised():
    assert {kind.__name__: encoding_of(kind) for kind in m.ALL} == {
        name: f"application/json;ssm.{name}/1"
        for name in (
            "JointState",
            "Ranges",
            "Obstacles",
            "Target",
            "Zone",
            "VelocityCommand",
            "EvaluateInput",
            "EvaluateOutput",
            "EvaluateError",
            "FramesRequest",
            "FramesReply",
            "Echo",
            "Separation",
            "Health",
            "ResetReply",
        )
    }


def test_no_echo_is_null_on_the_wire_and_infinity_inside(accept):
    payload = json.dumps({**VALID["ranges"], "ranges": [None, 0.5] * 4}).encode()
    scan = accept("ranges", payload)
    assert scan.tolist() == [float("inf"), 0.5] * 4
    assert optional_readings(scan) == [None, 0.5] * 4
    with pytest.raises(InputError, match=r"ranges\[1\]: found nan"):
        optional_readings(np.array([0.5, np.nan]))


def test_what_may_be_left_out_of_an_obstacle(accept):
    (ball, arm, *_) = accept("obstacles", json.dumps(VALID["obstacles"]).encode())
    assert ball.quaternion_xyzw == (0.0, 0.0, 0.0, 1.0)
    assert ball.velocity is None  # not known, and not the same as standing still
    assert arm.velocity == (0.0, -0.5, 0.0)


def test_an_empty_list_of_obstacles_is_a_value(accept):
    assert accept("obstacles", json.dumps({**VALID["obstacles"], "obstacles": []}).encode()) == ()


def test_only_another_schema_of_ours_is_a_wrong_encoding():
    own = encoding_of(m.Ranges)
    for fits in (own, "application/json", "zenoh/bytes", "zenoh/string", "text/plain", ""):
        assert not names_another(fits, m.Ranges)
    for other in (encoding_of(m.Zone), "application/json;ssm.Ranges/2", "text/json;ssm.Ranges/1"):
        assert names_another(other, m.Ranges)

"""Every refusal by its cause: the word is the counter in ``health``."""

from __future__ import annotations

import json
import time

import pytest
from wire_samples import JOINTS, VALID, changed, obstacle, without

from ssm_service.wire.messages import MAX_OBSTACLES, MAX_PAYLOAD

HUGE = "9" * 400
FIRST = json.dumps(VALID["joints"]).encode()


@pytest.mark.parametrize("source", VALID)
def test_the_valid_message_is_accepted(accept, source):
    accept(source, json.dumps(VALID[source]).encode())


@pytest.mark.parametrize("source", VALID)
@pytest.mark.parametrize(
    ("payload", "cause"),
    [
        (b"", "not_json"),
        (b" ", "not_json"),
        (b"nul", "not_json"),
        (b"{", "not_json"),
        (b"\xff\xfe", "not_json"),
        (b"\x00" * 100, "not_json"),
        (b"null", "wrong_type"),
        (b"1", "wrong_type"),
        (b'"text"', "wrong_type"),
        (b"[]", "wrong_type"),
        (b"[" * 60_000, "wrong_type"),
        (b"{}", "missing_field"),
        (b'{"x":' * 10_000, "unknown_field"),
        (b'{"producer":' + b'[{"a":' * 8_000, "wrong_type"),
        (b" " * (MAX_PAYLOAD + 1), "too_large"),
        (b"[" * 5_000_000, "too_large"),
    ],
    ids=repr,
)
def test_what_is_no_message_is_refused(refused, source, payload, cause):
    assert refused(source, payload).cause == cause


@pytest.mark.parametrize(
    ("source", "field"), [(source, field) for source in VALID for field in VALID[source]]
)
def test_every_field_must_be_there(refused, source, field):
    error = refused(source, without(source, field))
    assert error.cause == "missing_field"
    assert field in str(error)


@pytest.mark.parametrize("source", VALID)
def test_an_unknown_field_is_refused(refused, source):
    assert refused(source, changed(source, velocity_typo=[])).cause == "unknown_field"


def test_a_misspelt_optional_field_is_never_taken_as_left_out(refused):
    error = refused("obstacles", obstacle(velocitty=[0, -2, 0]))
    assert (error.cause, error.where) == ("unknown_field", "obstacles[0]")


@pytest.mark.parametrize("source", VALID)
@pytest.mark.parametrize(
    ("field", "text", "cause"),
    [
        ("producer", '""', "wrong_length"),
        ("producer", json.dumps("x" * 65), "wrong_length"),
        ("producer", "1", "wrong_type"),
        ("producer", '"\\ud800"', "not_json"),
        ("seq", "true", "wrong_type"),
        ("seq", "1.0", "wrong_type"),
        ("seq", '"1"', "wrong_type"),
        ("seq", "null", "wrong_type"),
        ("seq", "-1", "out_of_range"),
        ("seq", str(2**63), "out_of_range"),
        ("seq", str(2**64), "out_of_range"),
        ("seq", HUGE, "out_of_range"),
        ("stamp_ns", str(-(2**63) - 1), "out_of_range"),
        ("stamp_ns", HUGE, "out_of_range"),
        ("stamp_ns", "NaN", "not_json"),
    ],
)
def test_a_wrong_head_is_refused_and_named(refused, source, field, text, cause):
    payload = json.dumps({**VALID[source], field: "HERE"}).replace('"HERE"', text).encode()
    error = refused(source, payload)
    assert error.cause == cause
    assert error.where == ("payload" if cause == "not_json" else field)


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("NaN", "not_json"),
        ("Infinity", "not_json"),
        ("-Infinity", "not_json"),
        ("nan", "not_json"),
        ("1e999", "out_of_range"),
        ("-1e999", "out_of_range"),
        (HUGE, "out_of_range"),
        ("1e300", "out_of_range"),
        ('"0"', "wrong_type"),
        ("true", "wrong_type"),
        ("[0]", "wrong_type"),
        ("{}", "wrong_type"),
        ("0x10", "not_json"),
        ("01", "not_json"),
        (".5", "not_json"),
    ],
)
@pytest.mark.parametrize(
    ("source", "template"),
    [
        ("joints", changed("joints", position=["HERE", 0, 0, 0, 0, 0])),
        ("joints", changed("joints", velocity=["HERE", 0, 0, 0, 0, 0])),
        ("ranges", changed("ranges", ranges=["HERE"] * 8)),
        ("obstacles", obstacle(position=["HERE", 0, 0])),
        ("obstacles", obstacle(size=["HERE"])),
        ("obstacles", obstacle(velocity=[0, 0, "HERE"])),
        ("target", changed("target", value=["HERE", 0, 0])),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_no_number_but_a_finite_one_in_range_passes(refused, source, template, text, cause):
    payload = json.dumps(template).replace('"HERE"', text).encode()
    assert refused(source, payload).cause == cause


@pytest.mark.parametrize(
    ("fields", "cause"),
    [
        ({"position": [0.0] * 5}, "wrong_length"),
        ({"position": []}, "wrong_length"),
        ({"velocity": [0.0] * 7}, "wrong_length"),
        ({"name": list(JOINTS[:5])}, "missing_joint"),
        ({"name": []}, "missing_joint"),
        ({"name": [*JOINTS[:5], JOINTS[0]]}, "repeated_joint"),
        ({"name": [*JOINTS, JOINTS[0]], "position": [0] * 7, "velocity": [0] * 7}, "repeated_joint"),
        ({"name": [*JOINTS[:5], "wrist_4_joint"]}, "unknown_joint"),
        ({"name": [*JOINTS, "gripper"], "position": [0] * 7, "velocity": [0] * 7}, "unknown_joint"),
        ({"name": [*JOINTS[:5], JOINTS[5].upper()]}, "unknown_joint"),
        ({"name": None}, "wrong_type"),
        ({"position": [None, 0, 0, 0, 0, 0]}, "wrong_type"),
        ({"position": [7.0, 0, 0, 0, 0, 0]}, "out_of_range"),
        ({"velocity": [0, 0, 0, 0, 0, -1000]}, "out_of_range"),
    ],
)
def test_joint_states(refused, fields, cause):
    assert refused("joints", changed("joints", **fields)).cause == cause


@pytest.mark.parametrize(
    ("ranges", "cause"),
    [
        ([0.5] * 7, "wrong_length"),
        ([0.5] * 9, "wrong_length"),
        ([], "wrong_length"),
        ([None] * 1025, "wrong_length"),
        ([-1.0] * 8, "out_of_range"),
        ([1.3] * 8, "out_of_range"),
        (["null"] * 8, "wrong_type"),
        ({}, "wrong_type"),
    ],
)
def test_ranges(refused, ranges, cause):
    assert refused("ranges", changed("ranges", ranges=ranges)).cause == cause


@pytest.mark.parametrize(
    ("fields", "cause", "where"),
    [
        ({"shape": "cone", "size": [1, 1]}, "unknown_shape", "shape"),
        ({"shape": ""}, "unknown_shape", "shape"),
        ({"shape": None}, "wrong_type", "shape"),
        ({"shape": "Sphere"}, "unknown_shape", "shape"),
        ({"size": []}, "wrong_length", "size"),
        ({"size": [1, 1]}, "wrong_length", "size"),
        ({"size": [0]}, "out_of_range", "size"),
        ({"size": [-1]}, "out_of_range", "size"),
        ({"size": [101]}, "out_of_range", "size"),
        ({"shape": "box", "size": [1, 1, 0]}, "out_of_range", "size"),
        ({"position": [0, 0]}, "wrong_length", "position"),
        ({"position": [0, 0, 1001]}, "out_of_range", "position"),
        ({"velocity": [0, 1001, 0]}, "out_of_range", "velocity"),
        ({"velocity": "0"}, "wrong_type", "velocity"),
        ({"quaternion_xyzw": [0, 0, 0, 0]}, "bad_quaternion", "quaternion_xyzw"),
        ({"quaternion_xyzw": [0, 0, 0, 1.1]}, "bad_quaternion", "quaternion_xyzw"),
        ({"quaternion_xyzw": [0, 0, 1]}, "wrong_length", "quaternion_xyzw"),
        ({"id": ""}, "wrong_length", "id"),
        ({"id": "x" * 65}, "wrong_length", "id"),
        ({"id": 1}, "wrong_type", "id"),
    ],
)
def test_obstacles_say_which_entry_and_field(refused, fields, cause, where):
    error = refused("obstacles", obstacle(**fields))
    assert (error.cause, error.where) == (cause, f"obstacles[0].{where}")


def test_obstacles_as_a_whole(refused):
    entry = obstacle()["obstacles"][0]
    twice = changed("obstacles", obstacles=[entry, entry])
    assert refused("obstacles", twice).cause == "repeated_id"
    many = [{**entry, "id": str(index)} for index in range(MAX_OBSTACLES + 1)]
    assert refused("obstacles", changed("obstacles", obstacles=many)).cause == "wrong_length"
    assert refused("obstacles", changed("obstacles", obstacles=None)).cause == "wrong_type"
    assert refused("obstacles", changed("obstacles", obstacles=[None])).cause == "wrong_type"


@pytest.mark.parametrize(
    ("kind", "value", "cause"),
    [
        ("speed", [0, 0, 0], "unknown_word"),
        ("pose", [0, 0, 0, 0, 0, 0, 1], "unsupported_kind"),
        ("position", [0, 0], "wrong_length"),
        ("position", [0] * 65, "wrong_length"),
        ("twist", [0, 0, 0], "wrong_length"),
        ("joint_velocity", [0] * 5, "wrong_length"),
        ("position", [0, 0, 1001], "out_of_range"),
        ("twist", [0, 0, 0, 0.1, 0, 0], "out_of_range"),
        (None, [0, 0, 0], "wrong_type"),
    ],
)
def test_targets(refused, kind, value, cause):
    assert refused("target", changed("target", kind=kind, value=value)).cause == cause


@pytest.mark.parametrize(
    ("controller", "cause"),
    [("bug2", "unknown_word"), (2, "wrong_type"), ("clik-3", "unsupported_controller")],
)
def test_a_target_names_a_method_that_there_is_for_this_robot(refused, controller, cause):
    assert refused("target", changed("target", controller=controller)).cause == cause


@pytest.mark.parametrize(
    ("source", "fields"),
    [
        ("joints", {"name": [f"{index:x}" for index in range(7_500)] + ["1"]}),
        ("joints", {"position": [0] * 20_000}),
        ("joints", {"velocity": [0.123456789] * 5_000}),
        ("ranges", {"ranges": [None] * 10_000}),
        (
            "obstacles",
            {"obstacles": [{"id": "a", "shape": "box", "size": [0] * 21_000, "position": [0, 0, 0]}]},
        ),
        ("target", {"value": [0] * 20_000}),
    ],
)
def test_refusing_a_long_list_costs_the_loop_nothing(refused, source, fields):
    """Looked at name by name, one message held the loop up for 0.6 s; 20 ms is for a slow machine."""
    payload = json.dumps(changed(source, **fields)).encode()
    assert len(payload) <= MAX_PAYLOAD
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        assert refused(source, payload).cause == "wrong_length"
        times.append(time.perf_counter() - begin)
    assert min(times) < 0.020


def test_other_encodings_of_text_are_refused_and_harmless_space_is_not(accept, refused):
    assert refused("joints", FIRST.decode().encode("utf-16")).cause == "not_json"
    assert refused("joints", FIRST + b"x").cause == "not_json"
    assert refused("joints", FIRST + FIRST).cause == "not_json"
    accept("joints", b" \n" + FIRST + b"\r\n\t ")

"""Nothing that arrives raises anything but ``InputError``, and nothing that passes is other than finite."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_samples import VALID

from ssm_service.errors import InputError

quick = settings(derandomize=True, database=None, deadline=None, max_examples=250)

numbers = st.floats() | st.integers() | st.integers(-(10**40), 10**40)
scalars = st.none() | st.booleans() | numbers | st.text(max_size=20)
trees = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(st.text(max_size=10), inner, max_size=5),
    max_leaves=20,
)
sources = st.sampled_from(sorted(VALID))


def finite(value: Any, source: str) -> bool:
    """Tell whether every number in a value is finite; in ranges infinity is 'no echo'."""
    if isinstance(value, np.ndarray):
        return bool(np.all(np.isfinite(value) | (np.isposinf(value) & (source == "ranges"))))
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, msgspec.Struct):
        return all(finite(getattr(value, name), source) for name in value.__struct_fields__)
    if dataclasses.is_dataclass(value):
        return all(finite(getattr(value, field.name), source) for field in dataclasses.fields(value))
    if isinstance(value, list | tuple):
        return all(finite(inner, source) for inner in value)
    return True


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path to every place in a JSON value."""
    inner: list[tuple[Any, ...]] = [path]
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in items:
        inner += places(child, (*path, key))
    return inner


def check(accept: Any, source: str, payload: bytes) -> bool:
    """Send one payload through the door; tell whether it passed."""
    try:
        value = accept(source, payload)
    except InputError as error:
        refusal = error
    else:
        assert finite(value, source)
        return True
    assert refusal.cause.isidentifier()
    assert len(str(refusal)) < 500
    return False


@quick
@given(source=sources, payload=st.binary(max_size=300))
def test_arbitrary_bytes(accept, source, payload):
    assert not check(accept, source, payload)


@quick
@given(source=sources, value=trees)
def test_arbitrary_json(accept, source, value):
    assert not check(accept, source, json.dumps(value).encode())


@quick
@given(data=st.data())
def test_a_valid_message_with_any_place_replaced(accept, data):
    source = data.draw(sources)
    message = json.loads(json.dumps(VALID[source]))
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(places(message)[1:] or [()]))
        if not path:
            break
        parent = message
        for key in path[:-1]:
            parent = parent[key]
        action = data.draw(st.sampled_from(["replace", "replace", "remove", "repeat"]))
        if action == "remove":
            del parent[path[-1]]
        elif action == "repeat" and isinstance(parent, list):
            parent.append(parent[path[-1]])
        else:
            parent[path[-1]] = data.draw(trees)
    check(accept, source, json.dumps(message).encode())


@quick
@given(data=st.data())
def test_a_valid_message_with_any_bytes_changed(accept, data):
    source = data.draw(sources)
    payload = bytearray(json.dumps(VALID[source]).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        index = data.draw(st.integers(0, len(payload) - 1))
        action = data.draw(st.sampled_from(["set", "insert", "delete", "cut"]))
        if action == "set":
            payload[index] = data.draw(st.integers(0, 255))
        elif action == "insert":
            payload[index:index] = data.draw(
                st.sampled_from([b"-", b"e99", b"9" * 30, b"null", b"\\u0000", b"["])
            )
        elif action == "delete" and len(payload) > 1:
            del payload[index]
        else:
            del payload[index + 1 :]
    check(accept, source, bytes(payload))


@pytest.mark.parametrize("source", sorted(VALID))
def test_every_number_of_a_valid_message_may_be_any_float(accept, source):
    """Each number in turn becomes each hard float: it is refused, or the value is finite."""
    hard = ["1e308", "-1e308", "1e-320", "-0.0", "5e-324", "1e309", "-1e400", "1.7976931348623157e308", "NaN"]
    passed = 0
    for path in places(VALID[source])[1:]:
        message = json.loads(json.dumps(VALID[source]))
        parent = message
        for key in path[:-1]:
            parent = parent[key]
        if isinstance(parent[path[-1]], int | float):
            parent[path[-1]] = "HERE"
            text = json.dumps(message)
            passed += sum(check(accept, source, text.replace('"HERE"', number).encode()) for number in hard)
    assert passed > 0

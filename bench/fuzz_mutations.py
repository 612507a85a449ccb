"""Changes to valid inputs that keep most of their structure, for JSON and for TOML, and changes to bytes."""

from __future__ import annotations

import json
from collections.abc import Callable
from random import Random
from typing import Any

HARD = (
    "null",
    "true",
    "false",
    "0",
    "-0.0",
    "-1",
    "1e-320",
    "5e-324",
    "1e308",
    "-1e308",
    "1e309",
    "1.7976931348623157e308",
    "NaN",
    "Infinity",
    "-Infinity",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551616",
    "1e400",
    '""',
    '"\\u0000"',
    '"\\ud800"',
    "[]",
    "{}",
    "[[]]",
    "[null]",
    '{"":{}}',
    '"stop"',
    '"green"',
    "0.1",
    "3.2",
    "7",
    "-2",
)
"""Values as they stand in JSON; some are no JSON at all."""

HARD_TOML = (
    "nan",
    "inf",
    "-inf",
    "0",
    "-1",
    "1e308",
    "1e400",
    "0.1",
    "true",
    "false",
    "[]",
    "{}",
    "''",
    '"\\u0000"',
    "[[]]",
    "[1]",
    "{a=1}",
    "1979-05-27",
    "07:32:00",
    "9223372036854775807",
    "99999999999999999999",
    "0x10",
    "1_000",
    '"stop"',
    '"""x"""',
    "[1.0,2.0,3.0]",
    "3",
    "25",
)

PIECES = (
    b"\x00",
    b"\xff",
    b"\xed\xa0\x80",
    b"\xef\xbb\xbf",
    b"[" * 2000,
    b'{"a":' * 300,
    b"9" * 400,
    b"e999",
    b"\n",
)
PIECES += (b",", b"null", b"\\u0000", b"-", b'"', b"}", b"]", b"=", b"crc32=", b";after=", b"/", b"\r", b" ")
PLACE = "\ue000"
"""Stands where a value is put in that the JSON encoder would not write."""

Mutator = Callable[[bytes, Random], bytes]


def mutate_json(data: bytes, random: Random) -> bytes:
    """Return JSON with some of its places changed; where it is none, with some of its bytes changed."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return mutate_bytes(data, random)
    if random.random() < 0.25:
        return mutate_bytes(data, random)
    values = []
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        document = _changed(document, random, values)
    text = json.dumps(document)
    for value in values:
        text = text.replace(json.dumps(PLACE), value, 1)
    return text.encode("utf-8", "surrogatepass")


def _changed(document: Any, random: Random, values: list[str]) -> Any:
    path = random.choice(_places(document))
    if not path:
        values.append(random.choice(HARD))
        return PLACE
    parent = document
    for key in path[:-1]:
        parent = parent[key]
    last, action = path[-1], random.randrange(6)
    if action == 0:
        del parent[last]
    elif action == 1 and isinstance(parent, list):
        parent.extend([parent[last]] * random.choice((1, 2, 200)))
    elif action == 1:
        parent[random.choice(("", "x", str(last).upper(), "producer", "name"))] = parent[last]
    elif action == 2 and isinstance(parent[last], int | float) and abs(parent[last]) < 1e300:
        parent[last] = parent[last] * random.choice((-1, 1e-3, 0.5, 1.01, 2, 1e3, 1e12)) + random.choice(
            (0, 1e-9)
        )
    elif action == 3:
        other = random.choice(_places(document))
        parent[last] = _at(document, other) if len(other) > len(path) else PLACE
        if parent[last] == PLACE:
            values.append(random.choice(HARD))
    else:
        parent[last] = PLACE
        values.append(random.choice(HARD))
    return document


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path]
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        if len(found) < 500:
            found += _places(inner, (*path, key))
    return found


def _at(value: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        value = value[key]
    return json.loads(json.dumps(value))


def mutate_toml(data: bytes, random: Random) -> bytes:
    """Return TOML, or any text of lines with ``=`` or ``:``, with some lines changed."""
    if random.random() < 0.2:
        return mutate_bytes(data, random)
    lines = data.split(b"\n")
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        place, action = random.randrange(len(lines)), random.randrange(5)
        sign = b"=" if b"=" in lines[place] else b":"
        key, found, value = lines[place].partition(sign)
        if action == 0 and len(lines) > 1:
            del lines[place]
        elif action == 1:
            lines.insert(random.randrange(len(lines) + 1), lines[place])
        elif action == 2 and found:
            key = random.choice(
                (key.strip()[:-1], key.strip() + b"s", b'""', b"a.b", random.choice(lines)[:20])
            )
            lines[place] = key + sign + value
        elif found:
            new = random.choice(HARD_TOML if sign == b"=" else HARD).encode()
            if b"," in value and random.random() < 0.5:
                parts = value.split(b",")
                parts[random.randrange(len(parts))] = new
                new = b",".join(parts)
            lines[place] = key + sign + b" " + new + b"," * (sign == b":")
        else:
            lines[place] = mutate_bytes(lines[place], random)
    return b"\n".join(lines)


def mutate_bytes(data: bytes, random: Random) -> bytes:
    """Return bytes with some of them changed, put in or taken out."""
    changed = bytearray(data)
    for _ in range(random.randint(1, 4)):
        place, action = random.randint(0, len(changed)), random.randrange(6)
        if action == 0 and place < len(changed):
            changed[place] = random.randrange(256)
        elif action == 1 and place < len(changed):
            changed[place] ^= 1 << random.randrange(8)
        elif action == 2:
            changed[place:place] = random.choice(PIECES)
        elif action == 3:
            del changed[place : place + random.randint(1, 8)]
        elif action == 4:
            end = random.randint(place, min(len(changed), place + 40))
            changed[place:place] = changed[place:end]
        else:
            del changed[place + random.randint(0, 40) :]
    return bytes(changed)

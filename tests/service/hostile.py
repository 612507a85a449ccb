"""Messages that nobody should send: malformed, out of place, or meant to make a zone milder."""

from __future__ import annotations

import json
import random
from typing import Any

from service_kit import FAR, HEALTHY, JOINT_FIELDS, crc

STRANGER = {"producer": "stranger", "seq": 10**9, "stamp_ns": 0}

MALFORMED = [
    b"",
    b"x",
    b"\xff\xfe\x00",
    b"null",
    b"[]",
    b"{}",
    b"[" * 60_000,
    b'{"a":' * 10_000,
    b'{"producer":' + b'[{"a":' * 9_000,
    b"9" * 60_000,
    b"\x00" * 65_536,
    b"x" * 65_537,
]


def hostile(source: str, count: int, seed: int) -> list[tuple[bytes, bytes | None]]:
    """Return messages, with attachments, each of which must be refused while the good driver is there."""
    choose = random.Random(seed)
    good = {**STRANGER, **HEALTHY[source][1]}
    fields = [key for key in good if key not in STRANGER]
    text = json.dumps(good)
    milder: dict[str, dict[str, Any]] = {
        "joints": JOINT_FIELDS,
        "ranges": {"ranges": [None] * 8},
        "obstacles": choose.choice([{"obstacles": []}, {"obstacles": [FAR]}]),
        "target": HEALTHY["target"][1],
    }
    kinds = [
        lambda: choose.choice(MALFORMED),
        lambda: text[: choose.randrange(len(text) - 1)].encode(),
        lambda: json.dumps({**good, choose.choice(fields): choose.choice([None, 1, "x", {}, True])}).encode(),
        lambda: json.dumps({**good, "extra": 1}).encode(),
        lambda: json.dumps(
            {key: good[key] for key in good if key != choose.choice(fields)} | {"x": 0}
        ).encode(),
        lambda: json.dumps({**good, "seq": choose.choice([-1, 2**63, 10**40, 1.5, "1", None])}).encode(),
        lambda: text.replace("0.0", choose.choice(["NaN", "1e999", "-Infinity"])).encode() + b"}",
        lambda: bytes(choose.randrange(256) for _ in range(choose.randrange(200))),
        # Well made, from a second producer, and it would make the zone milder.
        lambda: json.dumps({**STRANGER, **milder[source]}).encode(),
        lambda: json.dumps({**STRANGER, "producer": choose.randbytes(8).hex(), **milder[source]}).encode(),
    ]

    def attachment(payload: bytes) -> bytes | None:
        right = crc(f"ssm/ur3/in/{source}", payload)
        wrong = [
            None,
            b"",
            b"\xff" * choose.randrange(2000),
            right[:-1],
            right + b";after=x",
            b"crc32=%08x" % choose.randrange(2**32),
            right + b";after=nobody/1",
        ]
        return right if choose.random() < 0.6 else choose.choice(wrong)

    return [(payload, attachment(payload)) for payload in (choose.choice(kinds)() for _ in range(count))]

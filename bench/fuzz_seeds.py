"""Valid inputs of every door that is fuzzed."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from ssm_service.wire import messages as m
from ssm_service.wire import seal
from ssm_service.wire.integrity import Heard

JOINTS = [
    f"{joint}_joint" for joint in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
]
POSITION = [0.4, -1.1, 1.0, 0.0, 0.0, 0.0]
HEAD = {"producer": "driver", "seq": 7, "stamp_ns": 1_700_000_000_000_000_000}
BALL = {
    "id": "ball",
    "shape": "sphere",
    "size": [0.05],
    "position": [0.5, 0.1, 0.3],
    "velocity": [0.1, 0.0, 0.0],
}
ARM = {
    "id": "arm",
    "shape": "capsule",
    "size": [0.05, 0.4],
    "position": [0.4, 0.5, 0.3],
    "quaternion_xyzw": [0.5, 0.5, 0.5, 0.5],
}
BOX = {"id": "table", "shape": "box", "size": [1.0, 1.0, 0.1], "position": [0.0, 0.0, -0.2]}
POST = {"id": "post", "shape": "cylinder", "size": [0.1, 1.0], "position": [1.0, 0.0, 0.5]}
RANGES = [0.5, None, 1.2, 0.0, None, 0.25, None, 1]

EVALUATE = [
    json.dumps(line).encode()
    for line in (
        {"position": POSITION, "obstacles": [BALL, ARM, BOX, POST], "velocity": [0.1, 0, -0.5, 0, 0, 0]},
        {"position": POSITION, "name": JOINTS, "ranges": [0.3, 0.4, *[None] * 6]},
        {
            "position": POSITION,
            "ranges": [None] * 8,
            "obstacles": [],
            "target": {"kind": "position", "value": [0.3, 0.1, 0.4]},
        },
        {
            "position": POSITION,
            "obstacles": [BALL],
            "target": {"kind": "twist", "value": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]},
        },
    )
]
_ATTACHED = (b"", b"{}", b"payload\nwith lines")
ATTACHED = [
    seal("ssm/ur3/in/joints", "driver", 7, payload, heard) + b"\n" + payload
    for payload in _ATTACHED
    for heard in (None, Heard("0123abcd", 42))
]
LATCH = [
    b"{}",
    b'{"latched":"corruption","fault":"corruption","where":"in/joints","at_ns":1700000000000000000}',
]
DOCKER = [
    path.read_bytes() for path in sorted((Path(__file__).resolve().parents[1] / "docker").glob("**/*.json5"))
]


@cache
def samples() -> dict[str, list[bytes]]:
    """Return valid messages of every kind, by ``message/KIND``: the least one and the fullest."""
    known: dict[str, list[dict[str, Any]]] = {
        "JointState": [{**HEAD, "name": JOINTS, "position": POSITION, "velocity": [0.0, 0.1, -0.2, 0, 0, 0]}],
        "Ranges": [{**HEAD, "ranges": RANGES}],
        "Obstacles": [{**HEAD, "obstacles": [BALL, ARM, BOX, POST]}, {**HEAD, "obstacles": []}],
        "Target": [
            {**HEAD, "kind": "position", "value": [0.3, 0.1, 0.4]},
            {**HEAD, "kind": "joint_velocity", "value": [0.1] * 6},
        ],
        "EvaluateInput": [json.loads(line) for line in EVALUATE],
        "FramesRequest": [{"position": POSITION}, {"position": POSITION, "name": JOINTS}],
        "EvaluateError": [{"error": "no"}],
    }
    found = {}
    for kind in m.ALL:
        made = known.get(kind.__name__) or [
            _made(msgspec.inspect.type_info(kind), full) for full in (False, True)
        ]
        found[f"message/{kind.__name__}"] = [json.dumps(each).encode() for each in made]
    return found


def zones() -> list[bytes]:
    """Return valid zones of a service, whose joints have names of their own."""
    made = [json.loads(each) for each in samples()["message/Zone"]]
    return [json.dumps({**each, "name": JOINTS, "speed_limit": [0.5] * 6}).encode() for each in made]


def answers() -> list[bytes]:
    """Return valid answers to ``evaluate``."""
    return [
        b"[" + each + b"]" for name in ("Output", "Error") for each in samples()[f"message/Evaluate{name}"]
    ]


def _made(info: Any, full: bool) -> Any:
    """Return a plain value of a type: the least one, or the fullest."""
    i = msgspec.inspect
    match info:
        case i.StructType():
            fields = [field for field in info.fields if full or field.required]
            return {field.encode_name: _made(field.type, full) for field in fields}
        case i.UnionType():
            kinds = [kind for kind in info.types if not isinstance(kind, i.NoneType)]
            return _made(kinds[0], full) if full or len(kinds) == len(info.types) else None
        case i.LiteralType():
            return info.values[0]
        case i.ListType():
            return [_made(info.item_type, full)] * (2 if full else 0)
        case i.TupleType():
            return [_made(kind, full) for kind in info.item_types]
        case i.DictType():
            return {"S_p": _made(info.value_type, full)} if full else {}
        case i.IntType():
            return max(info.ge or 0, 3)
        case i.FloatType():
            return 0.5
        case i.BoolType():
            return True
        case i.Metadata():
            return _made(info.type, full)
    return "ur3"

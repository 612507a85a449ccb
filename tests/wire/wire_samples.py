"""Valid messages as plain JSON objects, made without our own types."""

from __future__ import annotations

import copy
from typing import Any

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)

HEAD = {"producer": "driver", "seq": 7, "stamp_ns": 1_700_000_000_000_000_000}

VALID: dict[str, dict[str, Any]] = {
    "joints": {
        **HEAD,
        "name": list(JOINTS),
        "position": [0.1, -1.0, 1.2, 0.0, 0.0, 0.0],
        "velocity": [0.0, 0.1, -0.2, 0.0, 0.0, 0.0],
    },
    "ranges": {**HEAD, "ranges": [0.5, None, 1.2, 0.0, None, 0.25, None, 1]},
    "obstacles": {
        **HEAD,
        "obstacles": [
            {"id": "ball", "shape": "sphere", "size": [0.1], "position": [0.4, 0.0, 0.3]},
            {
                "id": "arm",
                "shape": "capsule",
                "size": [0.05, 0.4],
                "position": [0.4, 0.5, 0.3],
                "quaternion_xyzw": [0.5, 0.5, 0.5, 0.5],
                "velocity": [0.0, -0.5, 0.0],
            },
            {"id": "post", "shape": "cylinder", "size": [0.1, 1.0], "position": [1.0, 0.0, 0.5]},
            {"id": "table", "shape": "box", "size": [1.0, 1.0, 0.1], "position": [0.0, 0.0, -0.2]},
        ],
    },
    "target": {**HEAD, "kind": "position", "value": [0.3, 0.1, 0.4]},
}


def changed(source: str, **fields: Any) -> dict[str, Any]:
    """Return the valid message of a source with some fields replaced."""
    return {**copy.deepcopy(VALID[source]), **fields}


def without(source: str, field: str) -> dict[str, Any]:
    """Return the valid message of a source without one field."""
    return {key: value for key, value in VALID[source].items() if key != field}


def obstacle(**fields: Any) -> dict[str, Any]:
    """Return an ``Obstacles`` message of one sphere with some of its fields replaced."""
    sphere = {"id": "ball", "shape": "sphere", "size": [0.1], "position": [0.4, 0.0, 0.3], **fields}
    return {**HEAD, "obstacles": [sphere]}

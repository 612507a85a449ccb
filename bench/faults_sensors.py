"""Faults of sensors and drivers for ``bench.faults``: what a driver says when what it measures is wrong.

Everything here is sent in due form, with the right checksum: no check of the network can find it.
"""

from __future__ import annotations

import json
import math
import random
import time
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ssm_service.model import Robot
from ssm_service.monitor import JointSample
from ssm_service.simulation.world import Emitted
from ssm_service.wire import messages as m

from .faults_chaos import say

HOUR_NS = 3_600_000_000_000
JUMP_RAD = 0.5
CREEP_RAD_S = 0.1

SPOILT = {
    "nan:joints": ("joints", "position", math.nan),
    "nan:ranges": ("ranges", "ranges", math.nan),
    "nan:obstacles": ("obstacles", "position", math.nan),
    "minus_one:ranges": ("ranges", "ranges", -1.0),
    "out_of_range:joints": ("joints", "position", 100.0),
    "out_of_range:ranges": ("ranges", "ranges", 50.0),
    "out_of_range:obstacles": ("obstacles", "size", -1.0),
}
"""Faults of one number: source, field, and what stands there."""

SOURCE = {
    "frozen:scan": "ranges",
    "frozen:sensor": "ranges",
    "stuck_far:scan": "ranges",
    "stuck_far:sensor": "ranges",
    "silence": "ranges",
    "dead:sensor": "ranges",
    "dead:ranges": "ranges",
    "dead:all": "joints",
    "stamp:future": "joints",
    "stamp:past": "joints",
    "order": "joints",
    "jump": "joints",
    "contradiction:frozen": "joints",
    "contradiction:moved": "joints",
    **{name: source for name, (source, _, _) in SPOILT.items()},
}
"""All faults, and the source by whose first message one begins."""


@dataclass
class _Fault:
    id: int
    name: str
    until_ns: int
    first_ns: int = 0
    hit: int = 0
    kept: dict[str, Any] = field(default_factory=dict)


class Sensors:
    """Spoils what a plant emits.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._fault: _Fault | None = None
        self._rng = random.Random(1)

    def begin(self, wish: dict[str, Any]) -> None:
        """Begin a fault."""
        until = time.monotonic_ns() + int(wish["for_ms"] * 1e6)
        self._fault = _Fault(wish["id"], wish["fault"], until)

    def sent(self) -> None:
        """Say when a fault is over."""
        fault = self._fault
        if fault is not None and fault.first_ns and time.monotonic_ns() > fault.until_ns:
            self._fault = None
            say(
                {
                    "done": fault.id,
                    "first_ns": fault.first_ns,
                    "last_ns": time.monotonic_ns(),
                    "hit": fault.hit,
                }
            )

    def emitted(self, emitted: Emitted) -> Emitted:
        """Return what is due, with the fault in its values."""
        fault = self._fault
        if fault is None:
            return emitted
        name = fault.name
        if name == "dead:all":
            self._count(fault)
            return Emitted()
        if emitted.ranges is not None and SOURCE[name] == "ranges" and name not in SPOILT:
            self._count(fault)
            return _with(emitted, ranges=self._ranges(fault, emitted.ranges))
        if emitted.joints is not None and name in ("jump", "contradiction:frozen", "contradiction:moved"):
            self._count(fault)
            return _with(emitted, joints=self._joints(fault, emitted.joints))
        return emitted

    def _ranges(self, fault: _Fault, ranges: NDArray[np.float64]) -> NDArray[np.float64] | None:
        seeing = int(np.argmin(ranges))
        seeing = fault.kept.setdefault("sensor", seeing)
        before = fault.kept.setdefault("ranges", ranges.copy())
        far = 0.99 * self._robot.rings[0].range_max
        spoilt = ranges.copy()
        if fault.name == "dead:ranges":
            return None
        if fault.name == "frozen:scan":
            spoilt = before.copy()
        elif fault.name == "frozen:sensor":
            spoilt[seeing] = before[seeing]
        elif fault.name == "stuck_far:scan":
            spoilt[:] = far
        elif fault.name == "stuck_far:sensor":
            spoilt[seeing] = far
        elif fault.name == "silence":
            spoilt[:] = math.inf
        else:
            spoilt[seeing] = math.inf
        return spoilt

    def _joints(self, fault: _Fault, joints: JointSample) -> JointSample:
        began = fault.kept.setdefault("joints", joints)
        if fault.name == "jump":
            position = joints.position.copy()
            position[0] += JUMP_RAD
            return JointSample(position=position, velocity=joints.velocity)
        if fault.name == "contradiction:frozen":
            return JointSample(position=began.position.copy(), velocity=np.zeros_like(began.velocity))
        # A joint that nobody commands creeps, as an encoder that slips or an arm that is pushed would say.
        position, velocity = joints.position.copy(), joints.velocity.copy()
        elapsed = (time.monotonic_ns() - fault.first_ns) * 1e-9
        position[1] += CREEP_RAD_S * elapsed
        velocity[1] += CREEP_RAD_S
        return JointSample(position=position, velocity=velocity)

    def payload(self, source: str, message: m.Message) -> tuple[tuple[str, int], bytes]:
        """Return producer and ``seq`` of a message, and its bytes with the fault in them."""
        head = (str(getattr(message, "producer", "")), int(getattr(message, "seq", 0)))
        fault = self._fault
        if fault is None or SOURCE[fault.name] != source:
            return head, msgspec.json.encode(message)
        fields = msgspec.to_builtins(message)
        if fault.name in SPOILT:
            _, key, value = SPOILT[fault.name]
            place = fields["obstacles"][0] if source == "obstacles" else fields
            if not place[key]:
                return head, msgspec.json.encode(message)
            place[key] = list(place[key])
            place[key][self._rng.randrange(len(place[key]))] = value
        elif fault.name in ("stamp:future", "stamp:past"):
            fields["stamp_ns"] += HOUR_NS if fault.name == "stamp:future" else -HOUR_NS
        elif fault.name == "order":
            order = self._rng.sample(range(len(fields["name"])), len(fields["name"]))
            for key in ("name", "position", "velocity"):
                fields[key] = [fields[key][index] for index in order]
        else:
            return head, msgspec.json.encode(message)
        self._count(fault)
        # Python's own encoder: it says NaN, as careless drivers do.
        return head, json.dumps(fields).encode()

    def _count(self, fault: _Fault) -> None:
        fault.first_ns = fault.first_ns or time.monotonic_ns()
        fault.hit += 1


def _with(emitted: Emitted, **changes: Any) -> Emitted:
    values = {name: getattr(emitted, name) for name in ("joints", "ranges", "obstacles", "target")}
    return Emitted(**values | changes)

"""Random sequences of ticks for both implementations of the decision, and what differs between them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ssm_service.model import Obstacle
from ssm_service.monitor import Decision, Inputs, JointSample, Received, Target

from .decision_scenes import Scenes, near_an_edge

SOURCES = ("joints", "ranges", "obstacles", "target")
EVERY = {"joints": 4, "ranges": 25, "obstacles": 12, "target": 15}
"""Ticks from one message to the next, about."""

TIMEOUTS = {"joints": 0.1, "ranges": 0.4, "obstacles": 0.25, "target": 0.5}
AGES = (math.nan, math.inf, -1e-9, -0.5)
"""Ages that prove nothing."""

EDGES = (0.0, 0.1775, 0.355, math.nextafter(0.1775, 1.0), math.nextafter(0.355, 0.0), 1.2)
"""Readings at and beside the edges of zones [m]."""


class Source:
    """What one input says, tick by tick: mostly fresh, at times anything but."""

    def __init__(self, name: str, rng: np.random.Generator) -> None:
        self.name, self.rng = name, rng
        self.value: Any = None
        self.age, self.left, self.trouble = 0.0, 0, ""
        self.due = 0

    def tick(self, period_s: float, renew: Any) -> dict[str, Any]:
        """Return what the source gives at this tick; ``renew`` makes a new value."""
        rng = self.rng
        self.age += period_s
        if self.left == 0:
            self.trouble = ""
            if rng.random() < 0.002:
                self.trouble = str(rng.choice(["silent", "invalid", "absent", "edge", "odd"]))
                self.left = int(rng.integers(1, 80 if self.trouble == "silent" else 6))
        else:
            self.left -= 1
        self.due -= 1
        if self.due <= 0 and self.trouble != "silent":
            self.due = int(rng.integers(1, 2 * EVERY[self.name]))
            self.value, self.age = renew(), float(rng.choice([0.0, 1e-3, 0.02]))
        age: float | None = self.age
        if self.trouble == "silent":
            age = self.age + 3.0 * TIMEOUTS[self.name] * (self.left % 3 == 0)
        elif self.trouble == "edge":
            timeout = TIMEOUTS[self.name]
            age = float(rng.choice([timeout, math.nextafter(timeout, 1.0), math.nextafter(timeout, 0.0)]))
        elif self.trouble == "odd":
            age = float(rng.choice(AGES))
        absent = self.trouble == "absent"
        return {
            "value": None if absent else self.value,
            "age_s": None if absent else age,
            "invalid": self.trouble == "invalid",
            "period_s": float(rng.choice([0.0, 0.0, 0.01, 0.3])) if rng.random() < 0.1 else 0.0,
        }


class Sequence:
    """One long run of random ticks for one robot and profile.

    Args:
        scenes: Postures and obstacles.
        seed: Of what is drawn.
        period_s: Time from tick to tick [s].
    """

    def __init__(self, scenes: Scenes, seed: list[int], period_s: float) -> None:
        self.scenes, self.period = scenes, period_s
        self.rng = np.random.default_rng(seed)
        self.sources = {name: Source(name, self.rng) for name in SOURCES}
        self.posture = self.placed = 0
        self.clear = 0
        self.held: dict[str, tuple[Any, Any]] = {}

    def absent(self) -> dict[str, Any]:
        """Return a tick at which nothing is known."""
        nothing = {"value": None, "age_s": None, "invalid": False, "period_s": 0.0}
        return {**dict.fromkeys(SOURCES, nothing), **self._beside(0.0)}

    def tick(self) -> dict[str, Any]:
        """Return the next tick, as the slow implementation takes it."""
        new = {"joints": self._joints, "ranges": self._ranges, "obstacles": self._obstacles}
        new["target"] = self._target
        found = {name: self.sources[name].tick(self.period, new[name]) for name in SOURCES}
        return {**found, **self._beside(1.0)}

    def _beside(self, chance: float) -> dict[str, Any]:
        rng, period = self.rng, self.period
        valid = max(0.02, 3.0 * period)
        late = (1e-6, 0.5 * valid, valid, math.nextafter(valid, 1.0), 10.0 * valid)
        few = rng.random(5) < chance * np.array([0.003, 0.001, 0.001, 0.05, 0.05])
        return {
            "overrun_s": float(rng.choice(late)) if few[0] else 0.0,
            "duplicate": bool(few[1]),
            "latched": bool(few[2]),
            "tick_s": float(rng.choice([1e-3, 0.01])) if few[3] else 0.0,
            "transport_s": float(rng.choice([0.01, 0.1])) if few[4] else 0.0,
        }

    def _joints(self) -> tuple[list[float], list[float]]:
        if self.rng.random() < 0.03:
            self.posture = int(self.rng.integers(len(self.scenes.positions)))
        return self.scenes.positions[self.posture], [0.0] * 6

    def _ranges(self) -> list[float]:
        rng = self.rng
        if rng.random() < 0.1:
            self.clear = int(rng.integers(0, 4))
        if self.clear:
            return [math.inf] * 8
        near = float(rng.choice([0.05, 0.4, 0.7, 1.0]))
        readings = np.where(rng.random(8) < 0.2, rng.uniform(near, 1.2, 8), math.inf).tolist()
        if rng.random() < 0.1:
            readings[int(rng.integers(8))] = float(rng.choice(EDGES))
        return [float(reading) for reading in readings]

    def _obstacles(self) -> list[dict[str, Any]]:
        if self.rng.random() < 0.3:
            self.placed = int(self.rng.integers(len(self.scenes.obstacles)))
        return list(self.scenes.obstacles[self.placed])

    def _target(self) -> list[float]:
        scale = float(self.rng.choice([0.0, 0.1, 1.0, 3.0]))
        return [*(self.rng.uniform(-scale, scale, 3)).tolist(), 0.5, 0.0, -0.5]

    def scene(self, tick: dict[str, Any]) -> dict[str, Any] | None:
        """Return what the geometry of a tick is; ``None`` without joints."""
        if tick["joints"]["value"] is None:
            return None
        posture = self.scenes.positions.index(tick["joints"]["value"][0])
        value = tick["obstacles"]["value"]
        placed = None if value is None else self.scenes.obstacles.index(value)
        return self.scenes.of(posture, placed)

    def real(self, tick: dict[str, Any]) -> Inputs:
        """Return a tick as the monitor takes it; the same value is the same object again."""
        received = {}
        for name in SOURCES:
            one = tick[name]
            value = None if one["value"] is None else self._kept(name, one["value"])
            received[name] = Received(
                value=value, age_s=one["age_s"], invalid=one["invalid"], period_s=one["period_s"]
            )
        rest = ("overrun_s", "duplicate", "latched", "tick_s", "transport_s")
        return Inputs(**received, **{name: tick[name] for name in rest})

    def _kept(self, name: str, value: Any) -> Any:
        before = self.held.get(name)
        if before is not None and before[0] is value:
            return before[1]
        made: Any
        if name == "joints":
            made = JointSample(position=np.array(value[0]), velocity=np.array(value[1]))
        elif name == "ranges":
            made = np.array(value)
        elif name == "obstacles":
            made = tuple(_obstacle(one) for one in value)
        else:
            made = Target(kind="joint_velocity", value=np.array(value))
        self.held[name] = (value, made)
        return made


def _obstacle(one: dict[str, Any]) -> Obstacle:
    fields = {name: tuple(one[name]) for name in ("size", "position", "quaternion_xyzw")}
    velocity = one["velocity"]
    return Obstacle(
        id=one["id"], shape=one["shape"], **fields, velocity=None if velocity is None else tuple(velocity)
    )


def differences(slow: dict[str, Any], real: Decision) -> list[str]:
    """Return in what two decisions of the same tick differ."""
    found = []
    states = {name: report.status.state.value for name, report in real.sources.items()}
    for what, one, other in (
        ("zone", slow["zone"], real.zone.word),
        ("momentary_zone", slow["momentary_zone"], real.momentary_zone.word),
        ("reasons", sorted(set(slow["reasons"])), sorted(set(real.reasons))),
        ("sources", slow["states"], states),
    ):
        if one != other:
            found.append(f"{what}: {one} here, {other} there")
    for what, one, other, tolerance in (
        ("distance", slow["distance"], real.distance, 2e-5),
        ("speed_scaling", slow["speed_scaling"], real.speed_scaling, 1e-3),
        ("speed_limit", slow["speed_limit"], real.speed_limit.tolist(), 3e-3),
        ("velocity", slow["velocity"], real.velocity.tolist(), 3e-3),
    ):
        if not _alike(what, one, other, tolerance):
            found.append(f"{what}: {one} here, {other} there")
    return found


def _alike(what: str, one: Any, other: Any, tolerance: float) -> bool:
    if one is None or other is None:
        return one is other
    if what == "distance" and one <= 0.0:  # how deep something is inside a link is a matter of definition
        return bool(other <= 0.0)
    return bool(np.allclose(one, other, rtol=0.0, atol=tolerance))


__all__ = ["Sequence", "differences", "near_an_edge"]

"""Wire faults for ``bench.faults``: each of them, on each message, once, in a burst and for a while."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from .faults_bounds import Bounds
from .faults_chaos import ADDED, FAULTS, REPLY
from .faults_judge import (
    Before,
    before,
    consumer_rejections,
    events,
    first_stop,
    milliseconds,
    moving_at,
    reasons_of,
    rejections,
    result,
    robot_rejections,
    wrong,
)
from .faults_rig import Rig

INWARD = ("joints", "ranges", "obstacles", "target")
OUTWARD = ("zone", "command")
LANES = (*INWARD, *OUTWARD, REPLY)
PATTERNS = ("single", "burst", "sustained")
BURST = 5
MARGIN_S = 0.25
"""How much longer than the bound is waited for a stop, so that a late one is seen and counted as late [s]."""

RECOVERY_S = 20.0
"""How long is waited for the recovery; on a quiet machine it takes some tens of milliseconds [s]."""

REPLACING = ("corruption", "loss", "delay")
"""Faults that take good messages away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One injection.

    Attributes:
        fault: What.
        lane: On which message.
        pattern: How often.
    """

    fault: str
    lane: str
    pattern: str

    @property
    def cell(self) -> str:
        """Lane and pattern."""
        return f"{self.lane} {self.pattern}"


def shots(each: int, seed: int) -> Iterator[Shot]:
    """Yield at least ``each`` injections of every fault, spread over lanes and patterns.

    Every other one is single; an answer to a query is only ever asked for after a stop, so that its faults
    are sustained.
    """
    rng = random.Random(seed)
    cells = [(lane, pattern) for lane in (*INWARD, *OUTWARD) for pattern in PATTERNS] + [(REPLY, "sustained")]
    for number in range(each):
        for fault in FAULTS:
            if number < len(cells):
                lane, pattern = cells[number]
            elif rng.random() < 0.7:
                lane, pattern = rng.choice((*INWARD, *OUTWARD)), "single"
            else:
                lane, pattern = rng.choice(cells)
            yield Shot(fault=fault, lane=lane, pattern=pattern)


def inject(rig: Rig, bounds: Bounds, shot: Shot, rng: random.Random) -> dict[str, Any]:
    """Inject once and say what came of it."""
    begun = time.monotonic()
    start = before(rig)
    time.sleep(rng.uniform(0.0, 0.02))
    if shot.lane == REPLY:
        return _inject_reply(rig, bounds, shot, start, begun)
    delay_ms = _delay_ms(bounds, shot)
    count, for_ms = {
        "single": (1, 2000),
        "burst": (BURST, 2000),
        "sustained": (10**6, _while_ms(bounds, shot)),
    }[shot.pattern]
    number = rig.inject(
        "chaos", lane=shot.lane, fault=shot.fault, count=count, for_ms=for_ms, delay_ms=delay_ms
    )
    done = rig.done("chaos", number, 5.0)
    if done is None or not done["hit"] or not moving_at(rig, start, done["first_ns"]):
        return result("wire", shot.fault, shot.cell, begun=begun, void=True)
    due, bound = _due(bounds, shot)
    wait = (
        max((done["first_ns"] - time.monotonic_ns()) * 1e-9 + bound * 1e-3 + MARGIN_S, 0.0) if due else 0.02
    )
    if shot.fault == "delay":
        wait = max(wait, delay_ms * 1e-3)
    stop = first_stop(rig, start, done["first_ns"], wait, target=shot.lane == "target")
    noticed, by = _noticed(rig, start, shot, done)
    found = events(rig, start)
    if not noticed and shot.lane in OUTWARD and any(event["own"] for event in found):
        # The consumer was held up meanwhile: what waited then was dropped unread, good and bad.
        return result("wire", shot.fault, shot.cell, begun=begun, void=True)
    took = milliseconds(stop, done["first_ns"])
    return result(
        "wire",
        shot.fault,
        shot.cell,
        begun=begun,
        messages=done["hit"],
        noticed=noticed,
        by=by,
        reasons=reasons_of(found, done["first_ns"]),
        stop_due=due,
        stop_ms=took,
        bound_ms=bound if due else None,
        late=bool(due and (took is None or took > bound)),
        wrong=_wrong(rig, start),
        recovered=rig.calm(RECOVERY_S),
    )


def _wrong(rig: Rig, start: Before) -> list[str]:
    return wrong(events(rig, start), rig.processes["plant"].since(start.plant))


def _while_ms(bounds: Bounds, shot: Shot) -> float:
    """Return how long a sustained fault lasts [ms]: long enough for the stop that is due."""
    return _due(bounds, shot)[1] + 40.0


def _delay_ms(bounds: Bounds, shot: Shot) -> float:
    """Return by how much messages are delayed [ms]: beyond what anybody may act on."""
    if shot.lane in OUTWARD:
        return 1e3 * bounds.valid_for_s + 40.0
    return 1e3 * bounds.timeout_s[shot.lane] + 60.0


def _due(bounds: Bounds, shot: Shot) -> tuple[bool, float]:
    """Return whether the consumer must stop, and its bound [ms].

    A single message less, or a bad one between good ones, leaves good ones that are fresh: it must be
    noticed and must not be believed, but nobody has to stop for it. Without an ``after`` that tells, a delay
    looks like a loss until the first delayed message comes; with it, also beyond.
    """
    if shot.lane in OUTWARD:
        return shot.pattern == "sustained" and shot.fault in REPLACING, bounds.watchdog_ms()
    if shot.fault == "corruption":
        return shot.pattern != "single", bounds.refused_ms()
    return shot.pattern == "sustained" and shot.fault in REPLACING, bounds.stale_ms(shot.lane)


def _noticed(rig: Rig, start: Before, shot: Shot, done: dict[str, Any]) -> tuple[int, dict[str, int]]:
    """Return how many of the faulty messages were counted, and as what.

    The counters follow with the next good message or the next tick, so they are asked a few times.
    """
    causes: dict[str, int] = {}
    for _ in range(15):
        causes = _counted(rig, start, shot)
        if sum(causes.values()) >= done["hit"]:
            break
        time.sleep(0.02)
    noticed = min(sum(causes.values()), done["hit"])
    if shot.lane in OUTWARD and noticed:
        return done["hit"], causes  # after a pause of its own, a consumer drops what waits without reading it
    if noticed < done["hit"] and shot.fault in ("loss", "delay"):
        words = reasons_of(events(rig, start), done["first_ns"])
        said = [word for word in words if word.startswith(("stale:", "unproved"))]
        if said:
            return done["hit"], {said[0]: 1}
    return noticed, causes


def _counted(rig: Rig, start: Before, shot: Shot) -> dict[str, int]:
    if shot.lane in OUTWARD:
        causes = consumer_rejections(rig, start)
        missed = int(rig.last("watch").get("lost", 0)) - start.lost
        return causes | ({"lost": missed} if missed > 0 else {})
    health = rig.health()
    causes = rejections(start.health, health, shot.lane)
    if health is not None and start.health is not None:
        missed = health.lost[shot.lane] - start.health.lost[shot.lane]
        if missed > 0 and shot.fault in ("loss", "delay"):
            causes["lost"] = missed
    return causes


def _inject_reply(rig: Rig, bounds: Bounds, shot: Shot, start: Before, begun: float) -> dict[str, Any]:
    """Make the consumer ask anew by a silence, and spoil the answers for a while.

    Where no good answer can come, it must not go on before the fault is over.
    """
    silence_ms = 1e3 * bounds.valid_for_s + 60.0
    number = rig.inject(
        "chaos", lane=REPLY, fault=shot.fault, count=10**6, for_ms=silence_ms + 150.0, delay_ms=80.0
    )
    silent = rig.inject("chaos", lane="zone", fault="loss", count=10**6, for_ms=silence_ms)
    cut = rig.done("chaos", silent, 5.0)
    done = rig.done("chaos", number, 5.0)
    if done is None or cut is None or not done["hit"] or not moving_at(rig, start, cut["first_ns"]):
        return result("wire", shot.fault, shot.cell, begun=begun, void=True)
    due, bound = shot.fault in REPLACING, bounds.watchdog_ms()
    stop = first_stop(rig, start, cut["first_ns"], MARGIN_S)
    found = events(rig, start)
    early = [
        event
        for event in found
        if stop is not None and stop["t"] < event["t"] < done["last_ns"] and event["zone"] != "stop"
    ]
    causes = Counter(consumer_rejections(rig, start)) + Counter(robot_rejections(rig, start))
    took = milliseconds(stop, cut["first_ns"])
    words = reasons_of(found, done["first_ns"])
    noticed = done["hit"] if causes or "duplicate:service" in words else 0
    if shot.fault in ("loss", "delay"):
        noticed = 0 if early else done["hit"]
    return result(
        "wire",
        shot.fault,
        shot.cell,
        begun=begun,
        messages=done["hit"],
        noticed=noticed,
        by=dict(causes) or ({"duplicate:service": 1} if "duplicate:service" in words else {"stop held": 1}),
        reasons=words,
        stop_due=due,
        stop_ms=took,
        bound_ms=bound,
        late=took is None or took > bound,
        wrong=_wrong(rig, start) + (["went on without a proof"] if due and early else []),
        recovered=rig.calm(RECOVERY_S),
    )


__all__ = ["ADDED", "LANES", "PATTERNS", "Shot", "inject", "shots"]

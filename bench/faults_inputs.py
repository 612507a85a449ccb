"""Sensor and driver faults for ``bench.faults``: in due form on the wire, and wrong all the same."""

from __future__ import annotations

import random
import time
from typing import Any, Final

from .faults_bounds import Bounds
from .faults_judge import (
    Before,
    before,
    events,
    first_event,
    milliseconds,
    moving_at,
    reasons_of,
    rejections,
    result,
    wrong,
)
from .faults_rig import Event, Rig
from .faults_sensors import SOURCE, SPOILT

RECOVERY_S = 20.0

LIES: Final = ("frozen:", "stuck_far:", "silence", "dead:sensor")
"""What is plausible of itself: believing it is all that a service with one sensor can do."""

HARMLESS: Final = ("stamp:future", "stamp:past", "order")
"""What must not matter: the zone stays as it is."""

EXPECTED: Final[dict[str, tuple[str, str]]] = {
    "frozen:scan": ("frozen:ranges", "frozen"),
    "frozen:sensor": ("frozen:ranges", "frozen"),
    "stuck_far:scan": ("disagree", "red"),
    "stuck_far:sensor": ("disagree", "red"),
    "silence": ("missing:ranges", "refused"),
    "dead:sensor": ("missing:ranges", "refused"),
    "dead:ranges": ("stale:ranges", "stale"),
    "dead:all": ("stale:joints", "stale"),
    "jump": ("implausible:joints", "refused"),
    "contradiction:frozen": ("implausible:joints", "implausible"),
    "contradiction:moved": ("implausible:joints", "implausible"),
    **{name: (f"invalid:{source}", "refused") for name, (source, _, _) in SPOILT.items()},
}
"""The word that names it, and the bound that holds."""

NAMES: Final = (*EXPECTED, *HARMLESS)


def inject(rig: Rig, bounds: Bounds, name: str, rng: random.Random) -> dict[str, Any]:
    """Inject once and say what came of it."""
    begun = time.monotonic()
    start = before(rig)
    time.sleep(rng.uniform(0.0, 0.02))
    word, kind = EXPECTED.get(name, ("", ""))
    bound = _bound(bounds, name, kind)
    number = rig.inject("plant", fault=name, for_ms=max(bound or 0.0, 120.0) + 40.0)
    done = rig.done("plant", number, 10.0)
    if done is None or not done["hit"] or not moving_at(rig, start, done["first_ns"]):
        return result("input", name, SOURCE[name], begun=begun, void=True)
    least = ("red", "stop") if kind in ("red", "frozen") else ("stop",)

    def severe(event: Event) -> bool:
        return event["zone"] in least and (not word or word in event["reasons"])

    stop = named = first_event(rig, start, done["first_ns"], 0.3, severe)
    if bound is not None and (milliseconds(named, done["first_ns"]) or bound) >= bound:
        # The word came late or not at all: a stop of another reason may have been there in time.
        stop = first_event(rig, start, done["first_ns"], 0.0, lambda event: event["zone"] in least)
    time.sleep(0.02)
    found = events(rig, start)
    causes = _counted(rig, start, name, done["hit"])
    took = milliseconds(stop, done["first_ns"])
    words = reasons_of(found, done["first_ns"])
    noticed = name in HARMLESS or named is not None
    if kind == "refused" and name in SPOILT:
        noticed = sum(causes.values()) >= done["hit"]
    return result(
        "input",
        name,
        SOURCE[name],
        begun=begun,
        messages=done["hit"],
        noticed=int(noticed),
        by=causes or {other: 1 for other in words if other not in ("distance", "recovering")},
        reasons=words,
        stop_due=bound is not None,
        stop_ms=took,
        bound_ms=bound,
        late=bound is not None and (took is None or took > bound),
        wrong=wrong(found, rig.processes["plant"].since(start.plant), allowed=_lies(name)),
        recovered=rig.calm(RECOVERY_S),
    )


def _counted(rig: Rig, start: Before, name: str, hit: int) -> dict[str, int]:
    """Return the refusals by cause; those of the last messages may still be on their way."""
    causes: dict[str, int] = {}
    for _ in range(10 if name in SPOILT else 1):
        causes = rejections(start.health, rig.health(), SOURCE[name])
        if sum(causes.values()) >= hit:
            break
        time.sleep(0.02)
    return causes


def _lies(name: str) -> Any:
    """Return what tells whether a belief in a clear scene is the fault itself."""
    if name.startswith(LIES):
        return lambda event: event["believed"] == ["ranges"]
    return None


def _bound(bounds: Bounds, name: str, kind: str) -> float | None:
    """Return the time that a fault may last [ms]; ``None`` where it must not matter."""
    if kind == "stale":
        return bounds.stale_ms(SOURCE[name])
    if kind in ("refused", "red"):
        return bounds.refused_ms()
    if kind == "frozen":
        return bounds.frozen_ms()
    if kind == "implausible":
        return bounds.implausible_ms()
    return None

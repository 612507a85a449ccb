"""The latch, for ``bench.faults``: a second error of integrity holds, over a kill -9, until a reset."""

from __future__ import annotations

import random
import resource
import signal
import time
from collections.abc import Callable
from typing import Any, Final

from ssm_service.errors import SsmError
from ssm_service.wire import messages as m

from .faults_bounds import Bounds
from .faults_judge import Before, before, events, first_event, milliseconds, reasons_of, result, wrong
from .faults_rig import Rig

HELD_S = 0.3
RESTART_S = 30.0

Injected = dict[str, Any]


def inject(rig: Rig, bounds: Bounds, name: str, rng: random.Random) -> Injected:
    """Inject once and say what came of it; afterwards the latch is acknowledged."""
    begun = time.monotonic()
    start = before(rig, RESTART_S)
    time.sleep(rng.uniform(0.0, 0.02))
    what = FAULTS[name](rig, bounds, start)
    found = events(rig, start)
    return result(
        "latch",
        name,
        "",
        begun=begun,
        messages=2,
        reasons=reasons_of(found, what.pop("from_ns")),
        wrong=wrong(found, rig.processes["plant"].since(start.plant)) + what.pop("also_wrong", []),
        stop_due=True,
        recovered=rig.calm(RESTART_S),
        **what,
    )


def _second_error(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Corrupt two messages and wait for the latch."""
    for _ in range(2):
        number = rig.inject("chaos", lane="joints", fault="corruption", count=1)
        done = rig.done("chaos", number, 5.0)
    from_ns = 0 if done is None else done["first_ns"]
    bound = bounds.refused_ms()
    stop = first_event(rig, start, from_ns, 0.5, lambda event: "latched" in event["reasons"])
    took = milliseconds(stop, from_ns)
    return {
        "from_ns": from_ns,
        "noticed": int(stop is not None),
        "by": {"latched": 1} if stop is not None else {},
        "stop_ms": took,
        "bound_ms": bound,
        "late": took is None or took > bound,
    }


def _held(rig: Rig, from_ns: int) -> list[str]:
    """Return what is wrong with a latch that should hold for a while."""
    time.sleep(HELD_S)
    moved = [
        event
        for event in rig.processes["watch"].since(0)
        if "zone" in event and event["t"] > from_ns and event["zone"] != "stop"
    ]
    said = rig.health()
    return ["went on while latched"] * bool(moved) + ["health does not say so"] * (
        said is None or said.latched is None
    )


def _reset(rig: Rig) -> list[str]:
    try:
        answer: m.ResetReply = rig.direct.reset()
    except SsmError as error:
        return [f"reset: {error}"]
    return [] if answer is not None else ["reset said nothing"]


def latched(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Two errors within the interval: a stop that holds until it is acknowledged."""
    what = _second_error(rig, bounds, start)
    wrongs = _held(rig, time.monotonic_ns())
    return what | {"also_wrong": wrongs + _reset(rig)}


def restarted(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """The same, and then a kill -9 of the service: the next one is latched as well."""
    rig.prepare("serve")
    what = _second_error(rig, bounds, start)
    time.sleep(0.2)
    killed_ns = rig.processes["serve"].signal(signal.SIGKILL)
    rig.start("serve")
    wrongs = _held(rig, killed_ns)
    return what | {"also_wrong": wrongs + _reset(rig)}


def full_disk(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """The same where nothing can be written: it holds all the same, and ``health`` says what is missing."""
    pid = rig.processes["serve"].pid
    limits = resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
    what = _second_error(rig, bounds, start)
    wrongs = _held(rig, time.monotonic_ns())
    health = rig.health()
    said = health is not None and any("would not outlive" in text for text in health.warnings)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, limits)
    what["by"] |= {"warning: would not outlive": 1} if said else {}
    wrongs += [] if said else ["nobody was told that it is not kept"]
    return what | {"also_wrong": wrongs + _reset(rig)}


FAULTS: Final[dict[str, Callable[[Rig, Bounds, Before], Injected]]] = {
    "latch": latched,
    "latch:full disk": full_disk,
    "latch:kill": restarted,
}

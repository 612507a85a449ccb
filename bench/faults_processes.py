"""Process faults for ``bench.faults``: standing still, dying, starving, a wrong clock, no memory, no disk."""

from __future__ import annotations

import os
import random
import resource
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from ssm_service.errors import SsmError

from .faults_bounds import Bounds
from .faults_judge import (
    Before,
    NotCalmError,
    before,
    events,
    first_event,
    first_stop,
    milliseconds,
    moving_at,
    reasons_of,
    result,
    wrong,
)
from .faults_rig import Rig

PAUSE_S = 0.2
STARVED_S = 0.25
CLOCK_S = 3600.0
RESTART_S = 30.0

Injected = dict[str, Any]


def inject(rig: Rig, bounds: Bounds, name: str, rng: random.Random) -> Injected:
    """Inject once and say what came of it."""
    begun = time.monotonic()
    start = before(rig, RESTART_S)
    time.sleep(rng.uniform(0.0, 0.02))
    what = FAULTS[name](rig, bounds, start)
    if name != "kill:watch" and not moving_at(rig, start, what["from_ns"]):
        rig.calm(RESTART_S)
        return result("process", name, "", begun=begun, void=True)
    # The plant's events are only comparable while it is the same process.
    plant = [] if name == "kill:plant" else rig.processes["plant"].since(start.plant)
    found = [] if name == "kill:watch" else events(rig, start)
    faults = wrong(found, plant) + what.pop("also_wrong", [])
    took, bound = what.get("stop_ms"), what.get("bound_ms")
    what.setdefault("reasons", reasons_of(found, what["from_ns"]))
    what.setdefault("late", bound is not None and (took is None or took > bound))
    return result(
        "process",
        name,
        "",
        begun=begun,
        messages=1,
        wrong=faults,
        recovered=rig.calm(RESTART_S),
        stop_due=bound is not None,
        **{key: value for key, value in what.items() if key != "from_ns"},
    )


def _stopped(rig: Rig, start: Before, from_ns: int, bound: float) -> Injected:
    stop = first_stop(rig, start, from_ns, bound * 1e-3 + 0.25)
    took = milliseconds(stop, from_ns)
    words = dict.fromkeys(stop["reasons"], 1) if stop is not None else {}
    return {
        "from_ns": from_ns,
        "noticed": int(stop is not None),
        "by": words,
        "stop_ms": took,
        "bound_ms": bound,
    }


def _pause(rig: Rig, start: Before, role: str, bound: float) -> Injected:
    process = rig.processes[role]
    from_ns = process.signal(signal.SIGSTOP)
    try:
        what = _stopped(rig, start, from_ns, bound)
        time.sleep(max(PAUSE_S - (time.monotonic_ns() - from_ns) * 1e-9, 0.0))
    finally:
        process.signal(signal.SIGCONT)
    return what


def pause_service(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """SIGSTOP the service: the consumer's watchdog stops; afterwards the service says 'overrun'."""
    return _pause(rig, start, "serve", bounds.watchdog_ms())


def pause_chaos(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """SIGSTOP what is between: the consumer's watchdog stops."""
    return _pause(rig, start, "chaos", bounds.watchdog_ms())


def pause_plant(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """SIGSTOP the drivers: the service says 'stale'."""
    return _pause(rig, start, "plant", bounds.stale_ms("joints"))


def pause_watch(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """SIGSTOP the consumer: the first thing that it holds when it runs again is a stop."""
    process = rig.processes["watch"]
    process.signal(signal.SIGSTOP)
    time.sleep(PAUSE_S)
    from_ns = process.signal(signal.SIGCONT)
    first = first_event(rig, start, from_ns, 2.0, lambda event: True)
    stopped = first is not None and first["zone"] == "stop"
    return {
        "from_ns": from_ns,
        "noticed": int(stopped),
        "by": {"first held: stop": 1} if stopped else {},
        "stop_ms": milliseconds(first, from_ns),
        "bound_ms": bounds.paused_ms(),
        "also_wrong": [] if stopped else ["went on after a pause"],
    }


def pause_evaluate(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """SIGSTOP the evaluating process: nobody answers ``evaluate``; zone and loop go on."""
    pid = _worker(rig)
    from_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGSTOP)
    try:
        answered = _evaluates(rig, 0.15)
        time.sleep(0.05)
        stops = _service_stops(rig, start, from_ns)
    finally:
        os.kill(pid, signal.SIGCONT)
    return {
        "from_ns": from_ns,
        "noticed": int(not answered),
        "by": {} if answered else {"no answer": 1},
        "also_wrong": ["the zone was touched"] if stops else [],
    }


def kill_evaluate(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Kill the evaluating process: it is started again; zone and loop go on."""
    pid = _worker(rig)
    from_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    deadline = time.monotonic() + RESTART_S
    again = False
    while time.monotonic() < deadline and not again:
        time.sleep(0.1)
        again = _worker_now(rig) not in (None, pid) and _evaluates(rig, 1.0)
    health = rig.health()
    said = health is not None and any("started again" in text for text in health.warnings)
    return {
        "from_ns": from_ns,
        "noticed": int(said and again),
        "by": {"warning: started again": 1} if said else {},
        "also_wrong": ["the zone was touched"] if _service_stops(rig, start, from_ns) else [],
    }


def _service_stops(rig: Rig, start: Before, from_ns: int) -> bool:
    """Tell whether the service ordered a stop that no hiccup of this machine explains."""
    hiccups = ("overrun", "recovering", "stale:", "invalid:", "implausible:")
    for event in events(rig, start):
        ordered = event["t"] >= from_ns and event["zone"] == "stop" and not event["own"]
        if ordered and not any(word.startswith(hiccups) for word in event["reasons"]):
            return True
    return False


def _kill(rig: Rig, start: Before, role: str, bound: float) -> Injected:
    rig.prepare(role)
    from_ns = rig.processes[role].signal(signal.SIGKILL)
    what = _stopped(rig, start, from_ns, bound)
    rig.start(role)
    rig.prepare(role)
    return what


def kill_service(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Kill -9 the service: the consumer's watchdog stops; a new one is taken up by everybody."""
    return _kill(rig, start, "serve", bounds.watchdog_ms())


def kill_chaos(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Kill -9 what is between, as a router: everybody finds back by themselves."""
    return _kill(rig, start, "chaos", bounds.watchdog_ms())


def kill_plant(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Kill -9 the drivers: the service says 'stale' and takes the new ones."""
    return _kill(rig, start, "plant", bounds.stale_ms("joints"))


def kill_watch(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Kill -9 the consumer: a new one begins with a stop; the robot's own goes on."""
    rig.prepare("watch")
    from_ns = rig.processes["watch"].signal(signal.SIGKILL)
    rig.start("watch")
    rig.prepare("watch")
    process = rig.processes["watch"]
    first = process.wait_for(lambda event: "zone" in event, 5.0)
    stopped = first is not None and first["zone"] == "stop"
    return {
        "from_ns": from_ns,
        "noticed": int(stopped),
        "by": {"first held: stop": 1} if stopped else {},
        "reasons": [] if first is None else first["reasons"],
        "also_wrong": [] if stopped else ["began with a leave to move"],
    }


def starve(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Take the processors away, at a higher priority than the service has."""
    rig.prepare_burning(len(os.sched_getaffinity(0)), STARVED_S)
    if not rig.calm(RESTART_S):
        raise NotCalmError("no motion before the processors were taken away")
    said = rig.burn()
    from_ns = min(event["begun_ns"] for event in said)
    starved_s = (max(event["ended_ns"] for event in said) - from_ns) * 1e-9
    bound = bounds.starved_ms(starved_s)
    stop = first_stop(rig, start, from_ns, bound * 1e-3)
    health = rig.health() or rig.health()
    more = 0 if health is None or start.health is None else health.overruns - start.health.overruns
    return {
        "from_ns": from_ns,
        "noticed": int(more > 0 or stop is not None),
        "by": {f"overruns ({said[0]['priority']})": 1} if more else {},
        "stop_ms": milliseconds(stop, from_ns),
        "bound_ms": bound,
        "late": stop is None or (milliseconds(stop, from_ns) or 0.0) > bound,
    }


def squeeze(rig: Rig, bounds: Bounds, start: Before) -> Injected:
    """Take the evaluating process's memory away while it is asked much: it refuses, or comes back."""
    pid = _worker(rig)
    size = int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * resource.getpagesize()
    before_limits = resource.prlimit(pid, resource.RLIMIT_AS, (size + 2**20, resource.RLIM_INFINITY))
    from_ns = time.monotonic_ns()
    ball = {"shape": "sphere", "size": [0.05], "position": [0.5, 0.0, 0.5]}
    much = {"position": [0.0] * 6, "obstacles": [{"id": str(i), **ball} for i in range(800)]}
    said = "answered"
    try:
        rig.direct.evaluate([much] * 4, timeout_s=3.0)
    except SsmError as error:
        said = f"refused: {error}"[:60]
    try:
        resource.prlimit(pid, resource.RLIMIT_AS, before_limits)
    except ProcessLookupError:
        said = "died and was started again"
    deadline = time.monotonic() + RESTART_S
    while time.monotonic() < deadline and not _evaluates(rig, 1.0):
        time.sleep(0.1)
    return {
        "from_ns": from_ns,
        "noticed": 1,
        "by": {said: 1},
        "also_wrong": ["the zone was touched"] if _service_stops(rig, start, from_ns) else [],
    }


def _clock(seconds: float) -> Callable[[Rig, Bounds, Before], Injected]:
    def shift(rig: Rig, bounds: Bounds, start: Before) -> Injected:
        """Shift the wall clock, and let the joints fall silent under the wrong one: ages must not mind."""
        from_ns = time.monotonic_ns()
        rig.shift_clock(seconds)
        try:
            time.sleep(0.1)
            touched = _service_stops(rig, start, from_ns)
            number = rig.inject("chaos", lane="joints", fault="loss", count=10**6, for_ms=250.0)
            done = rig.done("chaos", number, 5.0)
            silent_ns = from_ns if done is None else done["first_ns"]
            what = _stopped(rig, start, silent_ns, bounds.stale_ms("joints"))
        finally:
            rig.shift_clock(0.0)
        return what | {"also_wrong": ["the zone was touched"] if touched else []}

    return shift


def _worker(rig: Rig) -> int:
    """Return the process id of the service's evaluating process.

    Raises:
        NotCalmError: It has none.
    """
    pid = _worker_now(rig)
    if pid is None:
        raise NotCalmError("the service has no evaluating process")
    return pid


def _worker_now(rig: Rig) -> int | None:
    pid = rig.processes["serve"].pid
    for task in Path(f"/proc/{pid}/task").iterdir():
        children = (task / "children").read_text().split()
        if children:
            return int(children[0])
    return None


def _evaluates(rig: Rig, timeout_s: float) -> bool:
    try:
        return bool(rig.direct.evaluate([{"position": [0.0] * 6}], timeout_s=timeout_s))
    except SsmError:
        return False


FAULTS: Final[dict[str, Callable[[Rig, Bounds, Before], Injected]]] = {
    "pause:service": pause_service,
    "pause:evaluate": pause_evaluate,
    "pause:plant": pause_plant,
    "pause:watch": pause_watch,
    "pause:chaos": pause_chaos,
    "kill:service": kill_service,
    "kill:evaluate": kill_evaluate,
    "kill:plant": kill_plant,
    "kill:watch": kill_watch,
    "kill:chaos": kill_chaos,
    "clock:forward": _clock(CLOCK_S),
    "clock:back": _clock(-CLOCK_S),
    "memory:evaluate": squeeze,
    "starve": starve,
}

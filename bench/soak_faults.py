"""What ``bench.soak`` does to the processes: a seeded schedule of faults with times of rest between them."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import zenoh

from ssm_service.wire import Keys, encoding_of
from ssm_service.wire import messages as m

from .soak_rig import Log, Rig

WEIGHTS = {
    "stop simulation": 5,
    "stop consumer": 5,
    "stop service": 3,
    "stop evaluating": 2,
    "kill simulation": 1,
    "kill consumer": 1,
    "kill evaluating": 1,
    "garbage": 4,
    "duplicate producer": 4,
    "second service": 2,
    "flood of messages": 2,
    "flood of queries": 2,
}
"""How often each happens, relative to the others."""

MEAN_PAUSE_S = 6.0
"""Between the end of a fault and the next one."""

STOP_S = (0.01, 0.5)
LASTS_S = {"garbage": 1.0, "duplicate producer": 1.0, "second service": 0.3, "flood": 1.5}
REST_SHARE = 0.25
"""Share of each cycle in which nothing is done to anybody."""

CYCLE_S = 240.0
INPUTS = ("joints", "ranges", "obstacles", "target")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One entry of the schedule.

    Attributes:
        at_s: When, from the start [s].
        what: Its name.
        lasts_s: For how long [s]; 0 for what is over at once.
        seed: Of what is random in it.
    """

    at_s: float
    what: str
    lasts_s: float
    seed: int


def schedule(seed: int, seconds: float, *, kill_service: bool = False) -> Iterator[Fault]:
    """Yield the faults of a run in rising order: the same for the same seed and length."""
    random_ = random.Random(seed)
    weights = WEIGHTS | ({"kill service": 1} if kill_service else {})
    cycle = min(CYCLE_S, seconds / 2.0)
    now = min(10.0, 0.1 * seconds)
    while True:
        now += random_.expovariate(1.0 / MEAN_PAUSE_S) + 0.3
        if now % cycle > (1.0 - REST_SHARE) * cycle:
            now = (now // cycle + 1.0) * cycle
        what = random_.choices(list(weights), list(weights.values()))[0]
        kind = what.split()[0]
        lasts = 0.0 if kind == "kill" else LASTS_S.get(kind, LASTS_S.get(what, 0.0))
        if kind == "stop":
            lasts = random_.uniform(*STOP_S)
        if now + lasts > seconds:
            return
        yield Fault(at_s=now, what=what, lasts_s=lasts, seed=random_.getrandbits(32))
        now += lasts


class Injector:
    """Does one fault after the other.

    Args:
        rig: The processes.
        session: A session on the service, as a stranger has one.
        log: Gets begin and end of each.
    """

    def __init__(self, rig: Rig, session: zenoh.Session, log: Log) -> None:
        self._rig, self._session, self._log = rig, session, log
        self._keys = Keys(rig.robot)

    def do(self, fault: Fault) -> None:
        """Do it, and write down when."""
        begin = time.monotonic()
        kind, _, role = fault.what.partition(" ")
        done = True
        if kind == "stop":
            done = self._signalled(role, fault.lasts_s)
        elif kind == "kill":
            done = self._signalled(role, None)
            self._rig.revive()
        else:
            self._send(fault)
        end = time.monotonic()
        self._log.write("fault", begin, what=fault.what, ended=end - begin, done=done)

    def _signalled(self, role: str, stop_s: float | None) -> bool:
        pid = self._rig.pid(role)
        if pid is None:
            return False
        with contextlib.suppress(ProcessLookupError):
            if stop_s is None:
                os.kill(pid, signal.SIGKILL)
                if role != "evaluating":
                    _wait_until(lambda: self._rig.pid(role) is None)
                return True
            os.kill(pid, signal.SIGSTOP)
            try:
                time.sleep(stop_s)
            finally:
                os.kill(pid, signal.SIGCONT)
            return True
        return False

    def _send(self, fault: Fault) -> None:
        random_ = random.Random(fault.seed)
        end = time.monotonic() + fault.lasts_s
        send, pause_s = {
            "garbage": (self._garbage, 0.005),
            "duplicate producer": (self._duplicate, 0.004),
            "second service": (self._service, 0.002),
            "flood of messages": (self._flood, 0.001),
            "flood of queries": (self._query, 0.002),
        }[fault.what]
        count = 0
        while time.monotonic() < end:
            send(random_, count)
            count += 1
            time.sleep(pause_s)

    def _put(self, key: str, payload: bytes, encoding: str = "application/json") -> None:
        self._session.put(
            key, payload, encoding=encoding, congestion_control=zenoh.CongestionControl.DROP, express=True
        )

    def _garbage(self, random_: random.Random, _count: int) -> None:
        name = random_.choice(INPUTS)
        payload = bytearray(_message(name, "soak-garbage", random_.randrange(2**40)))
        if random_.random() < 0.5:
            payload = bytearray(random_.randbytes(random_.randrange(400)))
        for _ in range(random_.randrange(1, 5)):
            if payload:
                payload[random_.randrange(len(payload))] = random_.randrange(256)
        self._put(self._keys.input(name), bytes(payload))

    def _duplicate(self, random_: random.Random, count: int) -> None:
        name = random_.choice(INPUTS[:3])
        self._put(self._keys.input(name), _message(name, "soak-double", count))

    def _service(self, _random: random.Random, count: int) -> None:
        command = {
            **_head("soak-service", count),
            "valid_for_ns": 20_000_000,
            "robot": self._rig.robot,
            "zone": "green",
            "name": [],
            "velocity": [],
        }
        self._put(self._keys.output("command"), json.dumps(command).encode(), encoding_of(m.VelocityCommand))

    def _flood(self, random_: random.Random, count: int) -> None:
        for number in range(20):
            name = random_.choice(INPUTS)
            self._put(self._keys.input(name), _message(name, "soak-flood", 20 * count + number))

    def _query(self, random_: random.Random, _count: int) -> None:
        name = random_.choice(("zone", "health", "config", "frames"))
        self._session.get(self._keys.output(name), zenoh.handlers.FifoChannel(4), timeout=0.5)


def _wait_until(done: Callable[[], bool], timeout_s: float = 5.0) -> None:
    end = time.monotonic() + timeout_s
    while not done() and time.monotonic() < end:
        time.sleep(0.005)


def _head(producer: str, seq: int) -> dict[str, object]:
    return {"producer": producer, "seq": seq, "stamp_ns": time.time_ns()}


def _message(name: str, producer: str, seq: int) -> bytes:
    """Return a message that only its producer gives away: for a robot with the UR3's joints."""
    joints = [f"{joint}_joint" for joint in ("shoulder_pan", "shoulder_lift", "elbow")]
    joints += [f"wrist_{number}_joint" for number in (1, 2, 3)]
    content: dict[str, dict[str, object]] = {
        "joints": {"name": joints, "position": [0.1, -1.0, 1.0, 0.0, 0.0, 0.0], "velocity": [0.0] * 6},
        "ranges": {"ranges": [None] * 8},
        "obstacles": {"obstacles": []},
        "target": {"kind": "joint_velocity", "value": [9.0] * 6},
    }
    return json.dumps({**_head(producer, seq), **content[name]}).encode()

"""The processes of ``bench.latency``; each is told what to do in one line of JSON and answers with one."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import numpy as np
import zenoh

from ssm_service.model import Robot
from ssm_service.service import ServiceOptions, run_service
from ssm_service.wire import Keys, seal
from ssm_service.wire import messages as m
from ssm_service.wire.session import Mode, open_session, zenoh_config

ROBOT = "bench"
PRODUCER = "bench"
JOINTS_PERIOD_NS = 8_000_000
WARM_UP_NS = 500_000_000
OUT = {
    "express": True,
    "priority": zenoh.Priority.REAL_TIME,
    "congestion_control": zenoh.CongestionControl.DROP,
}


def value_of(index: int) -> float:
    """Return the reading [m] that says which scan it is from: no two are alike, none is in contact."""
    return 0.2 + 1e-6 * index


def index_of(value: float) -> int:
    """Return the number of the scan that a distance [m] is from."""
    return round((value - 0.2) * 1e6)


def serve(*, endpoint: str, rate_hz: float) -> None:
    """Run the service as ``ssm run`` does."""
    options = ServiceOptions(robot="ur3", name=ROBOT, rate_hz=rate_hz, listen=(endpoint,))
    run_service(options, _log)


def send(*, endpoint: str, messages: int, period_us: float, seed: int) -> dict[str, Any]:
    """Send joints at 125 Hz and scans at random times, each scan with a reading of its own.

    Scans are 2 to 6 periods of the service apart, so that nothing ties them to its ticks.

    Returns:
        When each scan was put [monotonic ns], and how long it was [bytes].
    """
    rng = np.random.default_rng(seed)
    robot = Robot.load("ur3")
    gaps = rng.uniform(2.0, 6.0, messages) * period_us * 1e3
    start = time.monotonic_ns() + WARM_UP_NS
    due = (start + np.cumsum(gaps)).astype(np.int64).tolist()
    others = [value_of(messages + 100_000)] * (robot.sensor_count - 1)
    scans = [_encode(m.Ranges, index, ranges=[value_of(index), *others]) for index in range(messages)]
    keys = Keys(ROBOT)
    seals = [seal(keys.input("ranges"), PRODUCER, index, payload) for index, payload in enumerate(scans)]
    sent: list[int] = []
    with open_session(zenoh_config("client", connect=[endpoint])) as session:
        joints, ranges = (session.declare_publisher(keys.input(name), **OUT) for name in ("joints", "ranges"))
        for sequence, joint_time in enumerate(range(start - WARM_UP_NS, due[-1], JOINTS_PERIOD_NS)):
            while len(sent) < messages and due[len(sent)] < joint_time:
                _sleep_until(due[len(sent)])
                payload = scans[len(sent)]
                sent.append(time.monotonic_ns())
                ranges.put(payload, attachment=seals[len(sent) - 1])
            _sleep_until(joint_time)
            state = _joints(robot, sequence)
            joints.put(state, attachment=seal(keys.input("joints"), PRODUCER, sequence, state))
        for payload in scans[len(sent) :]:
            sent.append(time.monotonic_ns())
            ranges.put(payload, attachment=seals[len(sent) - 1])
            time.sleep(2.0 * period_us * 1e-6)
    return {"sent_ns": sent, "bytes": len(scans[-1])}


def receive(*, endpoint: str) -> dict[str, Any]:
    """Note when each zone and command arrives, until stdin closes.

    Returns:
        For each zone that a scan speaks from: tick, scan, arrival [monotonic ns]; for each command: tick and
        arrival; and how long the messages are [bytes].
    """
    zones: list[tuple[int, bytes]] = []
    commands: list[tuple[int, bytes]] = []
    keys = Keys(ROBOT)
    with (
        open_session(zenoh_config("client", connect=[endpoint])) as session,
        _noting(session, keys.output("zone"), zones),
        _noting(session, keys.output("command"), commands),
    ):
        _ready()
        sys.stdin.read()
    zone, command = msgspec.json.Decoder(m.Zone), msgspec.json.Decoder(m.VelocityCommand)
    decoded = [(zone.decode(payload), arrived) for arrived, payload in zones]
    return {
        "zones": [
            (message.seq, index_of(message.distance), arrived)
            for message, arrived in decoded
            if message.distance is not None
        ],
        "commands": [(command.decode(payload).seq, arrived) for arrived, payload in commands],
        "zone_bytes": len(zones[-1][1]) if zones else 0,
        "command_bytes": len(commands[-1][1]) if commands else 0,
    }


def take(*, mode: Mode, endpoint: str, key: str) -> dict[str, Any]:
    """Note when each message of ``put`` arrives, until stdin closes.

    Returns:
        Number and arrival [monotonic ns] of each.
    """
    noted: list[tuple[int, bytes]] = []
    with _session(mode, endpoint) as session, _noting(session, key, noted):
        _ready()
        sys.stdin.read()
    return {"arrived": [(int(payload[:10]), arrived) for arrived, payload in noted]}


def put(*, mode: Mode, endpoint: str, key: str, size: int, messages: int, seed: int) -> dict[str, Any]:
    """Put messages of ``size`` bytes, 2 to 6 ms apart.

    Returns:
        When each was put [monotonic ns].
    """
    gaps = np.random.default_rng(seed).uniform(0.002, 0.006, messages).tolist()
    sent: list[int] = []
    with _session(mode, endpoint) as session:
        _ready()
        sys.stdin.readline()
        publisher = session.declare_publisher(key, **OUT)
        time.sleep(WARM_UP_NS * 1e-9)
        for index, gap in enumerate(gaps):
            time.sleep(gap)
            payload = b"%010d" % index + b"." * (size - 10)
            sent.append(time.monotonic_ns())
            publisher.put(payload)
        time.sleep(0.2)
    return {"sent_ns": sent}


ROLES = {role.__name__: role for role in (serve, send, receive, take, put)}


@contextmanager
def _noting(session: zenoh.Session, key: str, notes: list[tuple[int, bytes]]) -> Iterator[None]:
    """Append arrival [monotonic ns] and payload of every message on ``key``."""

    def note(sample: zenoh.Sample) -> None:
        arrived = time.monotonic_ns()
        notes.append((arrived, sample.payload.to_bytes()))

    with session.declare_subscriber(key, note):
        yield


def _session(mode: Mode, endpoint: str) -> zenoh.Session:
    where = {"connect": [endpoint]} if mode == "client" else {"listen": [endpoint]}
    return open_session(zenoh_config(mode, **where))


def _encode(kind: type[m.Message], seq: int, **fields: Any) -> bytes:
    return msgspec.json.encode(kind(producer=PRODUCER, seq=seq, stamp_ns=time.time_ns(), **fields))


def _joints(robot: Robot, seq: int) -> bytes:
    rest, still = robot.rest_position.tolist(), [0.0] * len(robot.joint_names)
    return _encode(m.JointState, seq, name=list(robot.joint_names), position=rest, velocity=still)


def _sleep_until(due_ns: int) -> None:
    remaining = due_ns - time.monotonic_ns()
    if remaining > 0:
        time.sleep(remaining * 1e-9)


def _ready() -> None:
    _log("ready")


def _log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    answer = ROLES[sys.argv[1]](**json.loads(sys.argv[2]))
    print(json.dumps(answer))

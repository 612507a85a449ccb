"""The consumer of ``bench.soak``: follows the service as a control loop does, and keeps accounts of its own.

Run as ``python -m bench.soak_consumer ENDPOINT ROBOT RATE``. It writes JSON lines: every gap, every overrun
that nobody reported, and twice a second its counters. It ends when its stdin does.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
from collections import deque
from typing import Any

import zenoh

from ssm_service.client import Connection, Follower
from ssm_service.errors import InputError
from ssm_service.service.realtime import COLLECT_NEEDS_NS, SpareTimeCollector, apply_realtime
from ssm_service.wire import Decoder, Keys
from ssm_service.wire import messages as m

CAPACITY = 16_384
"""Messages that wait for this process while it is held up: 32 s at 500 Hz."""

POLL_S = 0.001
SAY_EVERY_S = 0.5

LONG = 4.5
"""Periods between two publications that only an overrun explains: one tick may be a period late without being
one, and its work may take two before the next begins late."""

FIRST_TICK = 1
"""Decided while the service starts, before its loop runs."""

PAUSE_S = 2.0
"""How long a pause of this process's own may show in what it hears."""


class Account:
    """What came, by the messages alone.

    Who was held up for a moment finds messages gone that Zenoh dropped meanwhile: its longest pause lately is
    told with each gap.

    Args:
        period_ns: Of the service [ns].
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._last: m.Zone | None = None
        self._suspect: m.Zone | None = None
        self.zones: dict[str, int] = {}
        self.messages = self.overruns = self.long = self.refused = 0

    def take(self, zone: m.Zone) -> list[dict[str, Any]]:
        """Take the next message; return what is to be told: gaps, and overruns that nobody reported."""
        told: list[dict[str, Any]] = []
        last, self._last = self._last, zone
        self.messages += 1
        self.zones[zone.zone] = self.zones.get(zone.zone, 0) + 1
        reported = "overrun" in zone.reasons
        self.overruns += reported
        if last is None or last.producer != zone.producer or last.seq <= FIRST_TICK:
            self._suspect = None
            return told
        if self._suspect is not None and not reported:
            told.append({"kind": "unreported", "seq": self._suspect.seq})
        self._suspect = None
        if zone.seq != last.seq + 1:
            told.append({"kind": "gap", "after": last.seq, "next": zone.seq})
        elif zone.stamp_ns - last.stamp_ns > LONG * self._period_ns:
            self.long += 1
            # The tick itself says so, or, where its own work took so long, the next one.
            self._suspect = None if reported or "shutdown" in zone.reasons else zone
        return told


def main() -> None:
    """Follow until the end of stdin."""
    endpoint, robot, rate = sys.argv[1:]
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    apply_realtime()
    connection = Connection([endpoint])
    try:
        while connection.session is None and not ended.is_set():
            time.sleep(0.02)
        if connection.session is not None:
            _follow(connection.session, Keys(robot), round(1e9 / float(rate)), ended)
    finally:
        connection.close()
    os._exit(0)


def _follow(session: zenoh.Session, keys: Keys, period_ns: int, ended: threading.Event) -> None:
    ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(CAPACITY)
    subscriber = session.declare_subscriber(keys.output("zone"), ring)
    decoder: Decoder[m.Zone] = Decoder(m.Zone)
    account, follower = Account(period_ns), Follower(session, keys)
    collector = SpareTimeCollector()
    pauses: deque[tuple[float, float]] = deque([(time.monotonic(), 0.0)])
    before, said, stops, obeyed = time.monotonic(), 0.0, 0, 0
    while not ended.is_set():
        now = time.monotonic()
        pause, before = now - before, now
        while pauses and (pauses[0][0] < now - PAUSE_S or pauses[-1][1] <= pause):
            pauses.popleft() if pauses[0][0] < now - PAUSE_S else pauses.pop()
        pauses.append((now, pause))
        followed = follower.poll()
        stops += followed.stopped_by_consumer
        obeyed += not followed.stopped_by_consumer
        while (sample := subscriber.handler.try_recv()) is not None:
            try:
                zone = decoder.decode(sample.payload.to_bytes())
            except InputError:
                account.refused += 1
                continue
            for told in account.take(zone):
                _say(told | {"pause_s": pauses[0][1]})
        if now - said >= SAY_EVERY_S:
            _say(_counters(account, follower, pauses[0][1], stops, obeyed))
            said = now
        collector.work(time.monotonic_ns() + 2 * COLLECT_NEEDS_NS)
        time.sleep(POLL_S)


def _counters(
    account: Account, follower: Follower, pause_s: float, stops: int, obeyed: int
) -> dict[str, Any]:
    return {
        "kind": "consumer",
        "messages": account.messages,
        "overruns": account.overruns,
        "long": account.long,
        "refused": account.refused,
        "zones": account.zones,
        "lost": follower.watchdog.lost,
        "rejected": dict(follower.watchdog.rejected),
        "pause_s": pause_s,
        "stops": stops,
        "obeyed": obeyed,
    }


def _say(event: dict[str, Any]) -> None:
    with contextlib.suppress(BrokenPipeError):
        print(json.dumps({"t": time.monotonic(), **event}), flush=True)


if __name__ == "__main__":
    main()

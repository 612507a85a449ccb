"""What a consumer sends back, so that the service can measure the way to it."""

from __future__ import annotations

import time
import uuid

import msgspec
import zenoh

from ..wire import Heard, Keys, encoding_of, seal
from ..wire import messages as m

ECHO_NS = 100_000_000
"""Between two echoes [ns]."""


class Echoing:
    """Publishes an echo of the newest zone about ten times a second.

    Args:
        session: An open session.
        keys: The robot's keys.
    """

    def __init__(self, session: zenoh.Session, keys: Keys) -> None:
        self.heard: Heard | None = None
        self._producer = uuid.uuid4().hex
        self._key = keys.input("echo")
        self._seq = -1
        self._arrived_ns = 0
        self._next_ns = 0
        self._encoder = msgspec.json.Encoder()
        self._publisher = session.declare_publisher(
            self._key,
            encoding=encoding_of(m.Echo),
            express=True,
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.DROP,
        )

    def hear(self, zone: m.Zone) -> None:
        """Take note of a zone that has just been taken."""
        # Not the time of its arrival, which is not known: it has been held from now on, at least.
        self.heard, self._arrived_ns = Heard(zone.producer, zone.seq), time.monotonic_ns()

    def send(self) -> None:
        """Publish an echo if one is due and there is a zone that was not echoed yet."""
        now_ns = time.monotonic_ns()
        if self.heard is None or now_ns < self._next_ns:
            return
        self._next_ns = now_ns + ECHO_NS
        self._seq += 1
        echo = m.Echo(
            producer=self._producer,
            seq=self._seq,
            stamp_ns=time.time_ns(),
            service=self.heard.producer,
            tick=self.heard.seq,
            held_ns=now_ns - self._arrived_ns,
        )
        self.heard = None
        payload = self._encoder.encode(echo)
        try:
            self._publisher.put(payload, attachment=seal(self._key, self._producer, self._seq, payload))
        except zenoh.ZError:
            return  # the session was closed: there is nobody to tell

    def close(self) -> None:
        """End the publisher."""
        self._publisher.undeclare()  # type: ignore[no-untyped-call]

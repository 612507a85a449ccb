"""All pairs of a tick with all terms, some ten times a second, and as a stored reply."""

from __future__ import annotations

import time

import msgspec
import zenoh

from ..monitor import Decision
from ..wire import Keys, encoding_of, seal, separation_message, separation_pairs
from ..wire import messages as m
from .queries import Reply

PERIOD_NS = 100_000_000
"""Time from one message to the next [ns], at least."""

PAIRS_AT_ONCE = 8
"""Pairs that are written between two ticks, so that many of them do not make the next one late."""


class SeparationOutput:
    """Publishes ``separation`` and keeps the last message for queries.

    A tick's pairs are written between the ticks that follow it, a few at a time; the arrays are the
    decision's own and do not change. The message then speaks of that tick, which is its ``seq``.

    Attributes:
        reply: The last message.

    Args:
        session: The Zenoh session.
        keys: The robot's keys.
        producer: Random id of this service.
        profile: Zone profile in force.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, *, producer: str, profile: str) -> None:
        self._key = keys.output("separation")
        self._robot, self._producer, self._profile = keys.robot, producer, profile
        self._encoder = msgspec.json.Encoder()
        self._publisher = session.declare_publisher(
            self._key,
            encoding=encoding_of(m.Separation),
            express=True,
            priority=zenoh.Priority.DATA,
            congestion_control=zenoh.CongestionControl.DROP,
        )
        self.reply = Reply(b"", "", b"")
        self._decision: Decision | None = None
        self._pairs: list[m.SeparationPair] = []
        self._last: int | None = None
        self._due_ns = 0

    def work(self, newest: Decision | None, now_ns: int) -> None:
        """Write some pairs, and publish them when all are there.

        Args:
            newest: The last decision.
            now_ns: Now [monotonic ns].
        """
        if self._decision is None:
            if newest is None or newest.tick == self._last or now_ns < self._due_ns:
                return
            self._decision, self._pairs, self._due_ns = newest, [], now_ns + PERIOD_NS
        separated = self._decision.separation
        begun, every = len(self._pairs), 0 if separated is None else len(separated)
        if separated is not None:
            self._pairs += separation_pairs(separated, range(begun, min(begun + PAIRS_AT_ONCE, every)))
        if len(self._pairs) == every:
            self._publish(self._decision)
            self._last, self._decision = self._decision.tick, None

    def _publish(self, decision: Decision) -> None:
        message = separation_message(
            decision,
            self._pairs,
            producer=self._producer,
            stamp_ns=time.time_ns(),
            robot=self._robot,
            profile=self._profile,
        )
        payload = self._encoder.encode(message)
        attachment = seal(self._key, self._producer, decision.tick, payload)
        self.reply = Reply(payload, encoding_of(m.Separation), attachment)
        self._publisher.put(payload, attachment=attachment)

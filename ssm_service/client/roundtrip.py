"""The round trip that proves an age, asked and answered without waiting."""

from __future__ import annotations

from dataclasses import dataclass

import zenoh

from ..errors import InputError
from ..wire import Heard
from ..wire import messages as m
from .accept import OutputDecoder

RETRY_NS = 50_000_000
"""From a query that nobody answered to the next one [ns]."""

PAUSE_NS = 5_000_000
"""From a query that was answered to the next one, at least [ns]."""

TIMEOUT_NS = 250_000_000
"""How long one query may take [ns]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """What came back.

    Attributes:
        zones: One or more answers.
        asked_ns: A time [ns] before the query was sent.
        heard: The newest tick that had been heard by then.
    """

    zones: tuple[m.Zone, ...]
    asked_ns: int
    heard: Heard | None = None

    def check(self) -> None:
        """Refuse an answer that is older than what was heard before the question: it answers another one.

        Raises:
            InputError: ``old_seq``.
        """
        heard = self.heard
        for zone in self.zones:
            if heard is not None and zone.producer == heard.producer and zone.seq < heard.seq:
                allowed = f"{heard.seq}, which was heard before the question, or above"
                raise InputError("old_seq", "seq", zone.seq, allowed, fault="repetition")


class RoundTrip:
    """Asks ``zone`` again and again until somebody answers.

    Attributes:
        unanswered: Whether the last query that has ended was not answered.

    Args:
        session: An open session.
        key: Key of the zone.
    """

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.unanswered = False
        self._session = session
        self._key = key
        self._decoder = OutputDecoder(m.Zone, key)
        self._replies: zenoh.Handler[zenoh.Reply] | None = None
        self._asked_ns = 0
        self._heard: Heard | None = None
        self._next_ns = 0

    def restart(self, now_ns: int) -> None:
        """Give up a query under way: its answer would prove less than a new one's."""
        self._replies = None
        self._next_ns = now_ns

    def step(self, now_ns: int, heard: Heard | None = None) -> Answers | None:
        """Ask if it is time to, or see what has been answered.

        Args:
            now_ns: The time now.
            heard: The newest tick that was heard so far.

        Raises:
            InputError: An answer is malformed.
        """
        if self._replies is None:
            if now_ns >= self._next_ns:
                self._heard = heard
                self._ask(now_ns)
            return None
        zones = self._read(self._replies)
        if zones:
            self._replies, self.unanswered = None, False
            self._next_ns = now_ns + PAUSE_NS
            return Answers(zones=zones, asked_ns=self._asked_ns, heard=self._heard)
        if now_ns - self._asked_ns > TIMEOUT_NS:
            self._replies = None
        self.unanswered = self.unanswered or self._replies is None
        return None

    def _ask(self, now_ns: int) -> None:
        self._asked_ns = now_ns
        self._next_ns = now_ns + RETRY_NS
        try:
            self._replies = self._session.get(
                self._key,
                # Not a RingChannel: Zenoh deletes one, answers and all, when the query ends.
                zenoh.handlers.FifoChannel(16),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=TIMEOUT_NS * 1e-9,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
        except zenoh.ZError:
            self._replies = None  # as if nobody had answered

    def _read(self, replies: zenoh.Handler[zenoh.Reply]) -> tuple[m.Zone, ...]:
        zones = []
        try:
            while (reply := replies.try_recv()) is not None:
                if reply.ok is not None:
                    zones.append(self._decoder.decode(reply.ok))
        except zenoh.ZError:
            self._replies = None  # the query has ended
        except InputError:
            self._replies = None
            raise
        return tuple(zones)

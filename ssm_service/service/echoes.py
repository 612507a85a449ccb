"""The transport to the consumers, as their echoes show it."""

from __future__ import annotations

import time

import zenoh

from ..errors import InputError
from ..wire import Heard, Keys, SealedDecoder, attachment_of, check_sample, old_seq
from ..wire import messages as m
from .integrity import IntegrityWatch
from .publications import Publications
from .statistics import RecentGreatest, Rejections

WINDOW_NS = 1_000_000_000
"""How long an echo counts, at least [ns]."""

MAX_CONSUMERS = 32
"""Consumers whose echoes are kept apart; more are refused while these are fresh."""

CHANNEL_CAPACITY = 1024


class _Consumer:
    def __init__(self) -> None:
        self.seq = -1
        self.transport_ns = RecentGreatest(WINDOW_NS)


class Echoes:
    """What consumers send back of the zones that they heard.

    From a tick's publication to the arrival of its echo, less the time for which the consumer held it, is
    the way there and back; so it is an upper bound of the way there. An echo can only raise the
    transport time: one that claims to have held the zone for longer than it exists counts as 0.

    Args:
        session: The Zenoh session.
        keys: The robot's keys.
        publications: When the ticks were published.
        rejections: Counts what is refused.
        watch: Gets errors of integrity.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        publications: Publications,
        rejections: Rejections,
        watch: IntegrityWatch,
    ) -> None:
        self._publications, self._rejections, self._watch = publications, rejections, watch
        self._decoder = SealedDecoder(m.Echo, keys.input("echo"))
        self._consumers: dict[str, _Consumer] = {}
        channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(CHANNEL_CAPACITY)
        self._subscriber = session.declare_subscriber(keys.input("echo"), channel)

    def drain(self, now_ns: int, deadline_ns: int) -> None:
        """Take what waits, until the channel is empty or ``deadline_ns`` has passed."""
        receive = self._subscriber.handler.try_recv
        while (sample := receive()) is not None:
            try:
                self._accept(sample, now_ns)
            except InputError as error:
                self._rejections.add("echo", error.cause, str(error))
                if error.fault:
                    self._watch.add(error.fault, "in/echo", now_ns)
            if time.monotonic_ns() > deadline_ns:
                return

    def transport_s(self, now_ns: int) -> dict[str, float]:
        """Return an upper bound of the transport to each consumer that was heard lately [s]."""
        return {
            producer: greatest * 1e-9
            for producer, consumer in self._consumers.items()
            if (greatest := consumer.transport_ns.at(now_ns)) is not None
        }

    def greatest_s(self, now_ns: int) -> float:
        """Return the greatest of them [s]; 0 where nobody was heard lately."""
        return max(self.transport_s(now_ns).values(), default=0.0) if self._consumers else 0.0

    def _accept(self, sample: zenoh.Sample, now_ns: int) -> None:
        check_sample(sample, m.Echo)
        echo = self._decoder.decode(sample.payload.to_bytes(), attachment_of(sample), required=True).message
        consumer = self._consumer(echo.producer, now_ns)
        if echo.seq <= consumer.seq:
            raise old_seq(echo.seq, consumer.seq)
        published_ns = self._publications.time_of(Heard(echo.service, echo.tick))
        if published_ns is None:
            raise InputError("unknown_tick", "tick", f"{echo.service}/{echo.tick}", "a tick of this service")
        consumer.seq = echo.seq
        consumer.transport_ns.add(max(now_ns - published_ns - echo.held_ns, 0), now_ns)
        self._consumers[echo.producer] = consumer

    def _consumer(self, producer: str, now_ns: int) -> _Consumer:
        """Return what is known of a consumer; of a new one, nothing yet, which is kept by the caller."""
        known = self._consumers.get(producer)
        if known is not None:
            return known
        if len(self._consumers) >= MAX_CONSUMERS:
            fresh = self.transport_s(now_ns)
            self._consumers = {name: one for name, one in self._consumers.items() if name in fresh}
        if len(self._consumers) >= MAX_CONSUMERS:
            raise InputError("too_many", "producer", producer, f"at most {MAX_CONSUMERS} consumers")
        return _Consumer()

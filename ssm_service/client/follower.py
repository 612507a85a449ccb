"""The watchdog at work on a session, as an object for control loops."""

from __future__ import annotations

import time
from contextlib import suppress

import zenoh

from ..errors import InputError
from ..wire import Heard, Keys
from ..wire import messages as m
from ..wire.latch import Latch
from .accept import CAPACITY, Channel, check
from .connection import Connection
from .echoing import Echoing
from .followed import Followed
from .roundtrip import Answers, RoundTrip
from .watchdog import LONGEST_VALID_NS, Watchdog

RENEW_NS = 100_000_000
"""From one answer that renews the proof to the next question [ns]."""


class Follower:
    """Follows zone and command of one robot; ``poll`` never waits and always says what holds now.

    A message's time of arrival is not known, only that it came after its channel was last seen empty; that
    moment is taken, so an age is over- and never under-estimated. When this process itself was held up for
    longer than a message is valid, even an empty channel proves nothing, as what came meanwhile may still be
    on its way through a socket: then all is dropped and the ages are proved anew (see ``Watchdog``).

    So it must be polled often, at least twice in ``valid_for_ns`` (20 ms with the service's defaults).
    Who polls more rarely than once in that time is never given anything but a stop.

    Args:
        link: An open session, or a ``Connection`` that may still be waiting for one.
        keys: The robot's keys.
        longest_valid_ns: Bound of every ``valid_for_ns``.
        latch: See ``Watchdog``.
        echo: Whether to send echoes, by which the service measures the transport to this consumer. One that
            only shows what holds need not.

    Attributes:
        heard: The newest tick whose zone was taken: what a driver in the same process may name as ``after``.
    """

    def __init__(
        self,
        link: zenoh.Session | Connection,
        keys: Keys,
        *,
        longest_valid_ns: int = LONGEST_VALID_NS,
        latch: Latch | None = None,
        echo: bool = True,
    ) -> None:
        self.watchdog = Watchdog(keys.robot, longest_valid_ns, latch)
        self.heard: Heard | None = None
        self._echo = echo
        self._echoing: Echoing | None = None
        self._link = link
        self._session: zenoh.Session | None = None
        self._keys = keys
        self._channels: tuple[Channel[m.Zone], Channel[m.VelocityCommand]] | None = None
        self._trip: RoundTrip | None = None
        self._polled_ns = self._empty_ns = self._renew_ns = time.monotonic_ns()

    def poll(self, now_ns: int | None = None) -> Followed:
        """Return what holds now; the same object as long as nothing changed.

        Args:
            now_ns: ``time.monotonic_ns()`` if the caller has just read it.
        """
        now = time.monotonic_ns() if now_ns is None else now_ns
        before, self._polled_ns = self._polled_ns, now
        gap = now - before
        session = self._link.session if isinstance(self._link, Connection) else self._link
        if session is not self._session and self._session is not None:
            self._detach()
        if self._trip is None or self._channels is None:
            self._attach(session)
            return self.watchdog.state(now)
        if not 0 <= gap <= self.watchdog.valid_for_ns:
            # What was held has expired as well, as it can only be older than the pause.
            self._start_over(self._trip, self._channels, now)
        self.watchdog.expire(now)
        if not self.watchdog.proved:
            self._prove(self._trip, now)
        elif now >= self._renew_ns:
            self._renew(self._trip, now)
        zones, commands = self._channels
        if self._drain(zones, now) & self._drain(commands, now):
            # After a longish gap an empty channel may only mean that Zenoh's own threads were held up, too.
            self._empty_ns = now if 2 * gap <= self.watchdog.valid_for_ns else before
        if self._echoing is not None:
            self._echoing.send()
        state = self.watchdog.state(now)
        # All this took time, and a process can be stopped anywhere.
        return state if now_ns is not None else self.watchdog.state(time.monotonic_ns())

    def close(self) -> None:
        """End the subscriptions; the session stays its owner's."""
        self._session = None
        channels, self._channels, self._trip = self._channels, None, None
        echoing, self._echoing = self._echoing, None
        for part in (*(channels or ()), *((echoing,) if echoing else ())):
            part.close()

    def _detach(self) -> None:
        """Give up a session that was replaced, with all that was heard through it."""
        with suppress(zenoh.ZError):
            self.close()
        self.watchdog.forget()

    def _attach(self, session: zenoh.Session | None) -> None:
        if session is None or session.is_closed():
            return
        self._session = session
        self._channels = (
            Channel(session, self._keys.output("zone"), m.Zone),
            Channel(session, self._keys.output("command"), m.VelocityCommand),
        )
        self._trip = RoundTrip(session, self._keys.output("zone"))
        self._echoing = Echoing(session, self._keys) if self._echo else None

    def _start_over(
        self, trip: RoundTrip, channels: tuple[Channel[m.Zone], Channel[m.VelocityCommand]], now: int
    ) -> None:
        self.watchdog.forget()
        trip.restart(now)
        for channel in channels:
            self._drop(channel, now)

    def _drop(self, channel: Channel[m.Zone] | Channel[m.VelocityCommand], now: int) -> None:
        """Take what waits for nothing, but for what is wrong with it: a pause hides no error of integrity."""
        for _ in range(CAPACITY):
            sample = _receive(channel)
            if sample is None:
                return
            try:
                check(channel.decode(sample), self._keys.robot)
            except InputError as error:
                self.watchdog.refuse(error, now)

    def _prove(self, trip: RoundTrip, now: int) -> None:
        try:
            answers = trip.step(now, self.heard)
            if answers is None:
                if trip.unanswered and isinstance(self._link, Connection) and self._session is not None:
                    self._link.unanswered(self._session)
                return
            if isinstance(self._link, Connection):
                self._link.answered()
            answers.check()
            self._compare(answers, now)
            self.watchdog.prove(answers.zones[0], answers.asked_ns)
            self._renew_ns = now + RENEW_NS
            # An answer that was long on its way only proves ages that are too great by now.
            self.watchdog.expire(now)
        except InputError as error:
            self.watchdog.refuse(error, now)

    def _renew(self, trip: RoundTrip, now: int) -> None:
        try:
            answers = trip.step(now, self.heard)
            if answers is None:
                return
            self._renew_ns = now + RENEW_NS
            answers.check()
            self._compare(answers, now)
            self.watchdog.renew(answers.zones[0], answers.asked_ns, now)
        except InputError as error:
            self.watchdog.refuse(error, now)

    def _compare(self, answers: Answers, now: int) -> None:
        if len({zone.producer for zone in answers.zones}) > 1:
            self.watchdog.duplicate(now)

    def _drain(self, channel: Channel[m.Zone] | Channel[m.VelocityCommand], now: int) -> bool:
        """Take what waits; return whether the channel was seen empty."""
        for _ in range(2 * CAPACITY):
            sample = _receive(channel)
            if sample is None:
                return True
            try:
                message = channel.decode(sample)
                self.watchdog.take(message, self._empty_ns, now)
            except InputError as error:
                self.watchdog.refuse(error, now)
                continue
            if isinstance(message, m.Zone):
                self._hear(message)
        return False

    def _hear(self, zone: m.Zone) -> None:
        self.heard = Heard(zone.producer, zone.seq)
        if self._echoing is not None:
            self._echoing.hear(zone)


def _receive(channel: Channel[m.Zone] | Channel[m.VelocityCommand]) -> zenoh.Sample | None:
    try:
        return channel.receive()
    except zenoh.ZError:
        return None  # the session was closed: nothing will come, and what is held runs out

"""The watchdog's judgement: messages and times in, what holds now out. No clock, no network."""

from __future__ import annotations

from collections import Counter

from ..errors import InputError
from ..wire import messages as m
from ..wire.latch import Latch
from .accept import Output, check
from .followed import Followed, decision, own_stop, service_stop
from .pairing import Pairing

LONGEST_VALID_NS = 1_000_000_000
"""No message is acted on for longer than this [ns], whatever it says of itself."""

SHORTEST_VALID_NS = 20_000_000
"""Taken for ``valid_for_ns`` [ns] while no service has said its own."""

REFUSAL_SHOWN_NS = 500_000_000
"""How long [ns] a refusal is named as the reason of a stop."""

UNRENEWED_NS = 1_000_000_000
"""A proof that was not renewed for so long [ns] is none any more."""

MANY = 4
"""Producers that are kept apart; that there are more than one is all that matters."""


class Watchdog:
    """Decides what a consumer may act on.

    Nothing is believed before its age is proved. The proof is a round trip: a query sent at ``asked_ns`` was
    answered with tick R, so every tick above R was decided after ``asked_ns``. Once proved, messages keep
    the proof up by coming in time. When they do not, everything is dropped and a new proof is needed,
    because what comes after a silence may have waited somewhere (in this process while it was stopped, in
    a socket, in a router) for as long as the silence was.

    A delay may also grow so slowly that no gap between two messages ever shows it. So the same question is
    asked again and again, ten times a second by ``Follower`` (``renew``). The answer R was there when it
    came; ticks up to R are acted on for ``valid_for_ns`` from then and no longer. Messages that lag behind
    the answers by more are therefore a stop at the next answer but one, and a proof that is not renewed
    within ``UNRENEWED_NS`` is dropped. What it cannot see is a delay below ``valid_for_ns``.

    All times are ``time.monotonic_ns`` [ns] of the consumer.

    Args:
        robot: The robot's name on the network; messages for another one are refused.
        longest_valid_ns: Bound of every ``valid_for_ns``.
        latch: Holds the stop after two errors of integrity within its interval, until it is reset. The stop's
            reason is then ``latched:`` and the second one's fault.

    Attributes:
        rejected: Refused messages by cause.
        integrity_errors: Those of them that show a fault of transmission, by fault (``wire.integrity``).
    """

    def __init__(
        self, robot: str, longest_valid_ns: int = LONGEST_VALID_NS, latch: Latch | None = None
    ) -> None:
        self.rejected: Counter[str] = Counter()
        self.integrity_errors: Counter[str] = Counter()
        self._latch = latch
        self.last_rejection = ""
        self.valid_for_ns = SHORTEST_VALID_NS
        self._robot = robot
        self._longest_ns = longest_valid_ns
        self._pairing: Pairing | None = None
        self._lost = 0
        self._asked_ns = 0
        self._expires_ns = 0
        self._there = (0, 0)  # the newest tick that was answered, and when its answer came
        self._renewed_ns = 0
        self._current: Followed | None = None
        self._heard: dict[str, int] = {}
        self._duplicate_until_ns = 0
        self._refused_ns: int | None = None
        self._name: tuple[str, ...] = ()
        self._ever = False
        self._own = own_stop("waiting:service", ())

    @property
    def proved(self) -> bool:
        """Whether the ages of messages above a known tick are proved."""
        return self._pairing is not None

    @property
    def lost(self) -> int:
        """Ticks of which a message was missing while the ages were proved."""
        return self._lost + (0 if self._pairing is None else self._pairing.lost)

    def prove(self, answer: m.Zone, asked_ns: int) -> None:
        """Take a service's answer to a query as the proof of the ages of all later ticks.

        Raises:
            InputError: As ``accept.check`` says.
        """
        check(answer, self._robot)
        self.forget()
        self.valid_for_ns = min(answer.valid_for_ns, self._longest_ns)
        self._pairing = Pairing(answer.producer, answer.seq)
        self._asked_ns = self._renewed_ns = asked_ns
        self._expires_ns = asked_ns + self.valid_for_ns
        self._there = (answer.seq, asked_ns)

    def renew(self, answer: m.Zone, asked_ns: int, answered_ns: int) -> None:
        """Take the answer to a later query: its tick is there, and those before it are on their way out.

        An answer of another producer ends the proof: the one that was followed is gone, or not alone.

        Raises:
            InputError: As ``accept.check`` says.
        """
        check(answer, self._robot)
        if self._pairing is None:
            return
        if answer.producer != self._pairing.producer:
            self.forget()
            return
        self._there = (answer.seq, answered_ns)
        self._renewed_ns = asked_ns

    def forget(self) -> None:
        """Drop everything that was held: nothing is believed until the next proof."""
        self._lost = self.lost
        self._pairing = None
        self._current = None

    def expire(self, now_ns: int) -> None:
        """Drop everything if it is too old by now."""
        if self._pairing is None:
            return
        if now_ns >= self._expires_ns or now_ns - self._renewed_ns >= UNRENEWED_NS:
            self.forget()

    def take(self, message: Output, arrived_ns: int, now_ns: int) -> None:
        """Take a message.

        Args:
            message: As decoded.
            arrived_ns: The earliest time at which it can have arrived.
            now_ns: The time now.

        Raises:
            InputError: As ``accept.check`` says; ``second_producer``, ``old_seq`` or ``mismatch``.
        """
        check(message, self._robot)
        self._hear(message, now_ns)
        if self._pairing is None:
            return
        if message.producer != self._pairing.producer:
            allowed = f"only {self._pairing.producer}"
            raise InputError("second_producer", "producer", message.producer, allowed, fault="insertion")
        pair = self._pairing.add(message, max(arrived_ns, self._asked_ns))
        if pair is not None:
            self.valid_for_ns = min(pair.zone.valid_for_ns, pair.command.valid_for_ns, self._longest_ns)
            seq, there_ns = self._there
            known_ns = min(pair.arrived_ns, there_ns) if pair.zone.seq <= seq else pair.arrived_ns
            self._expires_ns = known_ns + self.valid_for_ns
            self._current = decision(pair.zone, pair.command, self._expires_ns)
            self._name, self._ever, self._refused_ns = self._current.name, True, None
        elif isinstance(message, m.Zone) and message.zone == "stop":
            self._current = service_stop(message, None, self._expires_ns)

    def refuse(self, error: InputError, now_ns: int) -> None:
        """Count a refused message. It never makes anything hold longer."""
        self.rejected[error.cause] += 1
        self.last_rejection = str(error)[:300]
        if error.fault:
            self.integrity_errors[error.fault] += 1
            if self._latch is not None:
                self._latch.error(error.fault, self._robot, now_ns * 1e-9)
        if error.cause != "second_producer":
            self._refused_ns = now_ns

    def duplicate(self, now_ns: int) -> None:
        """Note that two services were heard at once."""
        self._duplicate_until_ns = max(self._duplicate_until_ns, now_ns + self.valid_for_ns)

    def state(self, now_ns: int) -> Followed:
        """Return what holds now; the same object as long as nothing changed."""
        self.expire(now_ns)
        latched = None if self._latch is None else self._latch.latched
        if latched is not None:
            return self._stop(f"latched:{latched.partition(' ')[0]}")
        if self._current is None or now_ns < self._duplicate_until_ns:
            return self._stop(self._reason(now_ns))
        return self._current

    def _hear(self, message: Output, now_ns: int) -> None:
        # Kept apart from the proof: a second service must be noticed before anything is believed, too.
        if len(self._heard) > 1 or message.producer not in self._heard:
            self._heard = {producer: until for producer, until in self._heard.items() if until > now_ns}
        if len(self._heard) < MANY or message.producer in self._heard:
            self._heard[message.producer] = now_ns + min(message.valid_for_ns, self._longest_ns)
        if len(self._heard) > 1:
            self._duplicate_until_ns = max(self._duplicate_until_ns, sorted(self._heard.values())[-2])

    def _reason(self, now_ns: int) -> str:
        if now_ns < self._duplicate_until_ns:
            return "duplicate:service"
        if self._refused_ns is not None and now_ns - self._refused_ns < REFUSAL_SHOWN_NS:
            return "invalid:service"
        return "stale:service" if self._ever else "waiting:service"

    def _stop(self, reason: str) -> Followed:
        if self._own.reasons != (reason,) or self._own.name != self._name:
            self._own = own_stop(reason, self._name)
        return self._own

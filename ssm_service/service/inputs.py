"""Inputs wait in bounded channels; the loop drains them at the start of a tick."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
import zenoh
from numpy.typing import NDArray

from ..config import SourceConfig
from ..errors import InputError
from ..model import Robot
from ..monitor import SOURCES, Inputs, JointSample, RangeReader, Received
from ..wire import VALUES, Heard, Keys, ProducerGate, SealedDecoder, attachment_of, check_sample
from ..wire.messages import INPUTS
from .echoes import Echoes
from .integrity import IntegrityWatch
from .preparing import ScanPreparation
from .publications import Publications
from .statistics import Intervals, Rejections

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What all inputs of one service share.

    Attributes:
        robot: The robot.
        session: The Zenoh session.
        keys: The robot's keys.
        publications: When the service's ticks were published.
        watch: Gets errors of integrity.
        rejections: Counts what is refused.
    """

    robot: Robot
    session: zenoh.Session
    keys: Keys
    publications: Publications
    watch: IntegrityWatch
    rejections: Rejections = field(default_factory=Rejections)


CHANNEL_CAPACITY = 16_384
"""Messages that one channel holds; beyond it the oldest are dropped, which only lets a source grow older."""


class Source(Generic[T]):
    """One input key: its channel, its checks, and the newest value that passed them.

    A message's time of arrival is not known, only that it came after the channel was last seen empty; so that
    moment is taken. The age is then an upper bound: a backlog, a flood or a pause of this process can make a
    value look older than it is, never younger.

    A message that names a tick of this service in its attachment was made after that tick's publication, so
    the age is counted from there: it is then bounded whatever the network did in between.

    Args:
        name: The source.
        shared: What it shares with the others.
    """

    def __init__(self, name: str, shared: Surroundings) -> None:
        self.name = name
        self.accepted = 0
        config: SourceConfig = getattr(shared.robot.config.file.sources, name)
        self.gate = ProducerGate(config.timeout_s)
        self.integrity = config.integrity
        self._prove_age = config.prove_age
        self._timeout_ns = int(config.timeout_s * 1e9)
        self._shared = shared
        self._robot = shared.robot
        self._kind = INPUTS[name]
        self._decoder: SealedDecoder[Any] = SealedDecoder(self._kind, shared.keys.input(name))
        self._to_value: Any = VALUES[name]
        channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(CHANNEL_CAPACITY)
        self._subscriber = shared.session.declare_subscriber(shared.keys.input(name), channel)
        self._sealing: str | None = None
        self._intervals = Intervals(self._timeout_ns)
        self._value: T | None = None
        self._made_ns = 0
        self._empty_ns = time.monotonic_ns()
        self._refused_ns: int | None = None

    def drain(self, now_ns: int, deadline_ns: int) -> None:
        """Take what waits, until the channel is empty or ``deadline_ns`` has passed."""
        receive = self._subscriber.handler.try_recv
        while (sample := receive()) is not None:
            try:
                self._accept(sample, now_ns)
            except InputError as error:
                self._refused_ns = now_ns
                self._refuse(error, now_ns)
            if time.monotonic_ns() > deadline_ns:
                return
        self._empty_ns = now_ns

    def _refuse(self, error: InputError, now_ns: int) -> None:
        self._shared.rejections.add(self.name, error.cause, str(error))
        if error.fault:
            self._shared.watch.add(error.fault, f"in/{self.name}", now_ns)

    def _take(self, value: T, made_ns: int, now_ns: int) -> None:
        """Let the next tick have a value.

        Args:
            value: The value.
            made_ns: A time before it was made, as far as that is known, monotonic [ns].
            now_ns: The time now, monotonic [ns].
        """
        self._value, self._made_ns = value, made_ns
        self._intervals.add(now_ns)

    def received(self, now_ns: int) -> Received[T]:
        """Return the newest accepted value with its greatest possible age."""
        age = None if self._value is None else (now_ns - self._made_ns) * 1e-9
        return Received(
            value=self._value,
            age_s=age,
            invalid=self._is_invalid(now_ns),
            period_s=self._intervals.greatest_ns * 1e-9,
        )

    def _is_invalid(self, now_ns: int) -> bool:
        # A refusal counts until a good message follows, at most for the timeout: a source that had spoken
        # is stale by then, and one that never spoke must not be silenced for good by a stranger.
        return self._refused_ns is not None and now_ns - self._refused_ns <= self._timeout_ns

    def _accept(self, sample: zenoh.Sample, now_ns: int) -> None:
        check_sample(sample, self._kind)
        opened = self._decoder.decode(
            sample.payload.to_bytes(), attachment_of(sample), required=self.integrity == "crc"
        )
        message = opened.message
        if not opened.sealed and message.producer == self._sealing:
            allowed = "a checksum, as its producer has sent before"
            raise InputError("missing_crc", "attachment", None, allowed, fault="masquerade")
        # Another producer must have come a timeout later than the present one's last message, however long
        # both waited here: a flood that holds up a good driver must not open the door to a second one.
        self.gate.check(message.producer, message.seq, self._empty_ns * 1e-9)
        made_ns = self._made(opened.after)
        value = self._to_value(self._robot, message)
        self.gate.accept(message.producer, message.seq, now_ns * 1e-9)
        self._sealing = message.producer if opened.sealed else None
        self._take(value, made_ns, now_ns)
        self._refused_ns = None
        self.accepted += 1

    def _made(self, after: Heard | None) -> int:
        """Return a time before a message was made, or at least before it arrived.

        Raises:
            InputError: ``unproved`` where the former is wanted and nothing proves it.
        """
        published_ns = None if after is None else self._shared.publications.time_of(after)
        if published_ns is not None:
            return min(published_ns, self._empty_ns)
        if self._prove_age:
            raise InputError("unproved", "attachment", after, "after=PRODUCER/SEQ of a tick of this service")
        return self._empty_ns


class PreparedSource(Source[NDArray[np.float64]]):
    """The readings, where what a tick needs of them is worked out beside the loop.

    Args:
        shared: As for ``Source``.
        joints: The joints: a scan is prepared for the newest position.
        reader: Gets what was prepared.
    """

    def __init__(self, shared: Surroundings, *, joints: Source[JointSample], reader: RangeReader) -> None:
        super().__init__("ranges", shared)
        self._joints, self._reader, self._rest = joints, reader, shared.robot.rest_position
        self._preparation = ScanPreparation(reader, self._failed)

    def drain(self, now_ns: int, deadline_ns: int) -> None:
        """Take what waits, and give the loop what is ready."""
        super().drain(now_ns, deadline_ns)
        ready = self._preparation.take()
        if ready is not None:
            self._reader.take(ready.prepared)
            # Scans that were left out make the period longer, so it is measured here.
            super()._take(ready.prepared.ranges, ready.arrived_ns, now_ns)

    def _take(self, value: NDArray[np.float64], made_ns: int, now_ns: int) -> None:
        joints = self._joints.received(now_ns).value
        position = self._rest if joints is None else joints.position
        self._preparation.submit(value, position, made_ns)

    def _failed(self, text: str) -> None:
        self._shared.rejections.add(self.name, "internal", text)


class InputChannels:
    """All inputs of one robot, and the echoes of its consumers.

    Args:
        shared: What they share.
        budget_ns: Time [ns] that draining may take in one tick, so that no sender can slow the loop.
        reader: What the monitor reads scans with; where it is slow, scans are prepared beside the loop.
    """

    def __init__(self, shared: Surroundings, budget_ns: int, reader: RangeReader | None = None) -> None:
        self.rejections = shared.rejections
        self._watch = shared.watch
        self.sources: dict[str, Source[Any]] = {}
        for name in SOURCES:
            if name == "ranges" and reader is not None and reader.slow:
                self.sources[name] = PreparedSource(shared, joints=self.sources["joints"], reader=reader)
            else:
                self.sources[name] = Source[Any](name, shared)
        self.echoes = Echoes(
            shared.session, shared.keys, shared.publications, shared.rejections, shared.watch
        )
        self._order: list[Source[Any] | Echoes] = [*self.sources.values(), self.echoes]
        self._budget_ns = budget_ns

    def read(self, now_ns: int, *, overrun_s: float, duplicate: bool, tick_s: float = 0.0) -> Inputs:
        """Drain all channels within the budget and return what is known now.

        Each source has a share of the budget, and what one leaves over goes to the next; the first one
        changes with each tick, so a flood on one key cannot starve another.
        """
        begin = time.monotonic_ns()
        share = self._budget_ns // len(self._order)
        for index, source in enumerate(self._order):
            source.drain(now_ns, begin + (index + 1) * share)
        self._order.append(self._order.pop(0))
        received: dict[str, Any] = {name: source.received(now_ns) for name, source in self.sources.items()}
        return Inputs(
            **received,
            overrun_s=overrun_s,
            duplicate=duplicate,
            latched=self._watch.latched is not None,
            tick_s=tick_s,
            transport_s=self.echoes.greatest_s(now_ns),
        )

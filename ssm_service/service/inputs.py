"""Inputs wait in bounded channels; the loop drains them at the start of a tick."""

from __future__ import annotations

import time
from typing import Any, Generic, TypeVar

import numpy as np
import zenoh
from numpy.typing import NDArray

from ..errors import InputError
from ..model import Robot
from ..monitor import SOURCES, Inputs, JointSample, RangeReader, Received
from ..wire import VALUES, Decoder, Keys, ProducerGate, encoding_of, names_another
from ..wire.messages import INPUTS
from .preparing import ScanPreparation
from .statistics import Rejections

T = TypeVar("T")

CHANNEL_CAPACITY = 16_384
"""Messages that one channel holds; beyond it the oldest are dropped, which only lets a source grow older."""


class Source(Generic[T]):
    """One input key: its channel, its checks, and the newest value that passed them.

    A message's time of arrival is not known, only that it came after the channel was last seen empty; so that
    moment is taken. The age is then an upper bound: a backlog, a flood or a pause of this process can make a
    value look older than it is, never younger.
    """

    def __init__(
        self, name: str, robot: Robot, session: zenoh.Session, keys: Keys, rejections: Rejections
    ) -> None:
        self.name = name
        self.accepted = 0
        timeout_s = getattr(robot.config.file.sources, name).timeout_s
        self.gate = ProducerGate(timeout_s)
        self._timeout_ns = int(timeout_s * 1e9)
        self._robot = robot
        self._rejections = rejections
        self._kind = INPUTS[name]
        self._decoder: Decoder[Any] = Decoder(self._kind)
        self._to_value: Any = VALUES[name]
        channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(CHANNEL_CAPACITY)
        self._subscriber = session.declare_subscriber(keys.input(name), channel)
        self._value: T | None = None
        self._arrived_ns = 0
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
                self._rejections.add(self.name, error.cause, str(error))
            if time.monotonic_ns() > deadline_ns:
                return
        self._empty_ns = now_ns

    def _take(self, value: T) -> None:
        """Let the next tick have a value."""
        self._value, self._arrived_ns = value, self._empty_ns

    def received(self, now_ns: int) -> Received[T]:
        """Return the newest accepted value with its greatest possible age."""
        age = None if self._value is None else (now_ns - self._arrived_ns) * 1e-9
        return Received(value=self._value, age_s=age, invalid=self._is_invalid(now_ns))

    def _is_invalid(self, now_ns: int) -> bool:
        # A refusal counts until a good message follows, at most for the timeout: a source that had spoken
        # is stale by then, and one that never spoke must not be silenced for good by a stranger.
        return self._refused_ns is not None and now_ns - self._refused_ns <= self._timeout_ns

    def _accept(self, sample: zenoh.Sample, now_ns: int) -> None:
        if sample.kind != zenoh.SampleKind.PUT:
            raise InputError("not_put", "sample", "a delete", "a put")
        encoding = str(sample.encoding)
        if names_another(encoding, self._kind):
            raise InputError(
                "wrong_encoding", "encoding", encoding, f"{encoding_of(self._kind)}, or no schema"
            )
        message = self._decoder.decode(sample.payload.to_bytes())
        seconds = now_ns * 1e-9
        # Another producer must have come a timeout later than the present one's last message, however long
        # both waited here: a flood that holds up a good driver must not open the door to a second one.
        self.gate.check(message.producer, message.seq, self._empty_ns * 1e-9)
        value = self._to_value(self._robot, message)
        self.gate.accept(message.producer, message.seq, seconds)
        self._take(value)
        self._refused_ns = None
        self.accepted += 1


class PreparedSource(Source[NDArray[np.float64]]):
    """The readings, where what a tick needs of them is worked out beside the loop.

    Args:
        source: As for ``Source``.
        joints: The joints: a scan is prepared for the newest position.
        reader: Gets what was prepared.
    """

    def __init__(
        self,
        robot: Robot,
        session: zenoh.Session,
        keys: Keys,
        rejections: Rejections,
        *,
        joints: Source[JointSample],
        reader: RangeReader,
    ) -> None:
        super().__init__("ranges", robot, session, keys, rejections)
        self._joints, self._reader, self._rest = joints, reader, robot.rest_position
        self._preparation = ScanPreparation(reader, self._failed)

    def drain(self, now_ns: int, deadline_ns: int) -> None:
        """Take what waits, and give the loop what is ready."""
        super().drain(now_ns, deadline_ns)
        ready = self._preparation.take()
        if ready is not None:
            self._reader.take(ready.prepared)
            self._value, self._arrived_ns = ready.prepared.ranges, ready.arrived_ns

    def _take(self, value: NDArray[np.float64]) -> None:
        joints = self._joints.received(self._empty_ns).value
        position = self._rest if joints is None else joints.position
        self._preparation.submit(value, position, self._empty_ns)

    def _failed(self, text: str) -> None:
        self._rejections.add(self.name, "internal", text)


class InputChannels:
    """All inputs of one robot.

    Args:
        robot: The robot.
        session: The Zenoh session.
        keys: The robot's keys.
        budget_ns: Time [ns] that draining may take in one tick, so that no sender can slow the loop.
        reader: What the monitor reads scans with; where it is slow, scans are prepared beside the loop.
    """

    def __init__(
        self,
        robot: Robot,
        session: zenoh.Session,
        keys: Keys,
        budget_ns: int,
        reader: RangeReader | None = None,
    ) -> None:
        self.rejections = Rejections()
        self.sources: dict[str, Source[Any]] = {}
        for name in SOURCES:
            if name == "ranges" and reader is not None and reader.slow:
                self.sources[name] = PreparedSource(
                    robot, session, keys, self.rejections, joints=self.sources["joints"], reader=reader
                )
            else:
                self.sources[name] = Source[Any](name, robot, session, keys, self.rejections)
        self._order = list(self.sources.values())
        self._budget_ns = budget_ns

    def read(self, now_ns: int, *, overrun_s: float, duplicate: bool) -> Inputs:
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
        return Inputs(**received, overrun_s=overrun_s, duplicate=duplicate)

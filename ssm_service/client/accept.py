"""Which messages of a service are taken for good ones."""

from __future__ import annotations

import math
from typing import Generic, TypeVar

import zenoh

from ..errors import InputError
from ..wire import SealedDecoder, attachment_of, encoding_of
from ..wire import messages as m

Output = m.Zone | m.VelocityCommand
O = TypeVar("O", bound=Output)  # noqa: E741

CAPACITY = 64
"""Messages that one channel holds; the oldest are dropped, and the newest are those that count."""


def check(message: Output, robot: str) -> None:
    """Refuse a message whose content does not hold together.

    Raises:
        InputError: ``wrong_robot``, ``repeated_joint``, ``wrong_length``, ``not_finite`` or
            ``out_of_range``.
    """
    if message.robot != robot:
        raise InputError("wrong_robot", "robot", message.robot, robot, fault="addressing")
    count = len(message.name)
    if len(set(message.name)) != count:
        raise InputError("repeated_joint", "name", message.name, "each joint once")
    limits = isinstance(message, m.Zone)
    where = "speed_limit" if limits else "velocity"
    values = message.speed_limit if isinstance(message, m.Zone) else message.velocity
    if len(values) != count:
        raise InputError("wrong_length", where, f"{len(values)} values", f"{count} values")
    if not all(map(math.isfinite, values)):
        raise InputError("not_finite", where, values, "finite numbers")
    if limits and any(value < 0.0 for value in values):
        raise InputError("out_of_range", where, values, "0 or more")


class OutputDecoder(Generic[O]):
    """Turns samples into messages of one kind, whose checksum is right.

    Args:
        kind: The message expected.
        key: The key that it is expected on.
    """

    def __init__(self, kind: type[O], key: str) -> None:
        self._decoder: SealedDecoder[O] = SealedDecoder(kind, key)
        self._encoding = encoding_of(kind)

    def decode(self, sample: zenoh.Sample) -> O:
        """Return a sample's message.

        Raises:
            InputError: ``not_put``, ``wrong_encoding``, or as ``wire.SealedDecoder.decode`` says.
        """
        if sample.kind != zenoh.SampleKind.PUT:
            raise InputError("not_put", "sample", "a delete", "a put", fault="insertion")
        if (encoding := str(sample.encoding)) != self._encoding:
            raise InputError("wrong_encoding", "encoding", encoding, self._encoding, fault="addressing")
        return self._decoder.decode(sample.payload.to_bytes(), attachment_of(sample), required=True).message


class Channel(OutputDecoder[O]):
    """One subscription to a service's output, read without waiting.

    Args:
        session: An open session.
        key: The output's key.
        kind: The message expected there.
    """

    def __init__(self, session: zenoh.Session, key: str, kind: type[O]) -> None:
        super().__init__(kind, key)
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(CAPACITY)
        self._subscriber = session.declare_subscriber(key, ring)

    def receive(self) -> zenoh.Sample | None:
        """Return the next sample, or ``None``.

        Raises:
            zenoh.ZError: The session was closed.
        """
        return self._subscriber.handler.try_recv()

    def close(self) -> None:
        """End the subscription."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

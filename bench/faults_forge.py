"""What a bad network, or a stranger, makes of a message: pure functions from messages to messages.

Whatever is forged here speaks of a clear scene, so that believing it would make the zone milder.
"""

from __future__ import annotations

import random
import uuid
from dataclasses import dataclass, field, replace
from typing import Any, Self

import msgspec
import zenoh

from ssm_service.errors import InputError
from ssm_service.wire.integrity import Heard, parsed, seal

FAR = 1.1
"""A reading [m] beyond every zone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A message on its way.

    Attributes:
        key: The key that it travels on.
        payload: JSON.
        encoding: As its sender named it.
        attachment: Its checksum, if it has one.
    """

    key: str
    payload: bytes
    encoding: zenoh.Encoding
    attachment: bytes | None

    @classmethod
    def of(cls, sample: zenoh.Sample) -> Self:
        """Return a sample as a message."""
        return cls(
            key=str(sample.key_expr),
            payload=sample.payload.to_bytes(),
            encoding=sample.encoding,
            attachment=None if sample.attachment is None else sample.attachment.to_bytes(),
        )

    @property
    def fields(self) -> dict[str, Any]:
        """The message's fields."""
        decoded: dict[str, Any] = msgspec.json.decode(self.payload)
        return decoded


def sealed(message: Message, fields: dict[str, Any], *, key: str | None = None) -> Message:
    """Return a message with other fields, with the checksum that fits them (and ``key``, where given)."""
    payload = msgspec.json.encode(fields)
    attachment = seal(key or message.key, fields["producer"], fields["seq"], payload, _heard(message))
    return replace(message, payload=payload, attachment=attachment)


def _heard(message: Message) -> Heard | None:
    """Return the tick that a message names, so that what is forged from it is as well informed."""
    try:
        said = parsed(message.attachment, required=False)
    except InputError:
        return None
    return None if said is None else said.heard


def corrupted(message: Message, rng: random.Random, bits: int | None = None) -> Message:
    """Return a message with one bit or a few bits turned over, in the payload or in the checksum.

    The case of the checksum's hexadecimal digits says nothing, so a bit that only changes that is none.
    """
    turned = bits or rng.choice((1, 1, 1, 2, 3, 8, 32))
    if message.attachment is not None and rng.random() < 0.2:
        attachment = message.attachment
        while attachment.lower() == message.attachment.lower():
            attachment = _turned(message.attachment, rng, turned)
        return replace(message, attachment=attachment)
    return replace(message, payload=_turned(message.payload, rng, turned))


def _turned(data: bytes, rng: random.Random, bits: int) -> bytes:
    changed = bytearray(data)
    for place in rng.sample(range(8 * len(data)), min(bits, 8 * len(data))):
        changed[place // 8] ^= 1 << (place % 8)
    return bytes(changed)


@dataclass
class Stranger:
    """Somebody who speaks on a key that is not theirs, in due form: own id, own sequence, own checksum."""

    producer: str = field(default_factory=lambda: uuid.uuid4().hex)
    seq: int = 0

    def message(self, like: Message, name: str) -> Message:
        """Return their next message of the same kind."""
        self.seq += 1
        return sealed(like, clear(like.fields, name) | {"producer": self.producer, "seq": self.seq})


def masked(message: Message, name: str, rng: random.Random, *, right: bool) -> Message:
    """Return what pretends to be the producer's next message.

    Args:
        message: The producer's last one.
        name: Of the input or output.
        rng: Chooses between no checksum, that of another message, and a made-up one.
        right: Whether the checksum fits: then only access control tells it from the producer's own.
    """
    fields = clear(message.fields, name)
    fields["seq"] += 1
    if right:
        return sealed(message, fields)
    attachment = rng.choice((None, message.attachment, b"crc32=%08x" % rng.getrandbits(32)))
    return replace(message, payload=msgspec.json.encode(fields), attachment=attachment)


def misdirected(message: Message, name: str, rng: random.Random, others: list[Message]) -> Message:
    """Return a good message that was meant for another address.

    Either another robot's of the same kind, or, where there is one, another key's of this robot.
    """
    others = [other for other in others if other.key != message.key]  # an answer has its query's address
    if others and rng.random() < 0.5:
        other = rng.choice(others)
        return replace(other, key=message.key)
    fields = clear(message.fields, name)
    fields["seq"] += 1
    if "robot" in fields:
        fields["robot"] = "elsewhere"
    elsewhere = message.key.split("/")
    elsewhere[1] = "elsewhere"
    return sealed(message, fields, key="/".join(elsewhere))


def clear(fields: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a message's fields, but speaking of a clear scene and full speed."""
    changed = dict(fields)
    if name == "ranges":
        changed["ranges"] = [None] * len(fields["ranges"])
    elif name == "obstacles":
        changed["obstacles"] = []
    elif name == "target":
        changed |= {"kind": "joint_velocity", "value": [3.0] * len(fields["value"])}
    elif name == "joints":
        changed["position"] = [0.0] * len(fields["position"])
    elif name == "echo":
        changed["held_ns"] = 0
    elif "speed_limit" in fields:
        many = len(fields["speed_limit"])
        changed |= {"zone": "green", "speed_limit": [3.0] * many, "speed_scaling": 1.0, "reasons": []}
    elif "velocity" in fields:
        changed |= {"zone": "green", "velocity": [3.0] * len(fields["velocity"])}
    return changed

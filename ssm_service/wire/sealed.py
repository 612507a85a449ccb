"""From bytes and their attachment to a message whose checksum is right."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Generic, TypeVar

import msgspec

from ..errors import InputError
from .decode import Decoder
from .integrity import Attachment, Heard, parsed, verify
from .messages import MAX_PAYLOAD, Message

M = TypeVar("M", bound=Message)


class _Head(msgspec.Struct, frozen=True):
    """What the checksum needs of a message, whatever else is in it or wrong with it."""

    producer: str = ""
    seq: int = 0


_HEAD = msgspec.json.Decoder(_Head)


@dataclass(frozen=True, slots=True)
class Opened(Generic[M]):
    """A message that may be believed to be what its producer sent.

    Attributes:
        message: The message.
        sealed: Whether it had a checksum.
        after: The tick that its sender had heard before it was made, where it says one.
    """

    message: M
    sealed: bool
    after: Heard | None


class SealedDecoder(Generic[M]):
    """Decodes one kind of message on one key, and checks it against its attachment.

    What cannot be decoded is told apart by the checksum: where that is right, the sender has made a mistake
    (``not_finite``, ``unknown_field``, …); where it is wrong, the message is ``corrupt``.

    Args:
        kind: The message's type. One without ``producer`` and ``seq`` counts as from '' with 0.
        key: The key that it is expected on.
        limit: Greatest payload [bytes].
    """

    def __init__(self, kind: type[M], key: str, limit: int = MAX_PAYLOAD) -> None:
        self.key = key
        self._limit = limit
        self._decoder: Decoder[M] = Decoder(kind, limit)

    def decode(self, payload: bytes, attachment: bytes | None, *, required: bool) -> Opened[M]:
        """Return the message.

        Args:
            payload: The bytes that came.
            attachment: What came with them.
            required: Whether it must have a checksum.

        Raises:
            InputError: As ``integrity.opened`` and ``Decoder.decode`` say.
        """
        if len(payload) > self._limit:
            found, allowed = f"{len(payload)} bytes", f"at most {self._limit} bytes"
            raise InputError("too_large", "payload", found, allowed, fault="insertion")
        said = parsed(attachment, required=required)
        try:
            message = self._decoder.decode(payload)
        except InputError:
            if said is not None:
                self._verify_head(said, payload)
            raise
        if said is None:
            return Opened(message, False, None)
        producer, seq = getattr(message, "producer", ""), getattr(message, "seq", 0)
        verify(said, self.key, producer, seq, payload)
        return Opened(message, True, said.heard)

    def _verify_head(self, said: Attachment, payload: bytes) -> None:
        try:
            head = _HEAD.decode(payload)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            head = _lenient_head(payload)
        verify(said, self.key, head.producer, head.seq, payload)


def _lenient_head(payload: bytes) -> _Head:
    """Return the head of what is no JSON, but what some drivers write: NaN, or numbers beyond all doubles."""
    try:
        return msgspec.convert(json.loads(payload), _Head)
    except (ValueError, RecursionError, msgspec.MsgspecError):
        return _Head()  # no producer of ours has an empty name, so this fits no message of theirs

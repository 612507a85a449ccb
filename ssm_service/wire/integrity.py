r"""The checksum that goes with a message, and the faults of transmission that are told apart.

Every message may carry an attachment, ``crc32=1a2b3c4d`` or ``crc32=1a2b3c4d;after=PRODUCER/SEQ``. The
checksum is CRC-32 (ISO-HDLC, the one of Ethernet and zlib) of ``key\nproducer\nseq\nafter\n`` in UTF-8,
followed by the payload as it is sent. ``after`` is empty where there is none; answers to queries that have no
producer of their own count as ``producer`` empty and ``seq`` 0. ``after`` names a tick of the service that
the sender had heard *before* it made the message, so the message is no older than that tick.

The faults are those of the black channel, IEC 61784-3. What of the network, TLS or Zenoh does is not
credited; each fault is found by what the message itself says:

============== ===================================================== ================== ==================
fault          found by                                              cause              then
============== ===================================================== ================== ==================
corruption     the checksum                                          ``corrupt``,       refused, counted
                                                                     ``bad_attachment``
repetition     ``seq`` is that of the last message accepted          ``old_seq``        refused, counted
sequence       ``seq`` is below that of the last message accepted    ``old_seq``        refused, counted
loss           a gap in ``seq``                                      –                  counted as ``lost``;
                                                                                        the source ages
delay          the age since the tick named in ``after``, or the     ``unproved``       the source is stale
               consumer's round trip; without either, only pauses
               between messages show
insertion      another ``producer`` while the known one is fresh;    ``second_producer``, refused, counted
               a delete; more than a message can hold                ``not_put``,
                                                                     ``too_large``
masquerade     no checksum where one is due                          ``missing_crc``    refused, counted
addressing     the key within the checksum (seen as ``corrupt``),    ``corrupt``,       refused, counted
               the schema in the encoding, the robot's name          ``wrong_encoding``,
                                                                     ``wrong_robot``
============== ===================================================== ================== ==================

A checksum is no signature: who may send at all is the business of certificates and access control. What
remains undetected, and under which assumption, is in ``residual`` and in ``INTEGRITY.md`` beside it.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass

from ..errors import InputError

MAX_ATTACHMENT = 512
"""Greatest attachment [bytes]; a longer one is none of ours."""

_FORM = re.compile(r"crc32=([0-9a-fA-F]{8})(?:;after=((.{1,64})/([0-9]{1,19})))?", re.DOTALL)
_ALLOWED = "crc32=XXXXXXXX or crc32=XXXXXXXX;after=PRODUCER/SEQ"


@dataclass(frozen=True, slots=True)
class Heard:
    """A tick of the service that a sender had heard.

    Attributes:
        producer: The service's.
        seq: The tick's.
    """

    producer: str
    seq: int

    def __str__(self) -> str:
        return f"{self.producer}/{self.seq}"


@dataclass(frozen=True, slots=True)
class Attachment:
    """What an attachment says, before it is known to be true.

    Attributes:
        crc: The checksum that it names.
        after: Its ``after`` as it is written; empty where there is none.
        heard: The same, understood.
    """

    crc: int
    after: str
    heard: Heard | None


def seal(key: str, producer: str, seq: int, payload: bytes, after: Heard | None = None) -> bytes:
    """Return the attachment for a message.

    Args:
        key: The key that it is sent to.
        producer: Its producer.
        seq: Its sequence number.
        payload: The bytes that are sent.
        after: A tick of the service that was heard before the message was made.
    """
    if after is None:
        return b"crc32=%08x" % checksum(key, producer, seq, "", payload)
    text = str(after)
    return f"crc32={checksum(key, producer, seq, text, payload):08x};after={text}".encode()


def opened(
    key: str, producer: str, seq: int, payload: bytes, attachment: bytes | None, *, required: bool
) -> Heard | None:
    """Check a message against its attachment.

    Args:
        key: The key that it was expected on.
        producer: Its producer.
        seq: Its sequence number.
        payload: The bytes that came.
        attachment: What came with them.
        required: Whether it must have a checksum. One that is there is always checked.

    Returns:
        The tick that its sender had heard before, where it says one.

    Raises:
        InputError: ``missing_crc``, ``bad_attachment`` or ``corrupt``.
    """
    said = parsed(attachment, required=required)
    if said is None:
        return None
    verify(said, key, producer, seq, payload)
    return said.heard


def parsed(attachment: bytes | None, *, required: bool) -> Attachment | None:
    """Return what an attachment says; ``None`` where there is none and none is due.

    Raises:
        InputError: ``missing_crc`` or ``bad_attachment``.
    """
    if attachment is None:
        if required:
            raise InputError("missing_crc", "attachment", None, _ALLOWED, fault="masquerade")
        return None
    try:
        text = attachment[: MAX_ATTACHMENT + 1].decode()
    except UnicodeDecodeError:
        text = ""
    found = _FORM.fullmatch(text) if len(attachment) <= MAX_ATTACHMENT else None
    if found is None:
        shown = attachment[:80].decode("utf-8", "replace")
        raise InputError("bad_attachment", "attachment", shown, _ALLOWED, fault="corruption")
    crc, after, producer, seq = found.groups()
    return Attachment(int(crc, 16), after or "", None if after is None else Heard(producer, int(seq)))


def verify(said: Attachment, key: str, producer: str, seq: int, payload: bytes) -> None:
    """Refuse a message whose checksum is another one than its attachment says.

    Raises:
        InputError: ``corrupt``.
    """
    crc = checksum(key, producer, seq, said.after, payload)
    if crc != said.crc:
        raise InputError(
            "corrupt", "attachment", f"crc32={said.crc:08x}", f"crc32={crc:08x}", fault="corruption"
        )


def checksum(key: str, producer: str, seq: int, after: str, payload: bytes) -> int:
    """Return the CRC-32 of a message and of what it must not be mistaken in."""
    # Half a surrogate pair is no text, but nothing from outside may raise anything but a refusal.
    head = f"{key}\n{producer}\n{seq}\n{after}\n".encode("utf-8", "surrogatepass")
    return zlib.crc32(payload, zlib.crc32(head))

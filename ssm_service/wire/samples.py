"""What Zenoh delivers, before it is read."""

from __future__ import annotations

import zenoh

from ..errors import InputError
from .messages import Message, encoding_of, names_another


def check_sample(sample: zenoh.Sample, kind: type[Message]) -> None:
    """Refuse what is no message of a kind, or is said to be another one.

    Raises:
        InputError: ``not_put`` or ``wrong_encoding``.
    """
    if sample.kind != zenoh.SampleKind.PUT:
        raise InputError("not_put", "sample", "a delete", "a put", fault="insertion")
    encoding = str(sample.encoding)
    if names_another(encoding, kind):
        allowed = f"{encoding_of(kind)}, or no schema"
        raise InputError("wrong_encoding", "encoding", encoding, allowed, fault="addressing")


def attachment_of(sample: zenoh.Sample) -> bytes | None:
    """Return the attachment of a sample, if it has one."""
    return None if sample.attachment is None else sample.attachment.to_bytes()

"""Questions to a running service."""

from __future__ import annotations

import time
from dataclasses import dataclass

import msgspec
import zenoh

from ..errors import NoServiceError, ServiceError
from ..wire import attachment_of
from ..wire import messages as m
from .connection import Connection

AGAIN_S = 0.05
"""Between two attempts while nobody answers [s]: a service may be just starting."""


@dataclass(frozen=True, slots=True)
class Answer:
    """One answer as it came.

    Attributes:
        payload: Its bytes.
        attachment: Their checksum, if it has one.
    """

    payload: bytes
    attachment: bytes | None


def ask(
    connection: Connection,
    key: str,
    *,
    patience_s: float,
    timeout_s: float | None = None,
    payload: bytes | None = None,
) -> list[Answer]:
    """Return the good answers to a query; one or more.

    Args:
        connection: The connection.
        key: Key of the query.
        patience_s: Time for connecting, and for trying again while nobody is there [s].
        timeout_s: Time for an answer [s], where it may take longer than ``patience_s``.
        payload: JSON, if the query has any.

    Raises:
        NoServiceError: Nobody answered.
        ServiceError: Somebody answered with an error.
    """
    deadline = time.monotonic() + patience_s
    session = connection.wait(patience_s)
    while True:
        left = max(deadline - time.monotonic(), 0.001)
        answers = _once(session, key, left if timeout_s is None else timeout_s, payload)
        if answers:
            connection.answered()
            return answers
        if deadline - time.monotonic() <= AGAIN_S:
            connection.unanswered(session)
            raise NoServiceError(f"nobody answered {key} within {timeout_s or patience_s:g} s")
        time.sleep(AGAIN_S)


def _once(session: zenoh.Session, key: str, timeout_s: float, payload: bytes | None) -> list[Answer]:
    try:
        replies = session.get(
            key,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
            payload=payload,
            encoding=None if payload is None else "application/json",
        )
        answers: list[Answer] = []
        errors: list[str] = []
        for reply in replies:
            if reply.ok is not None:
                answers.append(Answer(reply.ok.payload.to_bytes(), attachment_of(reply.ok)))
            elif reply.err is not None:
                errors.append(_text(reply.err.payload.to_bytes()))
    except zenoh.ZError as error:
        raise ServiceError(f"the query {key} could not be sent: {error}") from error
    errors = [text for text in errors if text != "Timeout"]  # Zenoh's own word for 'nobody answered in time'
    if errors and not answers:
        raise ServiceError(errors[0])
    return answers


def _text(payload: bytes) -> str:
    try:
        return msgspec.json.decode(payload, type=m.EvaluateError).error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return payload[:500].decode("utf-8", "replace")

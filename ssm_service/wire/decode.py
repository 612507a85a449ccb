"""From bytes to messages, or one clear refusal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
import msgspec.inspect

from ..config.check import DocumentCheck
from ..config.describe import Place
from ..errors import ConfigError, InputError
from .messages import MAX_PAYLOAD, Message

M = TypeVar("M", bound=Message)

_CAUSES = (
    ("missing required field", "missing_field"),
    ("unknown field", "unknown_field"),
    ("Invalid enum value", "unknown_word"),
    ("got `null`", "wrong_type"),
    (", got `", "wrong_type"),
    ("of length", "wrong_length"),
    ("`int` >=", "out_of_range"),
    ("`int` <=", "out_of_range"),
    ("out of range", "out_of_range"),
)


class Decoder(Generic[M]):
    """Decodes one kind of message strictly.

    Args:
        kind: The message's type.
        limit: Greatest payload [bytes].
        explain: Whether a refusal names the very value and what may stand there. That takes about
            0.1 ms, which whoever drains a flood cannot afford.
    """

    def __init__(self, kind: type[M], limit: int = MAX_PAYLOAD, *, explain: bool = False) -> None:
        self._kind = kind
        self._explain = explain
        self._limit = limit
        self._decoder = msgspec.json.Decoder(kind)

    def decode(self, payload: bytes) -> M:
        """Return the message.

        Raises:
            InputError: With the cause ``too_large``, ``not_json``, ``missing_field``, ``unknown_field``,
                ``unknown_word``, ``unknown_shape``, ``wrong_type``, ``wrong_length`` or ``out_of_range``.
        """
        if len(payload) > self._limit:
            raise InputError("too_large", "payload", f"{len(payload)} bytes", f"at most {self._limit} bytes")
        try:
            return self._decoder.decode(payload)
        except msgspec.ValidationError as error:
            raise self._refusal(payload, str(error)) from error
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise InputError("not_json", "payload", str(error), "one JSON object in UTF-8") from error

    def _refusal(self, payload: bytes, text: str) -> InputError:
        what, _, place = text.partition(" - at `$")
        what, where = _cut(what), _cut(place.rstrip("`").lstrip(".")) or self._kind.__name__
        cause = next((cause for phrase, cause in _CAUSES if phrase in what), "wrong_type")
        if cause == "unknown_word" and where.endswith("shape"):
            cause = "unknown_shape"
        if self._explain and (explained := _explained(cause, where, payload, self._kind)):
            return explained
        return InputError(cause, where, _shorten(payload), what.removeprefix("Expected "))


def _explained(cause: str, where: str, payload: bytes, kind: type[Message]) -> InputError | None:
    """Return the refusal in the words of the configuration's check, if it finds the same place."""
    try:
        DocumentCheck(Path()).check(msgspec.json.decode(payload), msgspec.inspect.type_info(kind), Place())
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, OverflowError):
        return None  # a number that no double can hold, say
    except ConfigError as error:
        if where == kind.__name__ or error.key.startswith(where):
            return InputError(cause, _cut(error.key) or where, error.found, _cut(error.allowed))
    return None


def _cut(text: str, limit: int = 300) -> str:
    """Return a text that may hold a sender's own words, such as the name of an unknown field, cut short."""
    return text if len(text) <= limit else text[: limit - 1] + "…"


def _shorten(payload: bytes) -> str:
    text = payload[:80].decode("utf-8", "replace")
    return text + ("…" if len(payload) > 80 else "")


def all_finite(value: Any) -> bool:
    """Tell whether every number inside plain JSON values is finite."""
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, dict):
        return all(map(all_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(all_finite, value))
    return True

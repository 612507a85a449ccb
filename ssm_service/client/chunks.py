"""Many ``evaluate`` inputs in queries of bearable size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from ..errors import InputError, ServiceError
from ..wire import all_finite
from ..wire import messages as m

CHUNK_INPUTS = 32
"""Greatest number of inputs in one query."""

CHUNK_OBSTACLES = 256
"""Greatest number of obstacles in one query: an answer has a pair for each link and obstacle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """One query's worth.

    Attributes:
        payload: A JSON list.
        count: Its length.
    """

    payload: bytes
    count: int


def encoded(value: Any, where: str = "payload") -> bytes:
    """Return a value as JSON; arrays as lists, what is ``None`` in a mapping left out.

    Raises:
        InputError: ``not_finite``: JSON would make it a ``null``, and in a reading that means 'no echo'.
            ``wrong_type``: It has no form in JSON.
    """
    try:
        plain = msgspec.to_builtins(value, enc_hook=_plain)
    except (TypeError, NotImplementedError) as error:
        raise InputError("wrong_type", where, repr(value), "what JSON can say") from error
    if not all_finite(plain):
        raise InputError("not_finite", where, value, "finite numbers or null")
    if isinstance(plain, dict):
        plain = {key: entry for key, entry in plain.items() if entry is not None}
    return msgspec.json.encode(plain)


def chunks(inputs: Sequence[Mapping[str, Any] | m.EvaluateInput]) -> Iterator[Chunk]:
    """Yield the inputs in order, in chunks; one with very many obstacles makes a chunk of its own.

    Raises:
        InputError: As ``encoded`` says, with the input's index.
    """
    lines: list[bytes] = []
    obstacles = 0
    for index, entry in enumerate(inputs):
        line = encoded(entry if isinstance(entry, m.EvaluateInput) else dict(entry), f"inputs[{index}]")
        count = _obstacles(entry)
        if lines and (len(lines) >= CHUNK_INPUTS or obstacles + count > CHUNK_OBSTACLES):
            yield _chunk(lines)
            lines, obstacles = [], 0
        lines.append(line)
        obstacles += count
    if lines:
        yield _chunk(lines)


def outputs(answer: bytes, count: int) -> list[m.EvaluateOutput | m.EvaluateError]:
    """Return the outputs in an answer.

    Raises:
        ServiceError: It is not a list of ``count`` of them.
    """
    try:
        lines = msgspec.json.decode(answer, type=list[msgspec.Raw])
        if len(lines) != count:
            raise ServiceError(f"evaluate answered {len(lines)} of {count} inputs")
        return [_output(line) for line in lines]
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ServiceError(f"evaluate answered with something malformed: {error}") from error


def _output(line: msgspec.Raw) -> m.EvaluateOutput | m.EvaluateError:
    try:
        return msgspec.json.decode(line, type=m.EvaluateError)
    except msgspec.ValidationError:
        return msgspec.json.decode(line, type=m.EvaluateOutput)


def _chunk(lines: list[bytes]) -> Chunk:
    return Chunk(payload=b"[" + b",".join(lines) + b"]", count=len(lines))


def _obstacles(entry: Mapping[str, Any] | m.EvaluateInput) -> int:
    obstacles = entry.obstacles if isinstance(entry, m.EvaluateInput) else entry.get("obstacles")
    return len(obstacles) if isinstance(obstacles, list | tuple) else 0


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise NotImplementedError(f"{type(value).__name__} has no form in JSON")

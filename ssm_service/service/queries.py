"""Queries are answered between ticks from stored replies."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import zenoh

from ..wire import Keys, encoding_of
from ..wire import messages as m

CHANNEL_CAPACITY = 256
JSON = "application/json"


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer.

    Attributes:
        payload: Its bytes.
        encoding: Their encoding.
        attachment: Their checksum.
    """

    payload: bytes
    encoding: str
    attachment: bytes


class StoredReplies:
    """Queryables whose answers are bytes that lie ready.

    No Python runs on Zenoh's threads: queries wait in bounded channels, and ``serve`` answers them while the
    loop has nothing else to do. A flood of queries waits, or is dropped; it never delays a tick.

    Args:
        session: The Zenoh session.
        keys: The robot's keys.
        replies: For each key name, what to answer, made when asked.
        by_name: Those that do something when asked; a query for a wider key is not for them.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        replies: dict[str, Callable[[], Reply]],
        by_name: frozenset[str] = frozenset(),
    ) -> None:
        self.answered: Counter[str] = Counter(dict.fromkeys(replies, 0))
        self._replies = replies
        self._by_name = by_name
        self._keys = {name: keys.output(name) for name in replies}
        self._queryables = {
            name: session.declare_queryable(key, zenoh.handlers.RingChannel(CHANNEL_CAPACITY))
            for name, key in self._keys.items()
        }

    def serve(self, until_ns: int) -> None:
        """Answer what waits, one query of each key in turn, until ``until_ns`` [monotonic ns] at most."""
        waiting = True
        while waiting:
            waiting = False
            for name, queryable in self._queryables.items():
                if time.monotonic_ns() >= until_ns:
                    return
                query = queryable.handler.try_recv()
                if query is not None:
                    waiting = True
                    self._answer(name, query)

    def _answer(self, name: str, query: zenoh.Query) -> None:
        key = self._keys[name]
        with query:
            if name in self._by_name and str(query.key_expr) != key:
                text = f"{key} answers only who asks for it by this name"
                query.reply_err(
                    msgspec.json.encode(m.EvaluateError(error=text)), encoding=encoding_of(m.EvaluateError)
                )
                return
            reply = self._replies[name]()
            query.reply(
                key,
                reply.payload,
                encoding=reply.encoding,
                attachment=reply.attachment,
                express=True,
                priority=zenoh.Priority.REAL_TIME,
            )
        self.answered[name] += 1

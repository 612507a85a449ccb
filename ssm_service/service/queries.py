"""Queries are answered between ticks from stored replies."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

import zenoh

from ..wire import Keys

CHANNEL_CAPACITY = 256
JSON = "application/json"


class StoredReplies:
    """Queryables whose answers are bytes that lie ready.

    No Python runs on Zenoh's threads: queries wait in bounded channels, and ``serve`` answers them while the
    loop has nothing else to do. A flood of queries waits, or is dropped; it never delays a tick.

    Args:
        session: The Zenoh session.
        keys: The robot's keys.
        replies: For each key name, what to answer: ``(payload, encoding)``, made when asked.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        replies: dict[str, Callable[[], tuple[bytes, str]]],
    ) -> None:
        self.answered: Counter[str] = Counter(dict.fromkeys(replies, 0))
        self._replies = replies
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
        payload, encoding = self._replies[name]()
        with query:
            query.reply(
                self._keys[name], payload, encoding=encoding, express=True, priority=zenoh.Priority.REAL_TIME
            )
        self.answered[name] += 1

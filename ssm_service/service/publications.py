"""When each tick was published: what proves ages and measures the transport."""

from __future__ import annotations

from ..wire import Heard

KEPT = 16_384
"""Ticks whose publication is remembered: 16 s at the highest rate, longer than any source's timeout."""


class Publications:
    """The times at which the last ticks were published.

    Args:
        producer: This service's random id.
        started_ns: A time before the first publication, monotonic [ns].
    """

    def __init__(self, producer: str, started_ns: int) -> None:
        self._producer = producer
        self._started_ns = started_ns
        self._times = [started_ns] * KEPT
        self._newest = -1

    def add(self, seq: int, now_ns: int) -> None:
        """Note that a tick is about to be published.

        Args:
            seq: The tick's; it rises.
            now_ns: A time before its publication, monotonic [ns].
        """
        self._times[seq % KEPT] = now_ns
        self._newest = seq

    def time_of(self, heard: Heard) -> int | None:
        """Return a time before a tick was published, monotonic [ns].

        ``None`` where it is none of this service's: of an earlier run, or never published. For a tick that is
        no longer remembered it is the service's start.
        """
        if heard.producer != self._producer or heard.seq > self._newest:
            return None
        if heard.seq <= self._newest - KEPT:
            return self._started_ns
        return self._times[heard.seq % KEPT]

"""How often something happens, and when it is time for the next line."""

from __future__ import annotations

import time
from collections import deque

WINDOW_S = 1.0
"""Time over which a rate is measured [s]."""


class RateMeter:
    """Measures a producer's decisions a second by how far its ``seq`` advances.

    A consumer looks at the newest decision whenever it can, so the number of its looks says nothing.
    """

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int]] = deque()
        self._producer = ""

    def add(self, now: float, seq: int, producer: str = "") -> None:
        """Note which decision is the newest now [s]; another producer, or a lower ``seq``, begins anew."""
        if producer != self._producer or (self._seen and seq < self._seen[-1][1]):
            self._seen.clear()
            self._producer = producer
        self._seen.append((now, seq))

    def rate(self, now: float) -> float | None:
        """Return decisions a second [1/s] over the last second; ``None`` where not measured."""
        while self._seen and now - self._seen[0][0] > WINDOW_S:
            self._seen.popleft()
        if len(self._seen) < 2:
            return None
        (first_t, first_seq), (last_t, last_seq) = self._seen[0], self._seen[-1]
        return (last_seq - first_seq) / (last_t - first_t) if last_t > first_t else None


class Ticker:
    """Says when it is time for the next line."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next = time.monotonic()

    def due(self) -> bool:
        """Tell whether it is time; once for each period."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + self._period_s
        return True

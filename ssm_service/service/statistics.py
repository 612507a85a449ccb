"""Counters and timings of a running service."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import numpy as np

WINDOW = 5000
"""Ticks over which percentiles are taken."""


class Timings:
    """The last ``WINDOW`` durations, for percentiles; adding one costs no allocation."""

    def __init__(self) -> None:
        self._values = np.zeros(WINDOW, dtype=np.int64)
        self._count = 0

    def add(self, duration_ns: int) -> None:
        """Add a duration [ns]."""
        self._values[self._count % WINDOW] = duration_ns
        self._count += 1

    def summary(self) -> dict[str, float]:
        """Return p50, p99 and max [µs] over the window; empty before the first."""
        if self._count == 0:
            return {}
        values = self._values[: min(self._count, WINDOW)]
        p50, p99 = np.percentile(values, [50, 99]).tolist()
        return {"p50": p50 / 1e3, "p99": p99 / 1e3, "max": int(values.max()) / 1e3}


class Rejections:
    """Refused messages by source and cause, and the last refusal of each source in words."""

    def __init__(self) -> None:
        self.counts: dict[str, Counter[str]] = {}
        self.last: dict[str, str] = {}

    def add(self, source: str, cause: str, text: str) -> None:
        """Count one refusal."""
        self.counts.setdefault(source, Counter())[cause] += 1
        self.last[source] = text[:300]


def resident_bytes() -> int | None:
    """Return this process's resident memory [bytes]; ``None`` where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")

"""Reads the log of a soak run, also one that was cut off, and puts it into series."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .soak_rig import ROLES, SAMPLES

Event = dict[str, Any]

AFTERMATH_S = 1.5
"""How long after a fault its traces may still be seen."""

HELD_UP_S = 0.02
"""Who did not come to its turn for so long was held up by the machine [s]: a decision is valid for this."""


@dataclass(kw_only=True)
class Life:
    """One process from its start to its end.

    Attributes:
        role: What it is.
        pid: Its number.
        t: (n,), when it was looked at [s].
        rss: (n,), resident memory [bytes].
        fds: (n,), descriptors.
        threads: (n,).
    """

    role: str
    pid: int
    t: NDArray[np.float64]
    rss: NDArray[np.float64]
    fds: NDArray[np.float64]
    threads: NDArray[np.float64]


@dataclass(kw_only=True)
class Run:
    """One run.

    Attributes:
        settings: As it was started; empty where the log was cut off before.
        events: All lines by kind, in order of time.
        end: Of the log [s].
    """

    settings: Event = field(default_factory=dict)
    events: dict[str, list[Event]] = field(default_factory=dict)
    end: float = 0.0

    @property
    def lives(self) -> list[Life]:
        """Every process that was looked at."""
        found: dict[tuple[str, int], list[tuple[float, ...]]] = defaultdict(list)
        for sample in self.events.get("sample", []):
            for role in ROLES:
                seen = sample.get(role)
                if seen:
                    row = (sample["t"], seen["rss"], seen["fds"], seen["threads"])
                    found[role, seen["pid"]].append(row)
        return [
            Life(
                role=role, pid=pid, **dict(zip(("t", "rss", "fds", "threads"), np.array(rows).T, strict=True))
            )
            for (role, pid), rows in found.items()
        ]

    def windows(self, *words: str) -> list[tuple[float, float]]:
        """Return when faults were done whose name begins with one of the words, with their aftermath [s]."""
        return [
            (fault["t"], fault["t"] + fault["ended"] + AFTERMATH_S)
            for fault in self.events.get("fault", [])
            if not words or fault["what"].startswith(words)
        ]

    def quiet(self, t: NDArray[np.float64], *, margin_s: float = 3.0) -> NDArray[np.bool_]:
        """Tell at which times nothing was done, nor shortly before, and nobody had just been started."""
        calm = np.ones(len(t), dtype=np.bool_)
        starts = [(start["t"], start["t"] + 2 * margin_s) for start in self.events.get("start", [])]
        for begin, end in [*self.windows(), *starts]:
            calm &= (t < begin) | (t > end + margin_s)
        return calm


def read(folder: Path) -> Run:
    """Read the log of a run; a last line that was cut off is left out."""
    run = Run()
    events: dict[str, list[Event]] = defaultdict(list)
    with (folder / SAMPLES).open(encoding="utf-8") as lines:
        for line in lines:
            try:
                event = json.loads(line)
            except ValueError:
                continue
            events[event.pop("kind")].append(event)
            run.end = max(run.end, event["t"])
    run.events = {kind: sorted(found, key=lambda event: event["t"]) for kind, found in events.items()}
    run.settings = {key: value for event in events["settings"] for key, value in event.items() if key != "t"}
    return run


def within(t: float, windows: list[tuple[float, float]]) -> bool:
    """Tell whether a time lies in one of the windows."""
    return any(begin <= t <= end for begin, end in windows)

"""Draws a soak run over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .soak_rig import ROLES
from .soak_samples import Run, within

COLOURS = dict(zip(ROLES, ("C0", "C1", "C2", "C4"), strict=True))


def draw(run: Run, path: Path) -> None:
    """Draw tick times, overruns, memory, descriptors and gaps over time into ``path``."""
    from matplotlib.figure import Figure

    shown = Figure(figsize=(10.0, 11.0), layout="constrained")
    panels = shown.subplots(5, 1, sharex=True)
    for axes, panel in zip(panels, (_ticks, _overruns, _memory, _descriptors, _gaps), strict=True):
        for begin, end in run.windows():
            axes.axvspan(begin / 60.0, end / 60.0, color="0.5", alpha=0.15, linewidth=0)
        panel(axes, run)
        axes.grid(alpha=0.3)
    panels[-1].set_xlabel("time [min]; grey: a fault was being done")
    shown.savefig(path, dpi=120)


def _series(run: Run, kind: str, *keys: str) -> tuple[Any, Any]:
    rows = []
    for event in run.events.get(kind, []):
        value: Any = event
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        if value is not None:
            rows.append((event["t"] / 60.0, float(value)))
    made = np.array(rows).reshape(-1, 2)
    return made[:, 0], made[:, 1]


def _ticks(axes: Any, run: Run) -> None:
    for name, style in (("p50", "-"), ("p99", "-"), ("max", ":")):
        axes.plot(*_series(run, "health", "tick_us", name), style, label=f"tick {name}")
        axes.plot(*_series(run, "health", "lateness_us", name), style, alpha=0.5, label=f"lateness {name}")
    axes.set(yscale="log", ylabel="[µs], last 5000 ticks")
    axes.legend(fontsize=7, ncols=3)


def _overruns(axes: Any, run: Run) -> None:
    axes.plot(*_series(run, "health", "overruns"), label="overruns, by the service")
    axes.plot(*_series(run, "health", "skipped"), label="skipped deadlines")
    axes.plot(
        *_series(run, "consumer", "overruns"), "--", label="'overrun' heard, since each consumer's start"
    )
    axes.set(ylabel="count", yscale="symlog")
    axes.legend(fontsize=7)


def _memory(axes: Any, run: Run) -> None:
    for life in run.lives:
        axes.plot(life.t / 60.0, life.rss / 2**20, color=COLOURS[life.role])
    _roles(axes, "memory [MiB]")


def _descriptors(axes: Any, run: Run) -> None:
    for life in run.lives:
        axes.plot(life.t / 60.0, life.fds, color=COLOURS[life.role])
        axes.plot(life.t / 60.0, life.threads, ":", color=COLOURS[life.role])
    _roles(axes, "descriptors; dotted: threads")


def _roles(axes: Any, label: str) -> None:
    for role, colour in COLOURS.items():
        axes.plot([], [], color=colour, label=role)
    axes.set(ylabel=label)
    axes.legend(fontsize=7, ncols=4)


def _gaps(axes: Any, run: Run) -> None:
    hindered = run.windows("stop consumer", "kill consumer", "kill service")
    for stopped, colour in ((True, "0.6"), (False, "C3")):
        gaps = [gap for gap in run.events.get("gap", []) if within(gap["t"], hindered) is stopped]
        missed = [gap["next"] - gap["after"] - 1 for gap in gaps]
        label = "gaps while the consumer was stopped" if stopped else "gaps besides"
        axes.plot([gap["t"] / 60.0 for gap in gaps], missed, ".", color=colour, label=label)
    axes.plot(*_series(run, "consumer", "pause_s"), color="C2", alpha=0.4, label="its longest pause [s]")
    axes.set(ylabel="ticks missed", yscale="symlog")
    axes.legend(fontsize=7)

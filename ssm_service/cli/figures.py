"""Figures of a recording: distance, joint speeds, the end effector's path, and the service's timing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model import Robot
from ..safety import Zone
from .figure_events import mark_events
from .figure_path import draw_path
from .palette import BAND, LINES
from .recording import Recording
from .words import FIGURES

WIDTH_IN: Final = 9.6
DPI: Final = 150
STYLE: Final[dict[str, Any]] = {
    "font.size": 10.0,
    "axes.titlesize": 12.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": "#333333",
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "figure.constrained_layout.use": True,
    "savefig.facecolor": "white",
}


class Run(NamedTuple):
    """A stretch of time [s] in one zone."""

    zone: Zone
    start: float
    end: float


def prepare() -> None:
    """Load matplotlib now; its very first start builds a font cache, which takes a while."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot


def write_figures(folder: Path, recording: Recording, robot: Robot) -> list[str]:
    """Write all figures into a folder and return their names."""
    prepare()
    import matplotlib.pyplot as plt

    drawings: tuple[Callable[[Recording, Robot], Any], ...] = (_distance, _speeds, draw_path, _ticks)
    with plt.style.context(["default", STYLE]):
        for name, drawing in zip(FIGURES, drawings, strict=True):
            figure = drawing(recording, robot)
            figure.savefig(folder / name, dpi=DPI)
            plt.close(figure)
    return list(FIGURES)


def zone_runs(recording: Recording) -> Iterator[Run]:
    """Yield the stretches of one zone each; a decision holds until the next one arrives."""
    rows = recording.decisions
    start = 0
    for i in range(1, len(rows) + 1):
        if i == len(rows) or rows[i].zone is not rows[start].zone:
            end = recording.seconds if i == len(rows) else rows[i].t
            yield Run(rows[start].zone, rows[start].t, end)
            start = i


def _bands(axes: Any, recording: Recording) -> None:
    for run in zone_runs(recording):
        axes.axvspan(run.start, run.end, color=BAND[run.zone], linewidth=0, zorder=0)
    axes.set_xlim(0.0, recording.seconds)
    axes.grid(axis="y", color="white", linewidth=0.8, zorder=1)
    axes.set_axisbelow(False)
    axes.tick_params(length=3)


def _zone_patches(recording: Recording) -> list[Any]:
    from matplotlib.patches import Patch

    seen = {row.zone for row in recording.decisions}
    return [
        Patch(facecolor=BAND[zone], edgecolor="#999999", linewidth=0.5, label=zone.word)
        for zone in Zone
        if zone in seen
    ]


def _legend(axes: Any, recording: Recording) -> None:
    """Put lines and zones into one legend above the axes, out of the data's way."""
    lines, _ = axes.get_legend_handles_labels()
    axes.legend(
        handles=[*lines, *_zone_patches(recording)],
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=5,
        columnspacing=1.2,
        handlelength=1.6,
        borderaxespad=0.2,
    )


def _optional(values: list[float | None]) -> NDArray[np.float64]:
    """Return values with gaps where there is none: matplotlib leaves them out."""
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


def _distance(recording: Recording, robot: Robot) -> Any:
    import matplotlib.pyplot as plt

    rows = recording.decisions
    times = np.array([row.t for row in rows])
    exact, estimated = _optional([row.exact for row in rows]), _optional([row.estimated for row in rows])
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 4.4))
    _bands(axes, recording)
    profile = robot.config.file.profiles.get(recording.profile)
    if profile is not None:
        for edge in profile.edges:
            axes.axhline(edge, color="#333333", linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
            axes.annotate(
                f"{edge:g} m", (1.0, edge), xycoords=("axes fraction", "data"), xytext=(4, 0),
                textcoords="offset points", va="center", fontsize=9, color="#333333",
            )  # fmt: skip
    axes.plot(times, exact, color=LINES[0], linewidth=2.0, label="exact (tracked obstacles)", zorder=4)
    axes.plot(times, estimated, color=LINES[1], linewidth=1.6, label="estimated (sensor ring)", zorder=3)
    if not (np.isfinite(exact).any() or np.isfinite(estimated).any()):
        axes.text(0.5, 0.5, "nothing was seen", transform=axes.transAxes, ha="center", color="#555555")
    axes.set_ylim(bottom=min(0.0, _lowest(exact)))
    mark_events(axes, recording)
    axes.set(title="Distance", xlabel="time [s]", ylabel="least distance [m]")
    _legend(axes, recording)
    return figure


def _lowest(values: NDArray[np.float64]) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.min()) - 0.02 if len(finite) else 0.0


def _speeds(recording: Recording, robot: Robot) -> Any:
    import matplotlib.pyplot as plt

    free = robot.free.tolist()
    joints, decisions = recording.joints, recording.decisions
    state_times = np.array([row.t for row in joints])
    speeds = np.array([row.velocity for row in joints]).reshape(len(joints), -1)
    times = np.array([row.t for row in decisions])
    limits = np.array([row.limit for row in decisions]).reshape(len(decisions), -1)
    figure, grid = plt.subplots(
        len(free), 1, figsize=(WIDTH_IN, 1.2 + 1.7 * len(free)), sharex=True, squeeze=False
    )
    for axes, index in zip(grid[:, 0], free, strict=True):
        _bands(axes, recording)
        top = _speed_scale(speeds[:, index], limits[:, index])
        limit = np.where(limits[:, index] > top, math.nan, limits[:, index])
        label = "limit (beyond the axis in green)" if np.isnan(limit).any() else "limit"
        for sign in (1.0, -1.0):
            name = label if sign > 0.0 else None
            axes.step(times, sign * limit, where="post", color="#222222", linewidth=1.3, label=name, zorder=3)
        axes.plot(state_times, speeds[:, index], color=LINES[0], linewidth=1.4, label="measured", zorder=4)
        axes.set_ylim(-top, top)
        axes.set_ylabel(f"{robot.joint_names[index].removesuffix('_joint')}\n[rad/s]")
    for axes in grid[:, 0]:
        mark_events(axes, recording)
    _legend(grid[0, 0], recording)
    grid[0, 0].set_title("Joint speeds")
    grid[-1, 0].set_xlabel("time [s]")
    return figure


def _speed_scale(speeds: NDArray[np.float64], limits: NDArray[np.float64]) -> float:
    """Return the end of an axis that shows all speeds and the limits of the zones that slow."""
    slowing = limits[limits < limits.max()] if len(limits) and limits.min() < limits.max() else limits
    greatest = [
        float(np.abs(speeds).max()) if len(speeds) else 0.0,
        float(slowing.max()) if len(slowing) else 0.0,
    ]
    return 1.25 * max(*greatest, 0.01)


def _ticks(recording: Recording, _robot: Robot) -> Any:
    import matplotlib.pyplot as plt

    times = np.array([row.t for row in recording.decisions])
    figure, (above, below) = plt.subplots(2, 1, figsize=(WIDTH_IN, 5.4), sharex=True)
    above.plot(times[1:], 1e3 * np.diff(times), ".", markersize=2.0, color=LINES[0], rasterized=True)
    above.set_title("From decision to decision, as a consumer that looks every millisecond saw it")
    above.set(ylabel="[ms]", yscale="log")
    below.set_title("The service's own times, over its last 5000 ticks")
    below.set(ylabel="[µs]", xlabel="time [s]", yscale="log")
    if recording.health:
        period_us = 1e6 / recording.health[-1].health.rate_hz
        above.axhline(1e-3 * period_us, color="#333333", linewidth=0.8, linestyle=(0, (4, 3)))
        below.axhline(period_us, color="#333333", linewidth=0.8, linestyle=(0, (4, 3)), label="period")
        _percentiles(below, recording)
    for axes in (above, below):
        _whole_decades(axes)
        axes.set_xlim(0.0, recording.seconds)
        axes.grid(axis="y", color="#e3e3e3", linewidth=0.8)
        axes.set_axisbelow(True)
    return figure


def _whole_decades(axes: Any) -> None:
    """Let a logarithmic y axis span whole decades, and label these only: others would overlap."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    low, high = (math.log10(value) for value in axes.get_ylim())
    axes.set_ylim(10.0 ** math.floor(low), 10.0 ** math.ceil(high))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _percentiles(axes: Any, recording: Recording) -> None:
    """Draw tick times and lateness; an answer that had measured nothing yet is left out."""
    rows = [row for row in recording.health if row.health.tick_us and row.health.lateness_us]
    asked = [row.t for row in rows]
    for colour, what, field in ((LINES[0], "tick", "tick_us"), (LINES[1], "lateness", "lateness_us")):
        for percentile, style in (("p50", "-"), ("p99", "--")):
            values = [max(getattr(row.health, field)[percentile], 0.1) for row in rows]
            axes.plot(
                asked, values, style, color=colour, linewidth=1.6, marker=".", markersize=4,
                label=f"{what} {percentile}",
            )  # fmt: skip
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))

"""The figures of the sweep: error against gap, polar map, zones, and who sees what."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .common import Row, figure
from .sweep import Arrays
from .triangulation_estimators import BOUNDS
from .triangulation_scenes import GAP_M, Floats
from .triangulation_strata import ZONES

COLOURS = {
    "as_printed": "C7",
    "corrected": "C1",
    "nearest": "C0",
    "sphere_fit": "C2",
    "lower_bound": "C3",
    "lower_bound_tight": "C4",
}
_BINS, _SECTORS, _FEWEST = 25, 72, 20


def draw_all(folder: Path, found: dict[str, Arrays], rows: list[Row], estimators: Sequence[str]) -> None:
    """Write all figures into ``folder``; those of balls are of ideal readings."""
    balls = found["sphere"]
    figure(folder / "triangulation_error.png", 7.0, 4.5, lambda axes: _error(axes, balls, estimators))
    figure(folder / "triangulation_seen.png", 7.0, 4.0, lambda axes: _seen(axes, balls))
    _polar(
        folder / "triangulation_polar.png", balls, [n for n in estimators if n not in ("as_printed", *BOUNDS)]
    )
    _zones(folder / "triangulation_zones.png", rows, estimators)


def _error(axes: Any, found: Arrays, estimators: Sequence[str]) -> None:
    edges = np.linspace(*GAP_M, _BINS + 1)
    for name in estimators:
        quantiles = [_quantiles(found, name, low, high) for low, high in itertools.pairwise(edges)]
        low, middle, high = 1e3 * np.array(quantiles).T
        gaps = 0.5 * (edges[1:] + edges[:-1])
        axes.plot(gaps, middle, color=COLOURS[name], label=name)
        axes.fill_between(gaps, low, high, color=COLOURS[name], alpha=0.15, linewidth=0)
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set(
        xlabel="gap between ring and ball [m]",
        ylabel="estimate less truth [mm]",
        title="Above the line is unsafe. Median, and 5 to 95 % of the answers",
        xlim=(0.0, GAP_M[1]),
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _quantiles(found: Arrays, name: str, low: float, high: float) -> list[float]:
    chosen = (found["gap"] >= low) & (found["gap"] < high) & (found["link"] > 0.0)
    error = (found[f"none.{name}"] - found["link"])[chosen]
    error = error[~np.isnan(error)]
    if len(error) < _FEWEST:
        return [math.nan] * 3
    values: list[float] = np.percentile(error, [5.0, 50.0, 95.0]).tolist()
    return values


def _seen(axes: Any, found: Arrays) -> None:
    edges = np.linspace(*GAP_M, _BINS + 1)
    echoes = found["none.echoes"]
    shares = []
    for low, high in itertools.pairwise(edges):
        inside = echoes[(found["gap"] >= low) & (found["gap"] < high)]
        shares.append([100.0 * float((inside == n).mean()) if len(inside) else math.nan for n in (0, 1)])
    none, one = np.array(shares).T
    middles = 0.5 * (edges[1:] + edges[:-1])
    parts = [none, one, 100.0 - none - one]
    axes.stackplot(
        middles, parts, colors=("0.35", "C0", "C2"), labels=("no sensor", "one", "two or more"), alpha=0.85
    )
    axes.set(
        xlabel="gap between ring and ball [m]",
        ylabel="share of the places [%]",
        title="How many sensors see a ball of 5 cm",
        xlim=(middles[0], middles[-1]),
        ylim=(0.0, 100.0),
    )
    axes.legend(loc="lower left", fontsize=8)


def _polar(path: Path, found: Arrays, estimators: Sequence[str]) -> None:
    """Draw the estimators' maps; the bounds' errors are of another size and in the first figure."""
    from matplotlib.figure import Figure

    if not estimators:
        return
    shown = Figure(figsize=(4.0 * len(estimators), 4.3), layout="constrained")
    every = shown.subplots(1, len(estimators), subplot_kw={"projection": "polar"}, squeeze=False)[0]
    mesh = None
    for axes, name in zip(every, estimators, strict=True):
        mesh = _polar_map(axes, found, name)
        axes.set_title(name)
        axes.set_yticks([0.1, 0.2, 0.3, 0.4, 0.5], ["", "0.2 m", "", "0.4 m", ""], fontsize=7)
        axes.grid(alpha=0.3)
    if mesh is not None:
        shown.colorbar(mesh, ax=every, label="median |error| [mm]; grey: mostly no answer", shrink=0.8)
    shown.savefig(path, dpi=150)


def _polar_map(axes: Any, found: Arrays, name: str) -> Any:
    angles = np.linspace(-math.pi, math.pi, _SECTORS + 1)
    gaps = np.linspace(0.0, GAP_M[1], _BINS + 1)
    sector = np.clip(np.digitize(found["bearing"], angles) - 1, 0, _SECTORS - 1)
    ring = np.clip(np.digitize(found["gap"], gaps) - 1, 0, _BINS - 1)
    error = 1e3 * np.abs(found[f"none.{name}"] - found["link"])
    shown = _medians(sector * _BINS + ring, error, _SECTORS * _BINS).reshape(_SECTORS, _BINS)
    axes.set_facecolor("0.8")
    return axes.pcolormesh(angles, gaps, shown.T, cmap="viridis", vmin=0.0, vmax=60.0, rasterized=True)


def _medians(cell: Any, values: Floats, cells: int) -> Floats:
    """Return the median of each cell's values, (cells,); NaN where most of them are NaN."""
    medians = np.full(cells, np.nan)
    order = np.argsort(cell, kind="stable")
    starts = np.searchsorted(cell[order], np.arange(cells + 1))
    for i, (a, b) in enumerate(itertools.pairwise(starts)):
        inside = values[order[a:b]]
        answered = inside[~np.isnan(inside)]
        if len(answered) and 2 * len(answered) >= len(inside):
            medians[i] = np.median(answered)
    return medians


def _zones(path: Path, rows: list[Row], estimators: Sequence[str]) -> None:
    from matplotlib.figure import Figure

    shapes = list(dict.fromkeys(row["shape"] for row in rows))
    shown = Figure(figsize=(2.3 * len(estimators) + 0.6, 2.5 * len(shapes)), layout="constrained")
    every = shown.subplots(len(shapes), len(estimators), squeeze=False)
    chosen = {
        (row["shape"], row["estimator"]): row
        for row in rows
        if row["kind"] == "all" and row["noise"] == "none" and row["truth"] == "link"
    }
    for (i, shape), (j, name) in itertools.product(enumerate(shapes), enumerate(estimators)):
        row = chosen[shape, name]
        _matrix(every[i, j], np.array(row["zones"]), f"{shape}, {name}", row["unsafe"])
    title = "Rows: Coal's zone; columns: the estimate's (silence is green); % of the row; red is unsafe"
    shown.suptitle(title, fontsize=9)
    shown.savefig(path, dpi=150)


def _matrix(axes: Any, counts: Any, title: str, unsafe: float | None) -> None:
    shares = 100.0 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    unsafe_side = np.triu(np.ones_like(shares), 1) > 0.0
    axes.imshow(np.where(unsafe_side, -shares, shares), cmap="RdBu", vmin=-120.0, vmax=120.0)
    for i, j in itertools.product(range(len(ZONES)), repeat=2):
        colour = "white" if shares[i, j] > 75.0 else "black"
        axes.text(j, i, f"{shares[i, j]:.1f}", ha="center", va="center", fontsize=8, color=colour)
    axes.set_xticks(range(len(ZONES)), ZONES, fontsize=7)
    axes.set_yticks(range(len(ZONES)), ZONES, fontsize=7)
    under = "" if unsafe is None else f"\nunsafe {100.0 * unsafe:.1f} %"
    axes.set_title(f"{title}{under}", fontsize=8)

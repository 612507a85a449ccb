"""The report of ``bench.bound``: two tables, the scenes that went wrong, a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .bound_chunk import AIMED, LOOSE_M, PATIENCE, violates
from .bound_scenes import Case
from .brute import Array
from .common import Report, Row, figure, markdown_table
from .sweep import Arrays

BELOW_M = 1e-6
SOUNDNESS = {
    "configuration": "configuration",
    "scenes": "scenes",
    "echo_percent": "with an echo [%]",
    "above_0_percent": "bound above 0 [%]",
    "violations": "violations",
    "contradictions": "contradictions",
    "margin_um": "least margin [µm]",
    "price_mm": "price p50 [mm]",
    "scene_us": "a scene [µs]",
}
BRUTE = {
    "configuration": "configuration",
    "scenes": "brute force: scenes",
    "above_0_percent": "bound above 0 [%]",
    "excess_p50_mm": "excess p50 [mm]",
    "excess_p99_mm": "p99 [mm]",
    "excess_max_mm": "max [mm]",
    "loose": "above 1 mm",
    "below": "below −1 µm",
    "again": "searched again",
}
NOTES = f"""\
Configuration: robot or rings, radii [m], ε, and whether the assumptions say one obstacle or many (so \
many balls at most in a scene). 'clamped' and 'wide' are rings on the UR3's forearm: 8 × 27° of 0.2 to \
0.6 m, and 2 × 12 × 45° tilted by ∓20°.
A share of {AIMED:.0%} of the balls stands before a sensor, 0.05 to 1 m from its face (or 0.1 m beyond \
its range): a third of them graze its cone's edge by 2 mm or less, a third reach over it, a third have \
their centre within. The others have uniform bearings, places along the link and 0.1 m beyond, and gaps \
up to 0.5 m. One radius in three is the least, one the greatest, the others are uniform. Readings are the \
closed form's, none nearer than range_min or beyond range_max, with noise uniform in ±ε, one in four at \
its end.
A violation is a bound above Coal's exact distance of the mesh by more than 1e-9 m. A contradiction is a \
scan said to have no admissible ball, although one is there. Either ends the run with status 1. 'least \
margin' is the least of Coal less the bound; 'price' the same, median over scenes with an echo: what the \
sensors do not tell.
'a scene' is the mean time of the bound alone, in a process whose memory of single echoes fills \
meanwhile.
Brute force: the nearest ball found by random search that explains the scan, by Coal and the closed form, \
less the bound. It is told of the scene's own balls and of the ball that the bound met, and searches up \
to {PATIENCE} times more where it is more than 1 mm off. What it misses counts against the bound. Scenes \
with an echo; ε > 0 (else the balls in question are a shell without thickness, which no random search \
meets). 'searched again' counts those that were.\
"""


def soundness_row(case: Case, found: Arrays) -> Row:
    """Return the figures of one configuration against Coal."""
    bounds, distances, echo = found["bound"], found["distance"], found["echoes"] > 0
    margin = distances - bounds
    contradictory = np.isnan(bounds)
    return {
        "configuration": case.label,
        "scenes": len(bounds),
        "echo_percent": 100.0 * float(echo.mean()),
        "above_0_percent": 100.0 * float((bounds > 0.0).mean()),
        "violations": int((violates(bounds, distances) & ~contradictory).sum()),
        "contradictions": int(contradictory.sum()),
        "margin_um": _or_none(1e6 * np.nanmin(margin) if not contradictory.all() else math.nan),
        "price_mm": _or_none(1e3 * np.nanmedian(margin[echo]) if (echo & ~contradictory).any() else math.nan),
        "scene_us": 1e6 * float(found["seconds"].sum()) / len(bounds),
    }


def brute_row(case: Case, found: Arrays) -> Row:
    """Return the figures of one configuration against brute force, or of all."""
    excess = found["excess"]
    known = excess[np.isfinite(excess)]
    quantiles = np.percentile(known, [50.0, 99.0, 100.0]) if len(known) else np.full(3, math.nan)
    p50, p99, most = (1e3 * quantiles).tolist()
    return {
        "configuration": case.label,
        "scenes": len(excess),
        "above_0_percent": 100.0 * float((found["bound"] > 0.0).mean()),
        "excess_p50_mm": _or_none(p50),
        "excess_p99_mm": _or_none(p99),
        "excess_max_mm": _or_none(most),
        "loose": int((~(excess <= LOOSE_M)).sum()),
        "below": int((excess < -BELOW_M).sum()),
        "again": int((found["tries"] > 1).sum()),
    }


def _or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def violations(number: int, found: Arrays) -> list[Row]:
    """Return the scenes that went wrong, with all that it takes to ask again; lengths in m, inf as None."""
    names = ("piece", "readings", "centres", "radii", "distance", "bound")
    columns = [np.asarray(found[f"bad.{name}"], dtype=np.float64) for name in names]
    return [
        {"case": number, **{name: _finite(value) for name, value in zip(names, scene, strict=True)}}
        for scene in zip(*columns, strict=True)
    ]


def _finite(value: Any) -> Any:
    """Return numbers as JSON values, None for what is not finite."""
    if np.ndim(value):
        return [_finite(part) for part in value]
    return _or_none(float(value))


@dataclass(kw_only=True)
class BoundReport(Report):
    """The report, with the table of brute force below.

    Attributes:
        brute: Its rows.
        bad: Scenes that violate the bound.
    """

    brute: list[Row] = field(default_factory=list)
    bad: list[Row] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        settings: dict[str, Any],
        rows: list[Row],
        brute: list[Row],
        bad: list[Row],
        excess: Mapping[str, Array],
    ) -> BoundReport:
        """Return the report of these rows."""
        drawing = {name: values for name, values in excess.items() if np.isfinite(values).any()}
        return cls(
            name="bound",
            settings=settings,
            columns=SOUNDNESS,
            rows=rows,
            notes=NOTES.splitlines(),
            brute=brute,
            bad=bad,
            draw=(lambda path: _draw(path, drawing)) if drawing else None,
        )

    def to_builtins(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {**super().to_builtins(), "brute": self.brute, "violations": self.bad}

    def markdown(self) -> str:
        """Return machine, versions, tables and notes as Markdown."""
        text = super().markdown()
        if not self.brute:
            return text
        head, notes = text.split("\n\n- ", 1)
        return f"{head}\n\n{self._totals()}\n\n{markdown_table(BRUTE, self.brute)}\n\n- {notes}"

    def _totals(self) -> str:
        scenes, bad = sum(row["scenes"] for row in self.rows), len(self.bad)
        brute, loose = (sum(row[name] for row in self.brute) for name in ("scenes", "loose"))
        below = sum(row["below"] for row in self.brute)
        return (
            f"{scenes} scenes: {bad} violations or contradictions. {brute} of brute force: "
            f"{loose} more than 1 mm above the bound, {below} below it."
        )


def _draw(path: Path, excess: Mapping[str, Array]) -> None:
    def curves(axes: Any) -> None:
        for name, values in excess.items():
            known = np.sort(values[np.isfinite(values)])
            axes.step(1e3 * known, np.arange(1, len(known) + 1) / len(values), where="post", label=name)
        axes.axvline(1e3 * LOOSE_M, color="black", linestyle=":")
        axes.set_xlabel("brute force less the bound [mm]")
        axes.set_ylabel("share of scenes")
        axes.set_ylim(0.0, 1.01)
        axes.legend(fontsize=7)

    figure(path, 8.0, 5.0, curves)

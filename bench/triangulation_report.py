"""The report of the sweep: everything as JSON, and a few tables of it as Markdown."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from .common import Report, Row, markdown_table
from .triangulation_strata import ZONES

_MM = 1e3
_ERRORS = {
    "answers": "answers [%]",
    "bias": "bias [mm]",
    "median": "median [mm]",
    "abs_p50": "abs p50",
    "abs_p95": "abs p95",
    "abs_p99": "abs p99",
    "worst_over": "worst over",
    "worst_under": "worst under",
    "over": "over [%]",
    "bearing_p50_deg": "bearing [°]",
    "unsafe": "unsafe [%]",
}
_SHARES = {"answers", "over", "unsafe", "share", "standard_error", "claimed", "touch_link", "touch_arm"}
_LENGTHS = {
    *("bias", "median", "abs_p50", "abs_p95", "abs_p99", "worst_over", "worst_under"),
    *("p50", "p95", "rival_p50", "rival_p95", "rival_median"),
}
_COVERAGE = {
    "seen_by": "seen by",
    "gap": "gap",
    "scenes": "scenes",
    "share": "share [%]",
    "standard_error": "± [%]",
    "claimed": "claimed [%]",
    "agrees": "agrees",
}
_CONTESTS = {
    "shape": "shape",
    "noise": "noise",
    "stratum": "stratum",
    "rival": "rival",
    "scenes": "scenes",
    "p50": "sphere_fit p50 [mm]",
    "rival_p50": "rival p50",
    "p95": "sphere_fit p95",
    "rival_p95": "rival p95",
    "median": "sphere_fit median",
    "rival_median": "rival median",
    "wins": "better in",
}
_POINTS = {
    "estimator": "estimator",
    "points": "points",
    "answered": "answered",
    "median": "median error [m]",
    "worst_over": "worst over [m]",
    "worst_under": "worst under [m]",
    "median_in_radii": "median in radii",
}
_TOUCHING = {
    "shape": "shape",
    "scenes": "scenes",
    "touch_link": "touches the link [%]",
    "arm_measured": "arm measured",
    "touch_arm": "touches the arm [%]",
}
FEWEST = 20
"""A contest with fewer scenes is in the JSON only."""


@dataclass(kw_only=True)
class SweepReport(Report):
    """A report with more than one table.

    Attributes:
        extra: Further results by name: ``coverage``, ``contests``, ``points``, ``touching``.
        run: What the results do not depend on: workers and time.
    """

    extra: dict[str, list[Row]] = field(default_factory=dict)
    run: dict[str, Any] = field(default_factory=dict)

    def to_builtins(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {**super().to_builtins(), **self.extra, "run": self.run}

    def markdown(self) -> str:
        """Return the tables."""
        head, _, notes = super().markdown().partition(self._whole_table())
        parts = [head.rstrip()]
        for title, columns, rows in self._tables():
            if rows:
                parts += ["", f"### {title}", "", markdown_table(columns, [_shown(row) for row in rows])]
        parts += [notes.rstrip(), "", f"Run: {json.dumps(self.run)}"]
        return "\n".join(parts)

    def _whole_table(self) -> str:
        return markdown_table(self.columns, self.rows)

    def _tables(self) -> list[tuple[str, dict[str, str], list[Row]]]:
        where = {"shape": "shape", "noise": "noise", "estimator": "estimator", "scenes": "scenes"}
        strata = {"stratum": "stratum", "estimator": "estimator", "scenes": "scenes"}
        ideal_balls = self._rows(lambda r: r["shape"] == "sphere" and r["noise"] == "none", "link")
        return [
            ("What the text says of the ring, and what comes out", _COVERAGE, self.extra["coverage"]),
            (
                "Against the sensed link, by shape and noise",
                where | _ERRORS,
                self._rows(lambda r: r["kind"] == "all", "link"),
            ),
            ("Balls, ideal readings, by stratum", strata | _ERRORS, ideal_balls),
            (
                "Against the whole arm, ideal readings",
                where | _ERRORS,
                self._rows(lambda r: r["kind"] == "all" and r["noise"] == "none", "arm"),
            ),
            ("Zones, ideal readings, the sensed link: share of Coal's zone [%]", *self._zones()),
            (
                f"Two or more echoes: sphere_fit and its rivals, {FEWEST} scenes or more",
                _CONTESTS,
                [row for row in self.extra["contests"] if row["scenes"] >= FEWEST],
            ),
            ("Points in two cones of a widened ring", _POINTS, _plain(self.extra["points"])),
            ("Scenes left out because the obstacle touches", _TOUCHING, self.extra["touching"]),
        ]

    def _rows(self, chosen: Callable[[Row], bool], truth: str) -> list[Row]:
        return [row for row in self.rows if row["truth"] == truth and chosen(row) and row["scenes"]]

    def _zones(self) -> tuple[dict[str, str], list[Row]]:
        columns = {"shape": "shape", "estimator": "estimator", "coal": "Coal's zone"} | {z: z for z in ZONES}
        lines: list[Row] = []
        for row in self._rows(lambda r: r["kind"] == "all" and r["noise"] == "none", "link"):
            where = {"shape": row["shape"], "estimator": row["estimator"]}
            for zone, counts in zip(ZONES, row["zones"], strict=True):
                shares = [100.0 * count / max(1, sum(counts)) for count in counts]
                lines.append({**where, "coal": zone, **dict(zip(ZONES, shares, strict=True))})
            lines.append({**where, "coal": "**unsafe, of all**", "red": 100.0 * row["unsafe"]})
        return columns, lines


def _shown(row: Row) -> Row:
    shown = dict(row)
    if shown.get("plain"):
        return shown
    for name, value in row.items():
        if isinstance(value, float):
            shown[name] = round(value * (100.0 if name in _SHARES else _MM if name in _LENGTHS else 1.0), 2)
    return shown


def _plain(rows: list[Row]) -> list[Row]:
    return [{**row, "plain": True} for row in rows]


def lost(contests: list[Row]) -> list[str]:
    """Return where ``sphere_fit`` is not better in both, one line for each shape and noise."""
    lines = []
    fought = [row for row in contests if row["scenes"] >= FEWEST and row["wins"] != "both"]
    for (shape, noise), rows in itertools.groupby(fought, key=lambda row: (row["shape"], row["noise"])):
        found = [
            f"{r['stratum']} against {r['rival']} (better in {r['wins']}; resampled, better in the median in "
            f"{100.0 * r['chance_p50']:.0f} % and in p95 in {100.0 * r['chance_p95']:.0f} %)"
            for r in rows
        ]
        lines.append(f"{shape}, {noise}: " + "; ".join(found))
    return lines

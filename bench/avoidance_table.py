"""The table of ``bench.avoidance`` and its figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from .avoidance_outcome import Outcome
from .avoidance_run import HORIZON_S
from .avoidance_scenes import KINDS
from .common import figure

OURS = ("filter", "filter+planner")
COLUMNS = {
    "kind": "scenes",
    "method": "method",
    "scenes": "number",
    "possible": "possible",
    "arrivals": "arrived",
    "arrival_share": "share",
    "stuck": "stuck",
    "late": "late",
    "stuck_share": "stuck share",
    "contacts": "touched",
    "drove": "drove",
    "yielding": "yielded",
    "retreating": "run into",
    "helpless": "helpless",
    "itself": "itself",
    "least_m": "least d [m]",
    "least_p5_m": "5 % d [m]",
    "time_s": "time [s]",
    "path_ratio": "path / plan",
    "over_share": "over limit",
    "p50_us": "p50 [µs]",
    "p99_us": "p99 [µs]",
}


def row(kind: str, method: str, found: Sequence[Outcome]) -> dict[str, Any]:
    """Return what one method did in all scenes of a kind."""
    possible = [one for one in found if one.possible]
    arrived = [one for one in possible if one.end == "arrived"]
    least = [one.least_m for one in found]
    short = [one for one in possible if one.end in ("stuck", "late")]
    times: Counter[float] = Counter()
    for one in found:
        times.update(one.solve_us)
    return {
        "kind": kind,
        "method": method,
        "scenes": len(found),
        "possible": len(possible),
        "arrivals": len(arrived),
        "arrival_share": len(arrived) / len(possible) if possible else None,
        "arrivals_thought_impossible": sum(one.end == "arrived" for one in found) - len(arrived),
        "stuck": sum(one.end == "stuck" for one in possible),
        "late": sum(one.end == "late" for one in possible),
        "stuck_share": sum(one.end == "stuck" for one in possible) / len(possible) if possible else None,
        "contacts": sum(one.end == "contact" for one in found),
        "drove": sum(one.contact == "drove" for one in found),
        "yielding": sum(one.contact == "yielding" for one in found),
        "retreating": sum(one.retreating > 0 for one in found),
        "helpless": sum(one.helpless > 0 for one in found),
        "itself": sum(one.itself > 0 for one in found),
        "least_m": min(least),
        "least_p5_m": float(np.percentile(least, 5.0)),
        "time_s": median([one.arrived_s for one in arrived]) if arrived else None,
        "path_ratio": median([one.path / one.planned for one in arrived]) if arrived else None,
        "over_share": sum(one.over for one in found) / sum(one.instants for one in found),
        "p50_us": _percentile(times, 0.5),
        "p99_us": _percentile(times, 0.99),
        "plans": sum(one.info["plans"] for one in found),
        "without_solution": sum(one.info["failed"] for one in found),
        "touched_in": [f"{one.number}: {one.where}" for one in found if one.contact],
        "apart_in": [f"{one.number}: {one.info['apart']}" for one in found if one.apart],
        "not_arrived_in": [f"{one.number}: {one.end}, {one.goal_m:.3f} m short" for one in short],
    }


def _percentile(times: Counter[float], share: float) -> float | None:
    """Return the least counted time [µs] that so large a share does not exceed."""
    left = share * times.total()
    for value in sorted(times):
        left -= times[value]
        if left <= 0.0:
            return value
    return None


def table(results: Sequence[Outcome], methods: Sequence[str]) -> list[dict[str, Any]]:
    """Return all rows: every method over all scenes, then by kind."""
    rows = []
    for kind in ("all", *KINDS):
        for method in methods:
            mine = [one for one in results if one.method == method and kind in ("all", one.kind)]
            if mine:
                rows.append(row(kind, method, mine))
    return rows


def whole(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the rows over all scenes by method."""
    return {one["method"]: one for one in rows if one["kind"] == "all"}


def broken(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return what the filter must not show."""
    return [
        f"{method}: {one['contacts']} contacts by its own fault"
        for method, one in whole(rows).items()
        if method in OURS and one["contacts"]
    ]


def draw_arrivals(path: Path, results: Sequence[Outcome], methods: Sequence[str]) -> None:
    """Draw the share of possible scenes whose goal is reached by a time, by method."""

    def draw(axes: Any) -> None:
        for method in methods:
            mine = [one for one in results if one.method == method and one.possible]
            done = sorted(one.arrived_s for one in mine if one.arrived_s is not None)
            if mine:
                shares = [(index + 1) / len(mine) for index in range(len(done))]
                last = len(done) / len(mine)
                axes.step([0.0, *done, HORIZON_S], [0.0, *shares, last], where="post", label=method)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("share of possible scenes that have arrived")
        axes.set_ylim(0.0, 1.0)
        axes.legend(fontsize="small")

    figure(path, 7.0, 4.5, draw)

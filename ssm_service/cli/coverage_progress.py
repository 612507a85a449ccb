"""The search of ``ssm coverage`` with a progress bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..perception.coverage import LinkCoverage, SearchResult


def searched(covered: Sequence[LinkCoverage], radius: float, distance: float) -> dict[str, Any]:
    """Search for the least ring of each link; return the results as plain values by link."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from ..perception.coverage import SearchResult, plan_count, search

    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    found: dict[str, list[SearchResult]] = {}
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        for item in covered:
            task = progress.add_task(f"search {item.link.name}", total=plan_count(item.link))
            results = found.setdefault(item.link.name, [])
            for step in search(item.link, radius, distance, float(item.link.cones.reaches.max())):
                if isinstance(step, SearchResult):
                    results.append(step)
                else:
                    progress.advance(task, step)
    return {name: _rows(results) for name, results in found.items()}


def _rows(results: list[SearchResult]) -> list[dict[str, Any]]:
    least = min((result.best.sensors for result in results if result.best is not None), default=0)
    return [_row(result, least) for result in results]


def _row(result: SearchResult, least: int) -> dict[str, Any]:
    best = result.best
    return {
        "field_of_view_deg": result.field_of_view_deg,
        "plans": result.plans,
        "least": best is not None and best.sensors == least,
        "best": None
        if best is None
        else {
            "sensors": best.sensors,
            "proved_m": result.proved,
            "rings": [
                {
                    "place_m": ring.place,
                    "radius_m": ring.radius,
                    "count": ring.count,
                    "tilt_deg": math.degrees(ring.tilt),
                    "first_bearing_deg": math.degrees(ring.phase),
                }
                for ring in best.rings
            ],
        },
    }

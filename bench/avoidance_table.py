"""The table of ``bench.avoidance``, what must be known to read it, and its figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from .avoidance_judge import AS_FAST_AS_MAY, HELPLESS_M_S, Outcome
from .avoidance_run import ARRIVED_M, BIN, HORIZON_S, PROGRESS_M, STILL_RAD, STILL_S
from .avoidance_scenes import KINDS
from .avoidance_state import PERIOD_S, PLANNER_CLEARANCE_M
from .common import figure

OURS = ("filter", "filter+planner")
PEER = "pink"
COLUMNS = {
    "kind": "scenes",
    "method": "method",
    "scenes": "number",
    "possible": "possible",
    "arrivals": "arrived",
    "arrival_share": "share",
    "stuck": "stuck",
    "late": "late",
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
BETTER = {
    "arrival_share": 1,
    "stuck": -1,
    "late": -1,
    "contacts": -1,
    "retreating": -1,
    "helpless": -1,
    "itself": -1,
    "least_m": 1,
    "least_p5_m": 1,
    "time_s": -1,
    "path_ratio": -1,
    "over_share": -1,
    "p50_us": -1,
    "p99_us": -1,
}
"""Whether more (1) or less (-1) of a column is better."""


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


def _whole(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {one["method"]: one for one in rows if one["kind"] == "all"}


def broken(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return what the filter must not show."""
    return [
        f"{method}: {one['contacts']} contacts by its own fault"
        for method, one in _whole(rows).items()
        if method in OURS and one["contacts"]
    ]


def against_peer(ours: dict[str, Any], peer: dict[str, Any], results: Sequence[Outcome]) -> str:
    """Return in which columns a method of ours is not as good as the peer."""
    worse = []
    for column, sign in BETTER.items():
        mine, other = ours[column], peer[column]
        if mine is None or other is None:
            if mine != other and mine is None:
                worse.append(f"{COLUMNS[column]} – to {other:.3g}")
        elif sign * mine < sign * other:
            worse.append(f"{COLUMNS[column]} {mine:.3g} to {other:.3g}")
    said = f"worse in {', '.join(worse)}" if worse else "at least as good in every column"
    return f"{ours['method']} against {peer['method']}: {said}{_together(ours, peer, results)}"


def _together(ours: dict[str, Any], peer: dict[str, Any], results: Sequence[Outcome]) -> str:
    """Return time and path over the scenes in which both arrive, as medians of different scenes differ."""
    one, other = (
        {it.number: it for it in results if it.method == row["method"] and it.end == "arrived"}
        for row in (ours, peer)
    )
    both = sorted(one.keys() & other.keys())
    if not both:
        return ""
    times = [median([found[number].arrived_s or 0.0 for number in both]) for found in (one, other)]
    paths = [median([found[number].path for number in both]) for found in (one, other)]
    return (
        f". In the {len(both)} scenes where both arrive: time {times[0]:.2f} to {times[1]:.2f} s, "
        f"path {paths[0]:.2f} to {paths[1]:.2f} rad"
    )


def stuck_ratio(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield how much less often ours are stuck than the 3-D field, where it was run over the same scenes."""
    whole = _whole(rows)
    field = whole.get("field3d")
    for method in OURS:
        mine = whole.get(method)
        if mine is None or field is None or mine["scenes"] != field["scenes"]:
            continue
        counts = [(mine[key], field[key]) for key in ("stuck", "late")]
        ratio = f"{counts[0][1] / counts[0][0]:.3g} times less often" if counts[0][0] else "not once"
        yield (
            f"stuck: {method} {counts[0][0]} to field3d {counts[0][1]} ({ratio}; wanted: 10 times less "
            f"often); late: {counts[1][0]} to {counts[1][1]}; touched, so neither: {mine['contacts']} to "
            f"{field['contacts']} scenes"
        )


def notes(rows: Sequence[dict[str, Any]], results: Sequence[Outcome]) -> Iterator[str]:
    """Yield what one must know to read the table."""
    whole = _whole(rows)
    for method in OURS:
        if method in whole and PEER in whole:
            yield against_peer(whole[method], whole[PEER], results)
    yield from stuck_ratio(rows)
    yield from _meanings(results)
    for method in OURS:
        one = whole.get(method)
        if one is not None:
            examples = (*one["touched_in"][:5], *one["apart_in"][:5], *one["not_arrived_in"][:5])
            yield from (f"{method}, scene {example}" for example in examples)


def _meanings(results: Sequence[Outcome]) -> Iterator[str]:
    """Yield what the columns mean."""
    scenes = {one.number: one for one in results}
    blocked = sum(one.blocked for one in scenes.values())
    yield (
        f"possible: the planner knows a path that keeps {PLANNER_CLEARANCE_M:g} m (by the hulls) from "
        f"everything that stands; what moves is gone within some seconds. In {blocked} of {len(scenes)} "
        "scenes the straight motion runs into something that stands; all that crosses passes where the "
        "straight motion would be at that moment"
    )
    yield (
        f"arrived: within {1e3 * ARRIVED_M:g} mm of the goal when everything that moves is gone, nothing "
        f"touched, in {HORIZON_S:g} s; stuck: for {STILL_S:g} s after that the hand came no "
        f"{1e3 * PROGRESS_M:g} mm nearer and no joint moved {STILL_RAD:g} rad; late: neither"
    )
    yield (
        "touched: scenes with a contact (exact, whole arm) by the method's own fault, which ends the run: "
        "drove, the link came nearer by itself; yielded, it stood or retreated more slowly than it might. "
        f"Counted apart, where the obstacle came: run into, the link retreated at {100 * AS_FAST_AS_MAY:g} % "
        "or more of what zone, joint limits and other threatened links left; helpless, it stood and these "
        f"left less than {1e3 * HELPLESS_M_S:g} mm/s. itself: scenes in which links touched each other, by "
        "their hulls"
    )
    yield (
        f"tick every {1e3 * PERIOD_S:g} ms, tracker at 30 Hz without prediction, one tick to the arm, lag of "
        "20 ms; zone limits and joint limits follow every method and cut what it asks for, so that `over "
        "limit` (share of instants with a joint faster than its zone, by more than 1 %) is the arm's lag; "
        "contact counts as red, or nothing could ever be left"
    )
    yield (
        "least d of scenes that ended early is that until then; time, path / plan (in joint space): medians "
        "of the arrivals"
    )
    yield (
        f"solve time: the processor's, to {100 * (BIN - 1):.0f} %, with every distance beyond the nearest "
        "one, which the zones need in any case"
    )


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

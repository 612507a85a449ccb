"""What must be known to read the table of ``bench.avoidance``, and what follows from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import median
from typing import Any

from .avoidance_judge import AS_FAST_AS_MAY, HELPLESS_M_S
from .avoidance_outcome import Outcome
from .avoidance_run import ARRIVED_M, BIN, HORIZON_S, PROGRESS_M, STILL_RAD, STILL_S
from .avoidance_state import PERIOD_S, PLANNER_CLEARANCE_M
from .avoidance_table import COLUMNS, OURS, whole

PEER = "pink"
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
    found = whole(rows)
    field = found.get("field3d")
    for method in OURS:
        mine = found.get(method)
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
    found = whole(rows)
    for method in OURS:
        if method in found and PEER in found:
            yield against_peer(found[method], found[PEER], results)
    yield from stuck_ratio(rows)
    yield from _meanings(results)
    for method in OURS:
        one = found.get(method)
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

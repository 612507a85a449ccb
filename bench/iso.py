"""Does profile ``iso`` keep the protective separation, and at what cost beside ``kang2022`` and a plain stop?

Random variants of ``crossing``, ``hand`` and ``walk``: other paths, speeds up to 1.6 m/s, phases and targets;
the same for each profile. World and monitor run in one process and not in real time, at 125 Hz, with joints
at 125 Hz, a tracker at 30 Hz, one tick from a decision to the arm, and the arm's lag. At every tick the exact
distances of all links to all obstacles are held against the separation that the equation demands for the true
speeds. Ends with status 1 if under ``iso`` there is an instant at which not even a stop at once would have
done while its command still closed in, or a contact with a link that was coming nearer.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import msgspec

from . import sweep
from .common import Report, figure, parser, progress
from .iso_run import HORIZON_S, PERIOD_S, Piece, Result, pieces, plain_distance, robots, run
from .iso_scenes import ARM_SPEEDS_M_S, PROFILES, SCENARIOS

FULL = 200
COLUMNS = {
    "scenario": "scenario",
    "profile": "profile",
    "variants": "variants",
    "short": "variants short of S_p",
    "short_share": "of the time",
    "worst_m": "by [m]",
    "worst_s": "by [s]",
    "reaction_s": "T_r [s]",
    "spent": "reaction spent",
    "apart_share": "apart, of the time",
    "contacts": "contacts",
    "touched": "touched standing",
    "least_m": "least d [m]",
    "finished": "finished",
    "finished_s": "median [s]",
    "legs_per_min": "legs/min",
    "green": "green",
    "yellow": "yellow",
    "red": "red",
    "stop": "stop",
}


def row(scenario: str, profile: str, found: Sequence[Result]) -> dict[str, Any]:
    """Return what all variants of one scenario came to under one profile."""
    instants = sum(one.instants for one in found)
    finished = [one.finished_s for one in found if one.finished_s is not None]
    zones = {
        zone: sum(one.zones.get(zone, 0) for one in found) / instants
        for zone in ("green", "yellow", "red", "stop")
    }
    return {
        "scenario": scenario,
        "profile": profile,
        "variants": len(found),
        "short": sum(one.short > 0 for one in found),
        "short_share": sum(one.short for one in found) / instants,
        "worst_m": max(one.worst_m for one in found),
        "worst_s": max(one.worst_s for one in found),
        "reaction_s": max(one.reaction_s for one in found),
        "spent": sum(one.spent > 0 for one in found),
        "worst_spent_m": max(one.worst_spent_m for one in found),
        "apart_share": sum(one.apart for one in found) / instants,
        "contacts": sum(one.contacts for one in found),
        "touched": sum(one.touched for one in found),
        "least_m": min(one.least_m for one in found),
        "finished": len(finished),
        "finished_s": median(finished) if finished else None,
        "legs_per_min": 60.0 * sum(one.legs for one in found) / sum(one.seconds for one in found),
        **zones,
        "examples": [one.example for one in found if one.example][:3],
    }


def table(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Return all rows."""
    return [
        row(scenario, profile, mine)
        for scenario in SCENARIOS
        for profile in PROFILES
        if (mine := [r for r in results if (r.piece.scenario, r.piece.profile) == (scenario, profile)])
    ]


def broken(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return what profile ``iso`` must not show."""
    return [
        f"{one['scenario']}: {one['spent']} variants with the reaction time spent, {one['contacts']} contacts"
        for one in rows
        if one["profile"] == "iso" and (one["spent"] or one["contacts"])
    ]


def notes(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield what one must know to read the table."""
    speeds = ", ".join(f"{speed:g}" for speed in ARM_SPEEDS_M_S)
    distance = plain_distance(robots()[0][0])
    yield (
        "short of S_p: a link that came nearer had less than S_p for the true speeds (C, Z_d, Z_r of `iso`, "
        "T_r as in force, T_s of the true joint speeds); `by [s]`: that over v_h + v_r, which a reaction "
        "under way explains up to T_r"
    )
    yield (
        "reaction spent: less than S_p with T_r = 0, while the command in force still closed in; apart: less "
        "than S_p only to links that stood still or retreated, into which the obstacle moved"
    )
    yield (
        f"tick and joints every {1e3 * PERIOD_S:g} ms, tracker at 30 Hz, one tick to the arm, lag of 20 ms; "
        f"end effector at {speeds} m/s; at most {HORIZON_S:g} s a run; no rings: with scans of 160 ms every "
        "echo within about a metre is a stop"
    )
    yield (
        f"plain: stands still within {distance:.3f} m, which S_p demands of the fastest of these speeds (in "
        "the table as red), else full speed"
    )
    for one in rows:
        for example in one["examples"]:
            yield f"{one['profile']}: {example}"


def _kept(path: Path | None) -> dict[Piece, Result]:
    """Return the results that a run before has kept; the last line may have been cut off."""
    if path is None or not path.exists():
        return {}
    found = {}
    for line in path.read_bytes().splitlines():
        with contextlib.suppress(msgspec.MsgspecError):
            result = msgspec.json.decode(line, type=Result)
            found[result.piece] = result
    return found


def _keep(path: Path | None, result: Result) -> None:
    if path is not None:
        with path.open("ab") as file:
            file.write(msgspec.json.encode(result) + b"\n")


def main() -> None:
    """Run the benchmark."""
    options = parser("iso", __doc__, "variants", 6, "variants of each scenario")
    options.add_argument("--full", action="store_true", help=f"{FULL} variants of each scenario")
    workers = len(os.sched_getaffinity(0))
    options.add_argument("--workers", type=int, default=workers, help="processes (default: %(default)s)")
    options.add_argument(
        "--lines",
        type=Path,
        metavar="FILE",
        help="keep each result there, and go on from what it holds",
    )
    arguments = options.parse_args()
    variants = FULL if arguments.full else arguments.variants
    begin, wanted = time.perf_counter(), pieces(arguments.seed, variants)
    kept = _kept(arguments.lines)
    todo = [piece for piece in wanted if piece not in kept]
    with sweep.local(arguments.workers) as executor, progress() as bar:
        runs = bar.add_task("runs", total=len(todo))
        for result in executor.map(run, todo, chunksize=3):
            kept[result.piece] = result
            _keep(arguments.lines, result)
            bar.advance(runs)
    results = [kept[piece] for piece in wanted]
    rows = table(results)
    Report(
        name="iso",
        settings={
            "seed": arguments.seed,
            "variants": variants,
            "seconds": round(time.perf_counter() - begin, 1),
        },
        columns=COLUMNS,
        rows=rows,
        notes=list(notes(rows)),
        draw=lambda path: _draw(path, results),
    ).finish(arguments)
    if found := broken(rows):
        sys.exit("; ".join(found))


def _draw(path: Path, results: Sequence[Result]) -> None:
    """Draw how many variants had finished their cycle by when, by profile."""

    def draw(axes: Any) -> None:
        for profile in PROFILES:
            mine = [one for one in results if one.piece.profile == profile]
            done = sorted(one.finished_s for one in mine if one.finished_s is not None)
            shares = [(index + 1) / len(mine) for index in range(len(done))]
            axes.step(
                [0.0, *done, HORIZON_S], [0.0, *shares, len(done) / len(mine)], where="post", label=profile
            )
        axes.set_xlabel("time [s]")
        axes.set_ylabel("share of variants that have finished their cycle")
        axes.set_ylim(0.0, 1.0)
        axes.legend()

    figure(path, 7.0, 4.5, draw)


if __name__ == "__main__":
    main()

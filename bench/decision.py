"""Does a second, slow implementation of the decision agree with the monitor on random inputs?

The second one (``tests/oracle``) was written from the science and the interfaces and shares no code with the
package. Both are given the same long sequences of ticks: sources that age, fall silent, are refused or speak
nonsense, readings at the edges of zones, obstacles, late ticks, a second service, latched errors. Zone,
reasons, states, distance, limits, scaling and command must agree at every tick. Then small differences are
planted in the monitor, one at a time, and each must be found. Ends with status 1 if the two differ, or if one
is not found.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from . import sweep
from .common import Report, parser, progress
from .decision_mutants import MUTANTS
from .decision_run import Outcome, Task, compare
from .decision_scenes import VARIANTS

PIECE = 20_000
"""Ticks of one piece of work."""

WITHIN = 20_000
"""Ticks of each profile within which a planted difference must be found."""

COLUMNS = {
    "profile": "profile",
    "required": "required beside joints",
    "ticks": "ticks",
    "different": "different",
    "edges": "at an edge",
    "green": "green",
    "yellow": "yellow",
    "red": "red",
    "stop": "stop",
}
PLANTED = {"name": "planted", "profile": "profile", "first": "found at tick"}


def tasks(seed: int, ticks: int) -> list[Task]:
    """Return the pieces of work: the ticks shared out among all variants."""
    each = -(-ticks // len(VARIANTS))
    found = []
    for variant in range(len(VARIANTS)):
        for place, begin in enumerate(range(0, each, PIECE)):
            count = min(PIECE, each - begin)
            found.append(Task(variant=variant, seed=seed + 100 * place + variant, ticks=count))
    return found


def hunts(seed: int) -> list[list[Task]]:
    """Return for each planted difference where it is looked for, in turn, until it is found."""
    return [
        [
            Task(variant=variant, seed=seed + variant, ticks=WITHIN, mutant=mutant)
            for variant, (_, profile) in enumerate(VARIANTS)
            if profile in planted.profiles
        ]
        for mutant, planted in enumerate(MUTANTS)
    ]


def hunt(places: list[Task]) -> tuple[Task, int] | None:
    """Return where a planted difference was found, and after how many ticks; ``None`` where it was not.

    A tick that differs also with nothing planted finds nothing.
    """
    for task in places:
        first = compare(task).first
        if first is not None and compare(replace(task, mutant=None, ticks=first)).first is None:
            return task, first
    return None


def rows(outcomes: list[Outcome]) -> Iterator[dict[str, Any]]:
    """Yield one row for each variant."""
    for number, (required, profile) in enumerate(VARIANTS):
        mine = [outcome for outcome in outcomes if outcome.variant == number]
        zones = {zone: sum(o.zones.get(zone, 0) for o in mine) for zone in ("green", "yellow", "red", "stop")}
        yield {
            "profile": profile,
            "required": required,
            "ticks": sum(o.ticks for o in mine),
            "different": sum(o.first is not None for o in mine),
            "edges": sum(o.edges for o in mine),
            **zones,
            "examples": [example for o in mine for example in o.different][:3],
        }


def main() -> None:
    """Run the benchmark."""
    options = parser("decision", __doc__, "ticks", 1_000_000, "ticks, all profiles together")
    workers = len(os.sched_getaffinity(0))
    options.add_argument("--workers", type=int, default=workers, help="processes (default: %(default)s)")
    options.add_argument("--no-planted", action="store_true", help="leave the planted differences out")
    arguments = options.parse_args()
    begin = time.perf_counter()
    todo = tasks(arguments.seed, arguments.ticks)
    places = [] if arguments.no_planted else hunts(arguments.seed)
    with sweep.local(arguments.workers) as executor, progress() as bar:
        ticks = bar.add_task("ticks", total=sum(task.ticks for task in todo))
        hunted = bar.add_task("planted", total=len(places))
        outcomes = []
        for outcome in executor.map(compare, todo):
            outcomes.append(outcome)
            bar.advance(ticks, outcome.ticks)
        caught = []
        for found in executor.map(hunt, places):
            caught.append(found)
            bar.advance(hunted)
    _finish(arguments, outcomes, caught, time.perf_counter() - begin)


def _finish(
    arguments: Any, outcomes: list[Outcome], caught: list[tuple[Task, int] | None], seconds: float
) -> None:
    table = list(rows(outcomes))
    missed = [m.name for m, found in zip(MUTANTS, caught, strict=False) if found is None]
    notes = [
        f"planted: {m.name}: "
        + ("NOT FOUND" if found is None else f"found at tick {found[1]} of {VARIANTS[found[0].variant][1]}")
        for m, found in zip(MUTANTS, caught, strict=False)
    ]
    notes.append(
        "at an edge: within 0.02 mm of a zone's edge (0.1 mm of a protective stop), where both are right"
    )
    Report(
        name="decision",
        settings={"seed": arguments.seed, "ticks": arguments.ticks, "seconds": round(seconds, 1)},
        columns=COLUMNS,
        rows=table,
        notes=notes,
    ).finish(arguments)
    different = sum(row["different"] for row in table)
    for row in table:
        for example in row["examples"]:
            print(f"{row['profile']}, {row['required']}: {example}", file=sys.stderr)
    if different or missed:
        sys.exit(f"{different} pieces differ; not found: {', '.join(missed) or 'none'}")


if __name__ == "__main__":
    main()

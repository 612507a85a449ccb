"""Which method reaches its goals without touching anything: fields, CLIK, the filter, and an outside peer.

Random scenes: a UR3 with all joints free, up to eight spheres, boxes and capsules that stand, cross or
chase, the same for every method. World, limits and tracker run in one process and not in real time, at
125 Hz, with a tracker at 30 Hz, one tick from a decision to the arm, and the arm's lag. At every tick the
exact distances of all links to all obstacles are looked at. Ends with status 1 if the filter touches
something that it need not have touched.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from pathlib import Path
from typing import Any

from . import sweep
from .avoidance_draw import drawn
from .avoidance_lines import Lines, of_value, outcome_digest, scene_digest, to_value
from .avoidance_methods import METHODS
from .avoidance_notes import notes
from .avoidance_outcome import Outcome
from .avoidance_run import HORIZON_S, Piece, run
from .avoidance_table import COLUMNS, broken, draw_arrivals, table
from .common import Report, parser, progress

SCENES = 200
FULL = 500
_AHEAD = 2  # pieces that wait for each worker


def each(
    executor: Executor, workers: int, work: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]
) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield each task with what ``work`` made of its arguments, as they are done."""
    queue, running = iter(tasks), dict[Future[Any], tuple[Any, ...]]()
    while True:
        while len(running) < _AHEAD * max(workers, 1) and (task := next(queue, None)) is not None:
            running[executor.submit(work, *task)] = task
            if workers == 0:
                break
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            yield running.pop(future), future.result()


def collect(
    arguments: argparse.Namespace, numbers: Sequence[int], methods: Sequence[str], lines: Lines
) -> list[Outcome]:
    """Draw the scenes and run the methods, where the lines do not have them yet; return all outcomes."""
    seed = arguments.seed
    with sweep.local(arguments.workers) as executor, progress() as bar:
        keys = {number: scene_digest(seed, number) for number in numbers}
        missing = [(seed, number) for number in numbers if lines.get(keys[number]) is None]
        shown = bar.add_task("scenes", total=len(missing))
        for (_, number), scene in each(executor, arguments.workers, drawn, missing):
            lines.keep(keys[number], scene)
            bar.advance(shown)
        pieces = [
            Piece(scene=lines.get(keys[number]) or {}, method=method)
            for number in numbers
            for method in methods
        ]
        digests = [outcome_digest(one.scene, one.method, HORIZON_S) for one in pieces]
        left = [
            (one, digest) for one, digest in zip(pieces, digests, strict=True) if lines.get(digest) is None
        ]
        shown = bar.add_task("runs", total=len(left))
        for (_, digest), value in each(executor, arguments.workers, _run, left):
            lines.keep(digest, value)
            bar.advance(shown)
    return [of_value(value) for digest in digests if (value := lines.get(digest)) is not None]


def _run(piece: Piece, digest: str) -> dict[str, Any]:
    """Run one piece; its digest only goes with it."""
    return to_value(run(piece))


def _arguments() -> tuple[argparse.Namespace, tuple[str, ...]]:
    options = parser("avoidance", __doc__, "scenes", SCENES, "scenes")
    options.add_argument("--full", action="store_true", help=f"{FULL} scenes")
    options.add_argument("--first", type=int, default=0, help="number of the first scene (default: 0)")
    options.add_argument(
        "--methods", default=",".join(METHODS), help="comma-separated (default: all: %(default)s)"
    )
    workers = len(os.sched_getaffinity(0))
    options.add_argument("--workers", type=int, default=workers, help="processes (default: %(default)s)")
    options.add_argument(
        "--lines",
        type=Path,
        metavar="FILE",
        help="keep each scene and outcome there at once, and go on from what it holds",
    )
    arguments = options.parse_args()
    methods = tuple(arguments.methods.split(","))
    if unknown := set(methods) - set(METHODS):
        options.error(f"--methods: unknown {', '.join(sorted(unknown))}; known: {', '.join(METHODS)}")
    if arguments.full:
        arguments.scenes = FULL
    return arguments, methods


def main() -> None:
    """Run the benchmark."""
    arguments, methods = _arguments()
    numbers = range(arguments.first, arguments.first + arguments.scenes)
    begin = time.perf_counter()
    results = collect(arguments, numbers, methods, Lines(arguments.lines))
    rows = table(results, methods)
    Report(
        name="avoidance",
        settings={
            "seed": arguments.seed,
            "scenes": arguments.scenes,
            "first": arguments.first,
            "seconds": round(time.perf_counter() - begin, 1),
        },
        columns=COLUMNS,
        rows=rows,
        notes=list(notes(rows, results)),
        draw=lambda path: draw_arrivals(path, results, methods),
    ).finish(arguments)
    if found := broken(rows):
        sys.exit("; ".join(found))


if __name__ == "__main__":
    main()

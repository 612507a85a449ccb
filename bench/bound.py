"""``lower_bound``: ever above Coal's distance? How near to a brute-force infimum, and at what cost?

Draws scenes within declared assumptions, several configurations of them, and holds the bound against Coal's
exact distance of the link's mesh; and some more against a search by brute force. The same seed gives the same
scenes, whatever the number of workers; with ``--out`` a run that was interrupted goes on where it was. Ends
with status 1 if a bound is above the distance, or denies a ball that is there; the scenes are written out.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from . import sweep
from .bound_chunk import Task, tasks, work
from .bound_report import BoundReport, brute_row, soundness_row, violations
from .bound_scenes import SWEEP
from .common import parser, progress

SOURCES = ("bound.py", "bound_chunk.py", "bound_scenes.py", "brute.py")


def measure(todo: list[Task], folder: Path, workers: int) -> sweep.Store:
    """Do what is missing of the pieces and return where they are."""
    store = sweep.Store(folder=folder)
    with sweep.local(workers) as executor, progress() as bar:
        scenes = bar.add_task("scenes", total=sum(task.count for task in todo if not task.brute))
        brute = bar.add_task("brute force", total=sum(task.count for task in todo if task.brute))

        def done(task: Task) -> None:
            bar.advance(brute if task.brute else scenes, task.count)

        sweep.complete(work, todo, store, executor, max(1, workers), done)
    return store


def report(todo: list[Task], store: sweep.Store, settings: dict[str, Any]) -> BoundReport:
    """Return what came out."""
    rows, brute, bad, excess = [], [], [], {}
    for number, case in enumerate(SWEEP):
        of_kind: dict[bool, list[int]] = {False: [], True: []}
        for place, task in enumerate(todo):
            if task.case == number:
                of_kind[task.brute].append(place)
        found = sweep.merged(store, of_kind[False])
        rows.append(soundness_row(case, found))
        bad += violations(number, found)
        if of_kind[True]:
            found = sweep.merged(store, of_kind[True])
            brute.append(brute_row(case, found))
            excess[case.label] = found["excess"]
    return BoundReport.of(settings, rows, brute, bad, excess)


def _arguments() -> argparse.Namespace:
    options = parser("bound", __doc__, "scenes", 1_000_000, "scenes, all configurations together")
    options.add_argument(
        "--brute", type=_whole, default=1000, metavar="N", help="scenes of brute force (default: %(default)s)"
    )
    options.add_argument(
        "--workers",
        type=_whole,
        default=len(os.sched_getaffinity(0)),
        metavar="N",
        help="processes; 0 for none but this one (default: %(default)s)",
    )
    return options.parse_args()


def _whole(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


def _sources() -> str:
    here = Path(__file__).parent
    return hashlib.sha256(b"".join((here / name).read_bytes() for name in SOURCES)).hexdigest()


def main() -> None:
    """Run the benchmark."""
    arguments = _arguments()
    settings = {"seed": arguments.seed, "scenes": arguments.scenes, "brute": arguments.brute}
    todo = tasks(arguments.seed, arguments.scenes, arguments.brute)
    with ExitStack() as stack:
        if arguments.out is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bound-")))
        else:
            folder = arguments.out / "chunks" / sweep.key({**settings, "sources": _sources()})
        begin = time.perf_counter()
        try:
            store = measure(todo, folder, arguments.workers)
        except KeyboardInterrupt:
            kept = "" if arguments.out is None else "; the same command goes on from here"
            sys.exit(f"interrupted{kept}")
        seconds = round(time.perf_counter() - begin, 1)
        made = report(todo, store, {**settings, "workers": arguments.workers, "seconds": seconds})
        made.finish(arguments)
    if made.bad:
        sys.exit(f"{len(made.bad)} scenes violate the bound: see 'violations' of the JSON (--json, --out)")


if __name__ == "__main__":
    main()

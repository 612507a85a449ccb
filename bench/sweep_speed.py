"""Ball scenes a second of the sweep, with every estimator and the sensed link by Coal, by workers."""

from __future__ import annotations

import os
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import sweep
from .common import Report, Row, parser, progress
from .sweep import Arrays
from .triangulation_chunk import CHUNK, Settings, Task, work
from .triangulation_estimators import ESTIMATORS

REPEATS = 5
NOTES = """\
Ball scenes with ideal readings, the exact distance of the link that carries the ring, and the estimators \
named in the settings; the whole arm is not measured. Results come back and are written to files, as in the \
sweep.
A worker's first chunk, in which it loads the robot and makes tables, is not counted. 'Best' and 'median' \
are over the repeats, whose order alternates. 'Per CPU second' counts the worker's own processor time only: \
with other work on the machine it is the steadier number. 'Linear' is the rate over workers times the rate \
of one.\
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timed:
    """One chunk with its times.

    Attributes:
        arrays: What it gave.
        process: Who did it.
        begin, end: By the machine's monotonic clock [s].
        cpu: Processor time [s].
    """

    arrays: Arrays
    process: int
    begin: float
    end: float
    cpu: float


def timed(task: Task) -> Timed:
    """Do a chunk and take its times."""
    begin, cpu = time.monotonic(), time.process_time()
    arrays = work(task)
    spent = time.process_time() - cpu
    return Timed(arrays=arrays, process=os.getpid(), begin=begin, end=time.monotonic(), cpu=spent)


def rates(workers: int, chunks: int, seed: int, estimators: tuple[str, ...]) -> tuple[float, float]:
    """Return scenes a second of all workers together, and scenes a CPU second.

    Args:
        workers: How many.
        chunks: So many for each worker, beside the first.
        seed: Of the scenes.
        estimators: Which are computed.
    """
    settings = Settings(robot="ur3", seed=seed, noises=("none",), estimators=estimators, arm_every=0)
    count = CHUNK["sphere"]
    every = [
        Task(settings=settings, shape="sphere", index=i, count=count) for i in range(workers * (chunks + 1))
    ]
    by_process: dict[int, list[Timed]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder, sweep.local(workers) as executor:
        store = sweep.Store(folder=Path(folder))
        for i, done in enumerate(executor.map(timed, every)):
            store.save(i, done.arrays)
            by_process[done.process].append(done)
    wall = cpu = scenes = 0.0
    for mine in by_process.values():
        mine.sort(key=lambda one: one.begin)
        later = mine[1:]
        if later:
            wall += count * len(later) / (later[-1].end - mine[0].end)
            cpu += sum(one.cpu for one in later)
            scenes += count * len(later)
    return wall, scenes / cpu


def rows(most: int, chunks: int, seed: int, estimators: tuple[str, ...]) -> list[Row]:
    """Return a row for each number of workers up to ``most``."""
    found: dict[int, list[tuple[float, float]]] = {workers: [] for workers in range(1, most + 1)}
    with progress() as bar:
        line = bar.add_task("sweeps", total=REPEATS * most)
        for repeat in range(REPEATS):
            for workers in sorted(found, reverse=bool(repeat % 2)):
                found[workers].append(rates(workers, chunks, seed, estimators))
                bar.advance(line)
    best_of_one = max(wall for wall, _ in found[1])
    table = []
    for workers, pairs in found.items():
        walls, cpus = zip(*pairs, strict=True)
        table.append(
            {
                "workers": workers,
                "best": max(walls),
                "median": float(np.median(walls)),
                "per_cpu_second": float(np.median(cpus)),
                "linear": max(walls) / (workers * best_of_one),
            }
        )
    return table


def main() -> None:
    """Run the benchmark."""
    options = parser("sweep_speed", __doc__, "chunks", 10, f"chunks of {CHUNK['sphere']} scenes a worker")
    arguments = options.parse_args()
    most = len(os.sched_getaffinity(0))
    table = rows(most, arguments.chunks, arguments.seed, ESTIMATORS)
    columns = {
        "workers": "workers",
        "best": "scenes/s, best",
        "median": "median",
        "per_cpu_second": "per CPU second",
        "linear": "linear",
    }
    settings = {"seed": arguments.seed, "chunks": arguments.chunks, "estimators": list(ESTIMATORS)}
    Report(
        name="sweep_speed", settings=settings, columns=columns, rows=table, notes=NOTES.splitlines()
    ).finish(arguments)


if __name__ == "__main__":
    main()

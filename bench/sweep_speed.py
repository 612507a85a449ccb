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
from .triangulation_estimators import ESTIMATORS, TIGHT

FIVE = tuple(name for name in ESTIMATORS if name != TIGHT)
REPEATS = 3
NOTES = """\
Ball scenes with ideal readings, the exact distance of the link that carries the ring, and the estimators \
named in the settings; the whole arm is not measured. Results come back and are written to files, as in the \
sweep.
'From cold' counts all of a worker's chunks and the tables that it makes for the first; the start of the \
process is left out. 'Steady' counts the second half of them: lower_bound remembers the answers to single \
echoes, by a quarter of a millimetre.
'Best' and 'median' are over the repeats, whose order alternates. 'Per CPU second' counts the workers' own \
processor time, in the steady half; with other work on the machine it is the number to trust. 'Linear' is \
the best steady rate over workers times the rate of one.\
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Rates:
    """Scenes a second of all workers together: from cold, steady, and a CPU second of the steady half."""

    cold: float
    steady: float
    cpu: float


def rates(workers: int, chunks: int, seed: int, estimators: tuple[str, ...]) -> Rates:
    """Return how fast so many workers are.

    Args:
        workers: How many.
        chunks: So many for each worker.
        seed: Of the scenes.
        estimators: Which are computed.
    """
    settings = Settings(robot="ur3", seed=seed, noises=("none",), estimators=estimators, arm_every=0)
    every = [
        Task(settings=settings, shape="sphere", index=i, count=CHUNK["sphere"])
        for i in range(workers * chunks)
    ]
    by_process: dict[int, list[Timed]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder, sweep.local(workers) as executor:
        store = sweep.Store(folder=Path(folder))
        for i, done in enumerate(executor.map(timed, every)):
            store.save(i, done.arrays)
            by_process[done.process].append(done)
    mine = [sorted(done, key=lambda one: one.begin) for done in by_process.values()]
    later = [done[len(done) // 2 :] for done in mine]
    cpu = sum(one.cpu for done in later for one in done)
    scenes = CHUNK["sphere"] * sum(map(len, later))
    return Rates(cold=_rate(mine), steady=_rate(later), cpu=scenes / cpu)


def _rate(of_workers: list[list[Timed]]) -> float:
    return sum(CHUNK["sphere"] * len(done) / (done[-1].end - done[0].begin) for done in of_workers if done)


def rows(most: int, chunks: int, seed: int, estimators: tuple[str, ...]) -> list[Row]:
    """Return a row for each number of workers up to ``most``."""
    found: dict[int, list[Rates]] = {workers: [] for workers in range(1, most + 1)}
    with progress() as bar:
        line = bar.add_task("sweeps", total=REPEATS * most)
        for repeat in range(REPEATS):
            for workers in sorted(found, reverse=bool(repeat % 2)):
                found[workers].append(rates(workers, chunks, seed, estimators))
                bar.advance(line)
    best_of_one = max(one.steady for one in found[1])
    return [
        {
            "workers": workers,
            "cold": max(one.cold for one in all_rates),
            "best": max(one.steady for one in all_rates),
            "median": float(np.median([one.steady for one in all_rates])),
            "per_cpu_second": float(np.median([one.cpu for one in all_rates])),
            "linear": max(one.steady for one in all_rates) / (workers * best_of_one),
        }
        for workers, all_rates in found.items()
    ]


def main() -> None:
    """Run the benchmark."""
    options = parser("sweep_speed", __doc__, "chunks", 100, f"chunks of {CHUNK['sphere']} scenes a worker")
    arguments = options.parse_args()
    most = len(os.sched_getaffinity(0))
    table = rows(most, arguments.chunks, arguments.seed, FIVE)
    columns = {
        "workers": "workers",
        "cold": "scenes/s from cold, best",
        "best": "steady, best",
        "median": "steady, median",
        "per_cpu_second": "per CPU second",
        "linear": "linear",
    }
    settings = {"seed": arguments.seed, "chunks": arguments.chunks, "estimators": list(FIVE)}
    Report(
        name="sweep_speed", settings=settings, columns=columns, rows=table, notes=NOTES.splitlines()
    ).finish(arguments)


if __name__ == "__main__":
    main()

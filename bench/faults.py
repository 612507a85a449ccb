"""Every fault of network, sensors and processes, injected: noticed, in time, nothing relaxed, recovered."""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import faults_inputs, faults_latch, faults_memory, faults_processes, faults_wire
from .common import parser
from .faults_bounds import Bounds
from .faults_judge import NotCalmError
from .faults_report import report
from .faults_rig import ROBOT, Rig

GROUPS = ("memory", "wire", "input", "process", "latch")
ALONE = ("starve", "memory:evaluate")
"""Faults that would touch another rig beside this one."""

RATE_HZ = 100.0
TRIES = 5

FEW = 200
"""Injections below which a second rig takes longer to start than it saves."""

Line = dict[str, Any]


class Results:
    """All results of a run, one JSON object a line, kept as they come.

    Args:
        path: The file; what it holds already counts.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self.lines: list[Line] = []
        if path.exists():
            for text in path.read_text(encoding="utf-8").splitlines():
                try:
                    self.lines.append(json.loads(text))
                except ValueError:
                    continue  # the end of a run that was interrupted

    def add(self, line: Line) -> None:
        """Keep a result."""
        with self._lock:
            self.lines.append(line)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")

    def done(self) -> Counter[tuple[str, str]]:
        """Return how many injections there are already, by group and fault."""
        with self._lock:
            return Counter((line["group"], line["fault"]) for line in self.lines if not line.get("void"))


@dataclass(frozen=True, slots=True)
class Task:
    """One injection to be made."""

    group: str
    fault: str
    run: Callable[[Rig, Bounds, random.Random], Line]


def tasks(group: str, wire: int, process: int, seed: int) -> Iterator[Task]:
    """Yield the injections of a group as they are to be made: every fault once before any twice."""
    if group == "wire":
        for shot in faults_wire.shots(wire, seed):
            yield Task(
                "wire", shot.fault, lambda rig, bounds, rng, s=shot: faults_wire.inject(rig, bounds, s, rng)
            )
        return
    module, names = {
        "input": (faults_inputs, faults_inputs.NAMES),
        "process": (faults_processes, tuple(faults_processes.FAULTS)),
        "latch": (faults_latch, tuple(faults_latch.FAULTS)),
    }[group]
    for _ in range(process):
        for name in names:
            yield Task(group, name, lambda rig, bounds, rng, n=name, f=module: f.inject(rig, bounds, n, rng))


def missing(wanted: Iterable[Task], results: Results) -> list[Task]:
    """Return the injections that a run before has not made."""
    left = results.done()
    rest = []
    for task in wanted:
        if left[task.group, task.fault] > 0:
            left[task.group, task.fault] -= 1
        else:
            rest.append(task)
    return rest


def work(todo: list[Task], profile: str, seed: int, results: Results) -> None:
    """Make injections on a rig of its own; one that no longer becomes calm is replaced, and that is said."""
    rng = random.Random(seed)
    bounds = Bounds.of(ROBOT, RATE_HZ)
    place = 0
    begun = time.monotonic()
    while place < len(todo):
        with Rig(profile=profile, rate_hz=RATE_HZ, seed=seed) as rig:
            while place < len(todo):
                task = todo[place]
                place += 1
                try:
                    results.add(_tried(task, rig, bounds, rng))
                except (NotCalmError, RuntimeError, OSError) as error:
                    results.add(
                        {
                            "group": task.group,
                            "fault": task.fault,
                            "cell": "",
                            "void": True,
                            "error": str(error),
                        }
                    )
                    break
                if place % 50 == 0:
                    each = (time.monotonic() - begun) / place
                    left = each * (len(todo) - place) / 60
                    _say(f"{task.group}: {place} of {len(todo)}, {left:.0f} min to go")


def _tried(task: Task, rig: Rig, bounds: Bounds, rng: random.Random) -> Line:
    """Make one injection; again where it fell into a hiccup of the machine, so that nothing was learnt."""
    line: Line = {}
    for _ in range(TRIES):
        line = task.run(rig, bounds, rng)
        if not line.get("void"):
            break
    return line


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def run(arguments: argparse.Namespace, results: Results) -> None:
    """Make all injections: three rigs side by side, then alone what would touch another rig."""
    wanted = {
        group: [task for task in _wanted(arguments, results, group) if _chosen(task, arguments)]
        for group in arguments.only
        if group != "memory"
    }
    by_process = wanted.get("process", [])
    alone = [task for task in by_process if task.fault in ALONE]
    usual = arguments.profile
    lanes = [
        [(wanted.get("wire", []), usual)],
        [([task for task in by_process if task.fault not in ALONE], usual)],
        [(wanted.get("input", []), usual), (wanted.get("latch", []), "latched")],
    ]
    if sum(len(todo) for lane in lanes for todo, _ in lane) < FEW:
        together = [task for lane in lanes for todo, profile in lane if profile == usual for task in todo]
        lanes = [[(together, usual), lanes[2][1]]]
    threads = [
        threading.Thread(target=_work_through, args=(lane, arguments.seed + index, results))
        for index, lane in enumerate(lanes)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    work(alone, usual, arguments.seed, results)
    if "memory" in arguments.only and not any(line["group"] == "memory" for line in results.lines):
        for line in faults_memory.measure(arguments.in_process, arguments.seed):
            results.add(line)


def _wanted(arguments: argparse.Namespace, results: Results, group: str) -> list[Task]:
    return missing(tasks(group, arguments.injections, arguments.processes, arguments.seed), results)


def _chosen(task: Task, arguments: argparse.Namespace) -> bool:
    return not arguments.faults or task.fault in arguments.faults


def _work_through(lane: list[tuple[list[Task], str]], seed: int, results: Results) -> None:
    for todo, profile in lane:
        work(todo, profile, seed, results)


def _arguments() -> argparse.Namespace:
    asked = parser("faults", __doc__, "injections", 20, "real injections of each wire fault")
    asked.add_argument(
        "--processes", type=int, default=2, help="of each input and process fault (default: %(default)s)"
    )
    asked.add_argument(
        "--in-process",
        type=int,
        default=1_000_000,
        help="injections without a network (default: %(default)s)",
    )
    asked.add_argument("--full", action="store_true", help="1,000 of each wire fault, 100 of each other")
    asked.add_argument(
        "--only", nargs="+", choices=GROUPS, default=list(GROUPS), help="groups (default: all)"
    )
    asked.add_argument("--faults", nargs="+", metavar="FAULT", help="only these, as the table names them")
    asked.add_argument("--profile", default="distances", help="zone profile (default: %(default)s)")
    asked.add_argument(
        "--lines",
        type=Path,
        metavar="FILE",
        help="keep each result there at once, and go on from what it holds",
    )
    arguments = asked.parse_args()
    if arguments.full:
        arguments.injections, arguments.processes = 1000, 100
    return arguments


def main() -> None:
    """Measure and print."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        results = Results(arguments.lines or Path(folder) / "faults.jsonl")
        interrupted = False
        try:
            run(arguments, results)
        except KeyboardInterrupt:
            interrupted = True
        report(arguments, results.lines, interrupted=interrupted).finish(arguments)


if __name__ == "__main__":
    main()

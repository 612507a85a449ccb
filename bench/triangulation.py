"""What each estimator makes of random scenes round the ring, beside Coal's exact distance.

Draws arm configurations and obstacles, computes what the ring would read, and compares every estimator with
the exact distance of the link that carries the ring, and of the whole arm. The same seed gives the same
results to the last digit, whatever the number of workers; with ``--out`` a run that was interrupted goes on
where it was.

The chunks of the sweep go through any executor of ``concurrent.futures``. Processes of this machine are the
default (``--workers``). With the extra ``dask`` (``pip install ssm-service[dask]``) the same sweep runs on
a cluster: start ``python -m dask scheduler`` and, in this folder on each machine, ``python -m dask worker
tcp://HOST:8786 --nthreads 1 --nworkers auto``, then add ``--dask tcp://HOST:8786``. All need the same
versions. A cluster's ports must not be open to strangers: whoever reaches them runs code.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from ssm_service.errors import ConfigError
from ssm_service.model import Robot

from . import sweep
from .common import parser, progress
from .sweep import Arrays
from .triangulation_chunk import Settings, Task, tasks, work
from .triangulation_claims import CHAMPION, contests, coverage
from .triangulation_estimators import ESTIMATORS
from .triangulation_figures import draw_all
from .triangulation_notes import notes
from .triangulation_points import point_rows
from .triangulation_report import SweepReport
from .triangulation_strata import all_rows, touching

ROBOT = "ur3"
ARM_EVERY = 10
POINTS = 2000
SCENES = 100_000
PARTS = {"sphere": 1, "forearm": 20, "hand": 20, "person": 50}
"""Of ball scenes there are so many times more."""


def counts(scenes: int) -> dict[str, int]:
    """Return the number of scenes of each shape."""
    return {shape: max(1, scenes // part) for shape, part in PARTS.items()}


def measure(
    settings: Settings, scenes: dict[str, int], folder: Path, arguments: argparse.Namespace
) -> dict[str, Arrays]:
    """Do what is missing of the sweep and return all of it by shape."""
    todo = tasks(settings, scenes)
    store = sweep.Store(folder=folder)
    with ExitStack() as stack:
        workers = arguments.workers
        if arguments.dask:
            executor, workers = stack.enter_context(sweep.dask(arguments.dask))
        else:
            executor = stack.enter_context(sweep.local(workers))
        bar = stack.enter_context(progress())
        line = bar.add_task("chunks", total=len(todo))

        def done(task: Task) -> None:
            bar.advance(line)

        sweep.complete(work, todo, store, executor, max(1, workers), done)
    places: dict[str, list[int]] = {shape: [] for shape in scenes}
    for place, task in enumerate(todo):
        places[task.shape].append(place)
    return {shape: sweep.merged(store, which) for shape, which in places.items()}


def report(settings: Settings, scenes: dict[str, int], found: dict[str, Arrays]) -> SweepReport:
    """Return what came out."""
    robot = Robot.load(settings.robot)
    ring = robot.sensor_arrays[0].rings[0]
    profile = robot.config.file.profiles[robot.config.file.default_profile]
    if profile.red is None or profile.yellow is None:
        raise ConfigError(robot.config.path, "default_profile", "no zones by distance", "`red` and `yellow`")
    edges = (profile.red.distance_m, profile.yellow.distance_m)
    noises, names = settings.noises, settings.estimators
    rows = [r for shape in found for r in all_rows(found[shape], shape, noises, names, ring.count, edges)]
    rivals = tuple(name for name in ("corrected", "nearest") if name in names)
    fights = [
        r
        for shape in found
        if CHAMPION in names
        for r in contests(found[shape], shape, noises, ring.count, rivals=rivals)
    ]
    extra = {
        "coverage": coverage(found["sphere"]),
        "contests": fights,
        "points": point_rows(robot, settings.seed, POINTS),
        "touching": [{"shape": shape, **touching(found[shape])} for shape in found],
    }
    return SweepReport(
        name="triangulation",
        settings={**settings.to_builtins(), "scenes": scenes},
        columns={"shape": "shape", "noise": "noise", "stratum": "stratum", "estimator": "estimator"},
        rows=rows,
        notes=notes(robot, settings, rows, fights),
        extra=extra,
        draw=lambda path: draw_all(path.parent, found, rows, names),
    )


def _arguments() -> argparse.Namespace:
    options = parser(
        "triangulation", __doc__, "scenes", SCENES, "ball scenes; of the other shapes there are fewer"
    )
    options.add_argument(
        "--workers",
        type=_at_least_none,
        default=len(os.sched_getaffinity(0)),
        metavar="N",
        help="processes; 0 for none but this one (default: %(default)s)",
    )
    options.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler, instead of processes here")
    options.add_argument(
        "--full", action="store_true", help=f"the whole arm for every ball, not one in {ARM_EVERY}"
    )
    options.add_argument(
        "--estimators", nargs="+", choices=ESTIMATORS, default=ESTIMATORS, metavar="NAME",
        help=f"of {', '.join(ESTIMATORS)} (default: all)",
    )  # fmt: skip
    return options.parse_args()


def _at_least_none(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


def main() -> None:
    """Run the benchmark."""
    arguments = _arguments()
    settings = Settings(
        robot=ROBOT,
        seed=arguments.seed,
        estimators=tuple(name for name in ESTIMATORS if name in arguments.estimators),
        arm_every=1 if arguments.full else ARM_EVERY,
    )
    scenes = counts(arguments.scenes)
    name = sweep.key({**settings.to_builtins(), "scenes": scenes})
    with ExitStack() as stack:
        if arguments.out is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="triangulation-")))
        else:
            folder = arguments.out / "chunks" / name
        begin = time.perf_counter()
        try:
            found = measure(settings, scenes, folder, arguments)
        except KeyboardInterrupt:
            kept = "" if arguments.out is None else "; the same command goes on from here"
            sys.exit(f"interrupted{kept}")
        except TimeoutError as error:
            sys.exit(f"{arguments.dask or 'the executor'} does not answer: {error}")
        made = report(settings, scenes, found)
        seconds = time.perf_counter() - begin
        made.run = {"workers": arguments.dask or arguments.workers, "seconds": round(seconds, 1)}
        made.finish(arguments)


if __name__ == "__main__":
    main()

"""``lower_bound``: ever above Coal's distance? How near to a brute-force infimum, and at what cost?"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import numpy as np

from ssm_service.model import LinkDistance, Robot
from ssm_service.perception import LowerBound

from .bound_scenes import CASES, LINK, Case, draw, sensors
from .brute import MeshTruth, least_ball
from .common import Report, Row, parser, progress

BATCH = 5_000
TIMED = 300
NOTES = """\
A scene violates the bound where it is above Coal's distance from the link's mesh by more than 1e-6 m, or \
where no admissible ball is found although there is one. 'nearest to it' is the least distance less the bound.
'to the truth' is the median distance less the bound: the price of the ring, not of the computation.
Brute force: the nearest ball that a random search with local steps finds, less the bound; what it misses \
counts against the bound. For `one` obstacle, scenes with an echo, ε of 1 mm or more.
'cold': the first time of a scan, one call each; 'sweep': microseconds a scene of all scenes together, while \
the table of single echoes is filled.\
"""


class Subject:
    """One configuration, ready to be asked."""

    def __init__(self, case: Case, robot: Robot, surface: LinkDistance) -> None:
        self.case = case
        self.array = sensors(robot, case.design)
        self.bound = LowerBound(self.array, surface, case.assumptions)


def soundness(subject: Subject, truth: MeshTruth, scenes: int, rng: np.random.Generator, step: Any) -> Row:
    """Ask for ``scenes`` scenes, compare with Coal, and return the figures."""
    done, violations, worst, spent = 0, 0, math.inf, 0.0
    price = []
    while done < scenes:
        readings, distances, _, _ = draw(subject.case, subject.array, truth, min(BATCH, 2 * scenes), rng)
        readings, distances = readings[: scenes - done], distances[: scenes - done]
        begin = time.perf_counter()
        bounds = subject.bound.of_many(readings)
        spent += time.perf_counter() - begin
        margin = np.where(np.isnan(bounds), -np.inf, distances - bounds)
        violations += int((margin < -1e-6).sum())
        worst = min(worst, float(margin.min()))
        price.append(margin)
        done += len(readings)
        step(len(readings))
    return {
        "scenes": done,
        "violations": violations,
        "nearest_um": 1e6 * worst,
        "price_mm": 1e3 * float(np.median(np.concatenate(price))),
        "sweep_us": 1e6 * spent / done,
        "silent_mm": 1e3 * subject.bound.silent,
    }


def cold(subject: Subject, truth: MeshTruth, rng: np.random.Generator) -> Row:
    """Time single calls for scans that were not asked for before."""
    readings, _, _, _ = draw(subject.case, subject.array, truth, 3 * TIMED, rng)
    times = []
    for scan in readings[:TIMED]:
        begin = time.perf_counter()
        subject.bound.of(scan)
        times.append(1e6 * (time.perf_counter() - begin))
    return {"cold_p50_us": float(np.median(times)), "cold_p99_us": float(np.percentile(times, 99))}


def tightness(subject: Subject, truth: MeshTruth, scenes: int, rng: np.random.Generator, step: Any) -> Row:
    """Compare with brute force on scenes with an echo; a third of them with two or more, if there are."""
    found: list[float] = []
    readings, _, centres, radii = draw(subject.case, subject.array, truth, 20 * scenes + 100, rng)
    echoes = np.isfinite(readings).sum(axis=1)
    several, single = np.flatnonzero(echoes > 1)[: scenes // 3], np.flatnonzero(echoes == 1)
    for i in np.concatenate([several, single])[:scenes]:
        bound = subject.bound.of(readings[i])
        hints = centres[i], radii[i]
        if bound.centre is not None:
            hints = np.vstack([hints[0], bound.centre]), np.append(hints[1], bound.radius)
        least = least_ball(truth, subject.array, subject.case.assumptions, readings[i], rng, hints)
        found.append(1e3 * (least.distance - (math.inf if bound.distance is None else bound.distance)))
        step(1)
    return {
        "brute_scenes": len(found),
        "brute_least_mm": min(found),
        "brute_p50_mm": float(np.median(found)),
        "brute_most_mm": max(found),
    }


def measure(arguments: argparse.Namespace) -> list[Row]:
    """Run all configurations."""
    robot = Robot.load("ur3")
    truth, surface = MeshTruth(robot, LINK), LinkDistance(robot, LINK)
    each = max(1, arguments.scenes // len(CASES))
    brute = [case for case in CASES if not case.many and case.error >= 1e-3]
    rows = []
    with progress() as bar:
        task = bar.add_task("scenes", total=each * len(CASES))
        second = bar.add_task("brute force", total=arguments.brute // len(brute) * len(brute))
        for number, case in enumerate(CASES):
            seeds = np.random.SeedSequence([arguments.seed, number]).spawn(3)
            rngs = [np.random.default_rng(seed) for seed in seeds]
            subject = Subject(case, robot, surface)
            row: Row = {
                "design": case.design,
                "sensors": len(subject.array.indices),
                "radii": f"{case.radius_min:g}–{case.radius_max:g}",
                "error_mm": 1e3 * case.error,
                "obstacles": f"many ({case.balls})" if case.many else "one",
                **cold(subject, truth, rngs[0]),
                **soundness(subject, truth, each, rngs[1], lambda n: bar.advance(task, n)),
            }
            if case in brute and arguments.brute >= len(brute):
                share = arguments.brute // len(brute)
                row |= tightness(subject, truth, share, rngs[2], lambda n: bar.advance(second, n))
            rows.append(row)
    return rows


def main() -> None:
    """Run the benchmark."""
    options = parser("bound", __doc__, "scenes", 100_000, "scenes, all configurations together")
    options.add_argument(
        "--brute", type=int, default=1000, metavar="N", help="scenes of brute force (default: %(default)s)"
    )
    arguments = options.parse_args()
    columns = {
        "design": "rings",
        "sensors": "sensors",
        "radii": "R [m]",
        "error_mm": "ε [mm]",
        "obstacles": "obstacles",
        "scenes": "scenes",
        "violations": "violations",
        "nearest_um": "nearest to it [µm]",
        "price_mm": "to the truth [mm]",
        "silent_mm": "silent bound [mm]",
        "brute_scenes": "brute force",
        "brute_least_mm": "least [mm]",
        "brute_p50_mm": "p50 [mm]",
        "brute_most_mm": "most [mm]",
        "cold_p50_us": "cold p50 [µs]",
        "cold_p99_us": "p99 [µs]",
        "sweep_us": "sweep [µs]",
    }
    Report(
        name="bound",
        settings={
            "robot": "ur3",
            "seed": arguments.seed,
            "scenes": arguments.scenes,
            "brute": arguments.brute,
        },
        columns=columns,
        rows=measure(arguments),
        notes=NOTES.splitlines(),
    ).finish(arguments)


if __name__ == "__main__":
    main()

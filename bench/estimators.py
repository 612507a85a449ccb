"""Time of the estimators on one scan of the UR3's ring, each alone and all together."""

from __future__ import annotations

import gc
import random
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from ssm_service.model import LinkDistance, Robot
from ssm_service.monitor import Estimators
from ssm_service.perception import LowerBound, SphereFit, estimate, sphere_readings

from .common import PERCENTILES, Report, Row, figure, parser, percentiles, progress

Call = Callable[[NDArray[np.float64]], Any]
Times = dict[tuple[str, str], list[int]]

SCANS = {"as drawn": 0, "with an echo": 1, "with two echoes": 2}
BLOCK = 50
WARM_UP = 3
NOTES = """\
Balls of 5 cm, bearing uniform, gap from the ring's cylinder uniform in 0.01 to 0.5 m, centre within ±0.1 m \
of the ring's plane; 'with an echo' and 'with two echoes' keep only those. Every call gets another scan. \
The errors of the readings are uniform in ±6 cm, the device's declared accuracy.
'all' is what `evaluate` calls: all five estimators, positions in the base frame included. 'the paper's' is \
as_printed, corrected and nearest in one call.
lower_bound remembers single echoes by 0.25 mm. As written, its memory was empty at first, so that most \
single echoes are new to it. 'known' is measured afterwards, with every single echo of the scans remembered. \
Two echoes and more are worked out anew each time.
All variants take turns in blocks in random order; the first calls of a block are not counted. The garbage \
collector is off, as in the service. 'to nearest' is the ratio of the p50 to that of a bare `argmin`.\
"""


def main() -> None:
    """Run the benchmark."""
    arguments = parser("estimators", __doc__, "scans", 2000, "scans for each row").parse_args()
    rows = _measure(arguments.scans, arguments.seed)
    Report(
        name="estimators",
        settings={"seed": arguments.seed, "scans": arguments.scans},
        columns={
            "scans": "scans",
            "what": "what",
            **{f"{name}_us": f"{name} [µs]" for name in PERCENTILES},
            "to_nearest": "to nearest",
        },
        rows=rows,
        notes=NOTES.splitlines(),
        draw=lambda path: _draw(path, rows),
    ).finish(arguments)


def draw_scans(robot: Robot, count: int, echoes: int, seed: int) -> NDArray[np.float64]:
    """Return readings (count, 8) of random balls with at least so many echoes [m]; ``inf`` for none."""
    ring, rng = robot.rings[0], np.random.default_rng([seed, echoes])
    kept: list[NDArray[np.float64]] = []
    while len(kept) < count:
        bearing, gap = rng.uniform(-np.pi, np.pi, 4000), rng.uniform(0.01, 0.5, 4000)
        from_axis = ring.radius + gap + 0.05
        centres = np.stack(
            (from_axis * np.cos(bearing), from_axis * np.sin(bearing), rng.uniform(-0.1, 0.1, 4000)), axis=-1
        )
        T = ring.transform_sensors_to_ring
        local = np.einsum("nki,kij->nkj", centres[:, None] - T[None, :, :3, 3], T[:, :3, :3])
        readings = sphere_readings(local, 0.05, ring.half_angle)
        readings[readings > ring.range_max] = np.inf
        erring = readings + rng.uniform(-ring.accuracy, ring.accuracy, readings.shape)
        readings = np.where(np.isinf(readings), np.inf, np.clip(erring, 0.0, ring.range_max))
        kept.extend(readings[np.isfinite(readings).sum(axis=1) >= echoes])
    return np.array(kept[:count])


def _variants(robot: Robot, estimators: Estimators) -> dict[str, Call]:
    ring, array, assumptions = robot.rings[0], robot.sensor_arrays[0], robot.config.file.assumptions
    if assumptions is None:
        raise SystemExit("the robot file makes no assumptions")
    surface = LinkDistance(robot, array.link)
    fit, bound = SphereFit(array, surface, assumptions), LowerBound(array, surface, assumptions)
    kinematics = robot.kinematics(robot.rest_position)
    pose = kinematics.transform_rings_to_base[0]
    return {
        "argmin": lambda readings: readings.argmin(),
        "the paper's": lambda readings: estimate(ring, readings, pose),
        "sphere_fit": fit.of,
        "lower_bound": bound.of,
        "all": lambda readings: estimators.of(readings, kinematics),
    }


def _known(robot: Robot, estimators: Estimators, scans: Iterable[NDArray[np.float64]]) -> dict[str, Call]:
    """Return the variants whose memory holds every single echo of ``scans``."""
    bound = estimators.bound(robot.sensor_arrays[0].link)
    if bound is None:
        raise SystemExit("the robot file makes no assumptions")
    for readings in scans:
        bound.of_many(readings)
    kinematics = robot.kinematics(robot.rest_position)
    return {
        "lower_bound, known": bound.of,
        "all, known": lambda readings: estimators.of(readings, kinematics),
    }


def _measure(count: int, seed: int) -> list[Row]:
    robot, shuffler = Robot.load("ur3"), random.Random(seed)
    estimators = Estimators(robot)
    scans = {name: draw_scans(robot, count + WARM_UP, echoes, seed) for name, echoes in SCANS.items()}
    times: Times = {}
    with progress() as bar:
        _time(_variants(robot, estimators), scans, times, bar, shuffler)
        _time(_known(robot, estimators, scans.values()), scans, times, bar, shuffler)
    whats = list(dict.fromkeys(what for _, what in times))
    return [_row(scan, what, times) for scan in SCANS for what in whats]


def _time(
    variants: dict[str, Call],
    scans: dict[str, NDArray[np.float64]],
    times: Times,
    bar: Progress,
    shuffler: random.Random,
) -> None:
    """Add the times of ``variants`` [ns] to ``times``."""
    times.update({(scan, what): [] for scan in scans for what in variants})
    count = min(map(len, scans.values())) - WARM_UP
    blocks = [(scan, what, start) for scan in scans for what in variants for start in range(0, count, BLOCK)]
    shuffler.shuffle(blocks)
    gc.collect()
    gc.disable()
    try:
        for scan, what, start in bar.track(blocks, description="estimators"):
            call, taken = variants[what], times[scan, what]
            for number, readings in enumerate(scans[scan][start : start + BLOCK + WARM_UP]):
                begin = time.perf_counter_ns()
                call(readings)
                if number >= WARM_UP:
                    taken.append(time.perf_counter_ns() - begin)
    finally:
        gc.enable()


def _row(scan: str, what: str, times: Times) -> Row:
    found = percentiles(times[scan, what])
    bare = percentiles(times[scan, "argmin"])["p50"]
    return {
        "scans": scan,
        "what": what,
        **{f"{name}_us": value for name, value in found.items()},
        "to_nearest": found["p50"] / bare,
    }


def _draw(path: Path, rows: list[Row]) -> None:
    def bars(axes: Any) -> None:
        names = list(dict.fromkeys(row["what"] for row in rows))
        for offset, scan in enumerate(SCANS):
            values = [row["p50_us"] for row in rows if row["scans"] == scan]
            axes.bar(np.arange(len(names)) + 0.25 * offset, values, 0.25, label=scan)
        axes.set_xticks(np.arange(len(names)) + 0.25, names)
        axes.set_ylabel("median time of one scan [µs]")
        axes.legend()

    figure(path, 10.0, 4.0, bars)


if __name__ == "__main__":
    main()

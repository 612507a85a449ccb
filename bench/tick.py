"""Time of one tick: the UR3 and 1, 10 and 100 spheres, beside the bare distance call; and of the wire."""

from __future__ import annotations

import gc
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import cycle, product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from ssm_service.model import Robot
from ssm_service.model.hulls import build_parts
from ssm_service.monitor import Decision, Inputs, Monitor, default_valid_for
from ssm_service.wire import VALUES, Decoder, command_message, zone_message
from ssm_service.wire.messages import INPUTS

from .common import PERCENTILES, Report, Row, figure, parser, percentiles, progress
from .scenes import FARTHEST_M, NEAREST_M, RADIUS_M, Scene, draw_scenes, how_drawn

COUNTS = (1, 10, 100)
PACES = {"tight": 0.0, "2 ms sleeps": 0.002}
POOL = 200
BLOCK = 50
WARM_UP = 3

STEP, STEADY, FLOOR, WIRE, SCAN = "step", "steady", "floor", "wire", "scan"
WHAT = {
    STEP: "`Monitor.step`, all new",
    STEADY: "`Monitor.step`, new joints",
    SCAN: "prepare a scan",
    FLOOR: "bare `pin.computeDistances`",
    WIRE: "decode 4 inputs, encode 2 outputs",
}
NOTES = f"""\
{WHAT[STEADY]}: as in most ticks of a service; messages of the other sources come 6 to 30 times a second.
{WHAT[STEP]}: joints, readings, obstacle poses and target are new in every tick; kinematics, exact nearest \
pair, zone, limits and command are included. Its inputs are checked values; making them of messages is the \
row 'decode …'. The network itself is in neither.
{WHAT[FLOOR]}: the floor, one call on the same hull pieces and spheres, whose poses are written before the \
clock starts. It measures all pairs; a tick that leaves out those that cannot be the nearest may be below it.
{WHAT[SCAN]}: what a thread beside the loop does with each new scan, a few times a second, before a tick \
gets it: which echoes are the arm's own links (in these random configurations most scans have some).
All variants take turns in blocks of {BLOCK} ticks in random order, so that a drift of the machine hits all \
alike; the first {WARM_UP} ticks of a block, which find the caches as another variant left them, are not \
counted. The garbage collector is off, as in the service.
'per obstacle' is p50 / N; 'to floor' is the ratio of the p50.\
"""


class Floor:
    """The bare distance call on the robot's hull pieces and ``count`` spheres.

    Args:
        robot: The robot.
        count: Number of spheres.
    """

    def __init__(self, robot: Robot, count: int) -> None:
        parts = build_parts(robot)
        geometry = pin.GeometryModel()
        for part in parts:
            for piece in part.pieces:
                self._add(geometry, part.source.parentJoint, part.source.placement, piece)
        pieces = geometry.ngeoms
        for _ in range(count):
            self._add(geometry, 0, pin.SE3.Identity(), pin.coal.Sphere(RADIUS_M))
        for j in range(count):
            for piece in range(pieces):
                geometry.addCollisionPair(pin.CollisionPair(piece, pieces + j))
        self._placements = [geometry.geometryObjects[pieces + j].placement for j in range(count)]
        self._robot = robot
        self._geometry = geometry
        self._data, self._geometry_data = robot.model.createData(), pin.GeometryData(geometry)

    @staticmethod
    def _add(geometry: Any, joint: int, placement: Any, shape: Any) -> None:
        geometry.addGeometryObject(pin.GeometryObject(f"{geometry.ngeoms}", joint, 0, placement, shape))

    def prepare(self, scene: Scene) -> Callable[[], object]:
        """Write the poses and return the call."""
        for placement, obstacle in zip(self._placements, scene.obstacles, strict=True):
            placement.translation = np.array(obstacle.position)
        q = self._robot.pinocchio_configuration(scene.position)
        model, data, geometry, geometry_data = (
            self._robot.model,
            self._data,
            self._geometry,
            self._geometry_data,
        )
        return lambda: pin.computeDistances(model, data, geometry, geometry_data, q)


class Step:
    """Whole ticks of one monitor."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._monitor = Monitor(robot)
        self.last: Decision | None = None

    def prepare(self, scene: Scene) -> Callable[[], object]:
        """Make the inputs and return the tick."""
        inputs = scene.inputs(self._robot)
        reader, ranges = self._monitor.range_reader, inputs.ranges.value
        if ranges is not None:  # beside the loop, as in the service
            reader.take(reader.prepare(ranges, scene.position))
        return lambda: self._monitor.step(inputs)


class Steady(Step):
    """Ticks as most are: only the joints are new; scan, obstacles and target are as before."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._before: Inputs | None = None

    def prepare(self, scene: Scene) -> Callable[[], object]:
        """Make the inputs and return the tick."""
        inputs = scene.inputs(self._robot)
        if self._before is None:
            self._before = inputs
            super().prepare(scene)
        inputs = msgspec.structs.replace(self._before, joints=inputs.joints)
        return lambda: self._monitor.step(inputs)


class Prepare:
    """What the service's other thread does with each scan: own links, and what counts of the readings."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._reader = Monitor(robot).range_reader

    def prepare(self, scene: Scene) -> Callable[[], object]:
        """Make the readings and return the call."""
        ranges = scene.inputs(self._robot).ranges.value
        if ranges is None:
            raise RuntimeError("a scene without readings")
        return lambda: self._reader.prepare(ranges, scene.position)


class Wire:
    """Both ways through the wire for one tick: four payloads to values, one decision to two payloads."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._monitor = Monitor(robot)
        self._decoders = {name: Decoder(kind) for name, kind in INPUTS.items()}
        self._encoder = msgspec.json.Encoder()
        self._names = list(robot.joint_names)
        self._profile = self._monitor.profile.name
        self._valid_for_ns = round(default_valid_for(0.002) * 1e9)

    def prepare(self, scene: Scene) -> Callable[[], object]:
        """Make payloads and a decision and return the passage."""
        payloads = scene.payloads(self._robot, seq=1)
        decision = self._monitor.step(scene.inputs(self._robot))
        return lambda: self._pass(payloads, decision)

    def _pass(self, payloads: dict[str, bytes], decision: Decision) -> tuple[bytes, bytes]:
        for name, payload in payloads.items():
            VALUES[name](self._robot, self._decoders[name].decode(payload))
        common = {
            "producer": "bench",
            "stamp_ns": time.time_ns(),
            "valid_for_ns": self._valid_for_ns,
            "robot": self._robot.name,
            "name": self._names,
        }
        zone = zone_message(decision, profile=self._profile, **common)
        return self._encoder.encode(zone), self._encoder.encode(command_message(decision, **common))


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One line of the table.

    Attributes:
        pace: Name of the pace.
        what: What is timed.
        count: Number of obstacles.
        work: Prepares one tick.
        scenes: What it takes in turn, without end.
        times_ns: What was measured.
    """

    pace: str
    what: str
    count: int
    work: Floor | Step | Wire | Prepare
    scenes: Iterator[Scene]
    times_ns: list[int]

    def run(self, ticks: int) -> None:
        """Measure ``ticks`` ticks in the variant's pace."""
        sleep = PACES[self.pace]
        for i in range(ticks + WARM_UP):
            call = self.work.prepare(next(self.scenes))
            if sleep:
                time.sleep(sleep)
            begin = time.perf_counter_ns()
            call()
            taken = time.perf_counter_ns() - begin
            if i >= WARM_UP:
                self.times_ns.append(taken)


def variants(robot: Robot, ticks: int, seed: int, farthest_m: float = FARTHEST_M) -> list[Variant]:
    """Return all variants, in the order of the table; those of one N see the same scenes."""
    made = []
    pool = max(2, min(ticks, POOL))
    scenes = {count: draw_scenes(robot, count, pool, seed, farthest_m) for count in COUNTS}
    for pace in PACES:
        for what in WHAT:
            for count in COUNTS:
                work = (
                    {STEP: Step, STEADY: Steady, WIRE: Wire, SCAN: Prepare}[what](robot)
                    if what != FLOOR
                    else Floor(robot, count)
                )
                made.append(
                    Variant(
                        pace=pace,
                        what=what,
                        count=count,
                        work=work,
                        scenes=cycle(scenes[count]),
                        times_ns=[],
                    )
                )
    return made


def measure(all_variants: list[Variant], ticks: int, seed: int) -> None:
    """Run all variants in interleaved blocks until each has ``ticks`` ticks."""
    order = random.Random(seed)
    blocks = [min(BLOCK, ticks - done) for done in range(0, ticks, BLOCK)]
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with progress() as bar:
            task = bar.add_task("ticks", total=len(blocks) * len(all_variants))
            for block in blocks:
                for variant in order.sample(all_variants, len(all_variants)):
                    variant.run(block)
                    bar.advance(task)
    finally:
        gc.enable()
        gc.unfreeze()


def rows(all_variants: list[Variant]) -> list[Row]:
    """Return the table's rows."""
    floor = {
        (variant.pace, variant.count): percentiles(variant.times_ns)["p50"]
        for variant in all_variants
        if variant.what == FLOOR
    }
    table = []
    for variant in all_variants:
        taken = percentiles(variant.times_ns)
        row: Row = {
            "pace": variant.pace,
            "what": variant.what,
            "timed": WHAT[variant.what],
            "obstacles": variant.count,
            "ticks": len(variant.times_ns),
            **{f"{name}_us": value for name, value in taken.items()},
            "per_obstacle_us": taken["p50"] / variant.count,
            "ratio_to_floor": None
            if variant.what in (WIRE, SCAN)
            else taken["p50"] / floor[variant.pace, variant.count],
        }
        table.append(row)
    return table


def draw(table: list[Row], path: Path) -> None:
    """Draw p50 and p99 over the number of obstacles."""

    def lines(axes: Any) -> None:
        for (pace, style), (what, colour) in product(
            zip(PACES, ("-", "--"), strict=True), zip(WHAT, ("C0", "C3", "C2", "C7", "C1"), strict=True)
        ):
            chosen = [row for row in table if row["pace"] == pace and row["what"] == what]
            counts = [row["obstacles"] * (1.0 if style == "-" else 1.06) for row in chosen]
            p50, p99 = (np.array([row[f"{name}_us"] for row in chosen]) for name in ("p50", "p99"))
            bars = [np.zeros(len(p50)), p99 - p50]
            axes.errorbar(
                counts,
                p50,
                bars,
                linestyle=style,
                color=colour,
                marker="o",
                capsize=3,
                label=f"{what}, {pace}",
            )
        axes.set(xscale="log", yscale="log", xlabel="obstacles", ylabel="time, p50 and up to p99 [µs]")
        axes.set_xticks(COUNTS, [str(count) for count in COUNTS])
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)

    figure(path, 7.0, 4.5, lines)


def main() -> None:
    """Run the benchmark."""
    options = parser("tick", __doc__, "ticks", 2000, "ticks of each row")
    options.add_argument(
        "--farthest",
        type=float,
        default=FARTHEST_M,
        metavar="M",
        help="how far from the robot a sphere may lie, in m (default: %(default)s)",
    )
    arguments = options.parse_args()
    if not 2.0 * NEAREST_M <= arguments.farthest <= 10.0:
        options.error(f"--farthest must be {2.0 * NEAREST_M} to 10 m")
    robot = Robot.load("ur3")
    chosen = variants(robot, arguments.ticks, arguments.seed, arguments.farthest)
    measure(chosen, arguments.ticks, arguments.seed)
    table = rows(chosen)
    pieces = sum(len(part.pieces) for part in build_parts(robot))
    columns = {
        "pace": "pace",
        "timed": "what",
        "obstacles": "N",
        **{f"{name}_us": f"{name} [µs]" for name in PERCENTILES},
        "per_obstacle_us": "per obstacle [µs]",
        "ratio_to_floor": "to floor",
    }
    Report(
        name="tick",
        settings={
            "robot": robot.name,
            "seed": arguments.seed,
            "ticks": arguments.ticks,
            "farthest": arguments.farthest,
        },
        columns=columns,
        rows=table,
        notes=[
            f"{len(robot.monitored_links)} links in {pieces} hull pieces.",
            how_drawn(arguments.farthest),
            *NOTES.splitlines(),
        ],
        draw=lambda path: draw(table, path),
    ).finish(arguments)


if __name__ == "__main__":
    main()

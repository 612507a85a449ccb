"""Cost of the filter: whole ticks beside those of the field, its parts, and its solver beside others."""

from __future__ import annotations

import gc
import importlib.util
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.monitor import Inputs, JointSample, Monitor, Received, Target, checked_target, joint_sample
from ssm_service.monitor.filter_rows import RowMaker
from ssm_service.monitor.snapshot import Snapshot
from ssm_service.motion import (
    Box,
    Filtered,
    VelocityFilter,
    linear_approach,
    linear_to_joints,
    softness,
    task_metric,
    velocity_box,
)
from ssm_service.motion.filter import DAMPING_M_RAD
from ssm_service.motion.self_collision import SelfCollision

from .common import PERCENTILES, Report, Row, figure, parser, percentiles, progress
from .filter_solvers import SOLVERS, Programme
from .scenes import Scene, draw_scenes

Array = NDArray[np.float64]

ROBOT = Path(__file__).parent / "avoidance_robot.toml"
OBSTACLES = 10
FARTHEST_M = {"spread": 1.5, "crowd": 0.5}
MOST_DRAWN = 4
SPEED_M_S = 0.3
PERIOD_S = 0.008
MESSAGE_TICKS = 4
RUN_TICKS = 100
WARM_UP = 3

TICKS = {"field": "`Monitor.step`, `field`", "filter": "`Monitor.step`, `filter`"}
PARTS = {
    "nearest": "nearest pair exactly",
    "rows": "rows of the pairs that can matter, also of link and link",
    "box": "box of the joints",
    "programme": "programme",
    "free": "of these, nothing in the way",
    "solved": "of these, solved",
}
NOTES = f"""\
Runs of {RUN_TICKS} ticks of {PERIOD_S} s: the arm starts at a random position at which it does not touch \
itself, among {OBSTACLES} balls that lie within {FARTHEST_M["spread"]} m of it (`spread`, as in \
`bench.tick`) or {FARTHEST_M["crowd"]} m (`crowd`) and fly straight at up to {SPEED_M_S} m/s; it obeys at \
once; a new message of obstacles every {MESSAGE_TICKS} ticks. Both controllers take turns, run by run, in \
the same scenes; each moves its own arm. The first {WARM_UP} ticks of a run are not counted.
`field` measures the nearest pair only, `filter` all that can matter; 'added' is the difference of medians.
The parts are of `crowd`, and those of another arm, driven by them alone without zones and at the speeds of \
its limits, so that more rows can matter; their sum leaves out what the monitor does besides.
'rows': how many pairs went into the programme, on average over the ticks in which it was solved.
The solvers get the same programmes, all rows, without retreats and without the check of the result; \
'unsolved' are those that it calls unsolvable (each has a solution), and 'difference' is the greatest from \
daqp's in any joint in the others [rad/s]. Those that are not installed are left out.
The garbage collector is off, as in the service.\
"""


@dataclass(kw_only=True)
class World:
    """Ten balls that fly.

    Attributes:
        scene: Where arm and balls are at first, and the target.
        velocities: (10, 3) [m/s].
        tick: Ticks so far.
        obstacles: As the last message says.
    """

    scene: Scene
    velocities: Array
    tick: int = 0
    obstacles: tuple[Obstacle, ...] = ()

    def step(self) -> None:
        """Go on by one tick."""
        if self.tick % MESSAGE_TICKS == 0:
            moved = np.array([o.position for o in self.scene.obstacles])
            moved = moved + self.tick * PERIOD_S * self.velocities
            self.obstacles = tuple(
                Obstacle(
                    id=o.id,
                    shape=o.shape,
                    size=o.size,
                    position=tuple(p.tolist()),
                    velocity=tuple(v.tolist()),
                )
                for o, p, v in zip(self.scene.obstacles, moved, self.velocities, strict=True)
            )
        self.tick += 1


def worlds(robot: Robot, count: int, seed: int, farthest_m: float) -> list[Callable[[], World]]:
    """Return makers of so many worlds, each always the same; no arm touches itself at first."""
    rng = np.random.default_rng([seed, 17])
    itself = SelfCollision(robot)
    drawn = draw_scenes(robot, OBSTACLES, MOST_DRAWN * count + 10, seed, farthest_m)
    made: list[Callable[[], World]] = []
    for scene in drawn:
        if itself.touches(scene.position):
            continue
        directions = rng.normal(size=(OBSTACLES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        velocities = directions * rng.uniform(0.0, SPEED_M_S, (OBSTACLES, 1))

        def make(scene: Scene = scene, velocities: Array = velocities) -> World:
            return World(scene=scene, velocities=velocities)

        made.append(make)
    return made[:count]


class Ticks:
    """Whole ticks of a monitor with one controller."""

    def __init__(self, robot: Robot, controller: Any) -> None:
        self._robot, self._controller = robot, controller
        self.times_ns: list[int] = []

    def run(self, world: World, ticks: int) -> None:
        """Time so many ticks in a world."""
        robot = self._robot
        monitor = Monitor(robot, period_s=PERIOD_S)
        target = checked_target(robot, "position", world.scene.target.tolist(), self._controller)
        position, velocity = world.scene.position, np.zeros(len(world.scene.position))
        for tick in range(ticks + WARM_UP):
            world.step()
            inputs = Inputs(
                joints=Received(value=joint_sample(robot, position, velocity), age_s=0.001),
                obstacles=Received(value=world.obstacles, age_s=0.001),
                target=Received(value=target, age_s=0.001),
            )
            begin = time.perf_counter_ns()
            decision = monitor.step(inputs)
            taken = time.perf_counter_ns() - begin
            if tick >= WARM_UP:
                self.times_ns.append(taken)
            velocity = decision.velocity
            position = position + PERIOD_S * velocity


@dataclass(kw_only=True)
class Parts:
    """The parts of the filter's tick, timed one by one.

    Attributes:
        robot: The robot.
        times_ns: Of each part.
        rows: Of each programme that was solved.
        kinds: How often each status came.
        retreats: Ticks with a retreat.
        programmes: Some of the programmes, for the other solvers.
    """

    robot: Robot
    times_ns: dict[str, list[int]] = field(default_factory=lambda: {name: [] for name in PARTS})
    rows: list[int] = field(default_factory=list)
    kinds: dict[str, int] = field(default_factory=dict)
    retreats: int = 0
    programmes: list[Programme] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rows = RowMaker(self.robot)
        self._distances = DistanceModel(self.robot)
        self._filter = VelocityFilter()

    def run(self, world: World, ticks: int) -> None:
        """Time so many ticks in a world."""
        free = self.robot.free
        position, command = world.scene.position.copy(), np.zeros(len(free))
        for tick in range(ticks + WARM_UP):
            world.step()
            self._distances.set_obstacles(world.obstacles)
            found, stamps, programme = self._tick(world, position, command)
            command = found.velocity
            position[free] += PERIOD_S * command
            if tick >= WARM_UP:
                self._count(found, stamps, programme)

    def _tick(self, world: World, position: Array, command: Array) -> tuple[Filtered, list[int], Programme]:
        robot, free, config = self.robot, self.robot.free, self.robot.config.file.motion
        limits = robot.config.file.limits
        kinematics = robot.kinematics(position)
        jacobian = kinematics.jacobian
        linear = linear_approach(kinematics.transform_end_effector_to_base[:3, 3], world.scene.target, config)
        wanted = linear_to_joints(jacobian, free, linear, config, len(position))[free]
        snapshot = Snapshot(
            kinematics=kinematics,
            joints=JointSample(position=position, velocity=command),
            target=Target(kind="position", value=world.scene.target),
            nearest=None,
            obstacles=world.obstacles,
        )
        stamps = [time.perf_counter_ns()]
        self._distances.nearest(position)
        stamps.append(time.perf_counter_ns())
        rows = self._rows.within(snapshot, robot.velocity_limit, self._distances)
        stamps.append(time.perf_counter_ns())
        box = velocity_box(
            position[free],
            command,
            robot.position_lower[free],
            robot.position_upper[free],
            robot.velocity_limit[free],
            limits.position_margin_rad,
            limits.acceleration_rad_s2,
            PERIOD_S,
        )
        stamps.append(time.perf_counter_ns())
        gradients, slack = rows.gradients[:, free], softness(rows.bounds, rows.approach, DAMPING_M_RAD)
        metric = task_metric(jacobian)
        found = self._filter.solve(wanted, gradients, rows.bounds, box, metric, rows.ceilings, slack)
        stamps.append(time.perf_counter_ns())
        programme = Programme(wanted=wanted, gradients=gradients, bounds=rows.bounds, box=Box(*box))
        return found, stamps, programme

    def _count(self, found: Filtered, stamps: Sequence[int], programme: Programme) -> None:
        taken = [after - before for before, after in pairwise(stamps)]
        for name, value in zip(("nearest", "rows", "box", "programme"), taken, strict=True):
            self.times_ns[name].append(value)
        self.times_ns["free" if found.status == "free" else "solved"].append(taken[-1])
        self.kinds[found.status] = self.kinds.get(found.status, 0) + 1
        self.retreats += found.retreating
        if found.status != "free":
            self.rows.append(found.rows)
            self.programmes.append(programme)


def row(what: str, times_ns: Sequence[int], **more: Any) -> Row:
    """Return one line of the table; no percentiles where nothing was timed."""
    taken = percentiles(times_ns) if times_ns else dict.fromkeys(PERCENTILES)
    return {"what": what, "calls": len(times_ns), **{f"{k}_us": v for k, v in taken.items()}, **more}


def solver_rows(programmes: Sequence[Programme]) -> list[Row]:
    """Return the cost of each solver that is installed, and how far it is from the first."""
    table: list[Row] = []
    exact: list[Array] = []
    for name, solver in SOLVERS.items():
        if importlib.util.find_spec(name) is None:
            continue
        solve = solver()
        times_ns, found = [], []
        for programme in programmes:
            prepared = programme.prepared()
            begin = time.perf_counter_ns()
            found.append(solve(*prepared))
            times_ns.append(time.perf_counter_ns() - begin)
        exact = exact or found
        off = [np.abs(one - other).max() for one, other in zip(found, exact, strict=True)]
        solved = [value for value in off if math.isfinite(value)]
        table.append(
            row(
                f"{name} {version(name)}",
                times_ns,
                unsolved=len(off) - len(solved),
                difference=None if found is exact else float(max(solved, default=math.nan)),
            )
        )
    return table


def measure(robot: Robot, ticks: int, seed: int) -> tuple[dict[str, dict[str, Ticks]], Parts]:
    """Run everything; whoever is timed takes turns, run by run."""
    runs = [min(RUN_TICKS, ticks - done) for done in range(0, ticks, RUN_TICKS)]
    makers = {place: worlds(robot, len(runs), seed, far) for place, far in FARTHEST_M.items()}
    timed = {place: {name: Ticks(robot, name) for name in TICKS} for place in FARTHEST_M}
    parts = Parts(robot=robot)
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with progress() as bar:
            task = bar.add_task("runs", total=len(runs))
            for index, count in enumerate(runs):
                for place, both in timed.items():
                    order = list(both.values())
                    for one in order if index % 2 else order[::-1]:
                        one.run(makers[place][index](), count)
                parts.run(makers["crowd"][index](), count)
                gc.collect()
                bar.advance(task)
    finally:
        gc.enable()
        gc.unfreeze()
    return timed, parts


def rows(timed: dict[str, dict[str, Ticks]], parts: Parts) -> list[Row]:
    """Return the table's rows."""
    table = []
    for place, both in timed.items():
        table += [row(f"{TICKS[name]}, {place}", one.times_ns) for name, one in both.items()]
        table[-1]["added_us"] = table[-1]["p50_us"] - table[-2]["p50_us"]
    for name, text in PARTS.items():
        share = len(parts.times_ns[name]) / len(parts.times_ns["programme"])
        mean = float(np.mean(parts.rows)) if name == "solved" and parts.rows else None
        table.append(row(text, parts.times_ns[name], share_percent=100.0 * share, rows=mean))
    return table + solver_rows(parts.programmes[:RUN_TICKS])


def draw(table: list[Row], path: Path) -> None:
    """Draw p50 and up to p99 of every row."""

    def bars(axes: Any) -> None:
        shown = [line for line in table if line["calls"]][::-1]
        p50, p99 = (np.array([line[f"{name}_us"] for line in shown]) for name in ("p50", "p99"))
        places = np.arange(len(shown))
        axes.barh(places, p50, xerr=[np.zeros(len(shown)), p99 - p50], capsize=3, color="C0")
        axes.set_yticks(places, [line["what"].replace("`", "") for line in shown])
        axes.set(xscale="log", xlabel="time, p50 and up to p99 [µs]")
        axes.grid(alpha=0.3, axis="x")

    figure(path, 7.0, 4.5, bars)


def main() -> None:
    """Run the benchmark."""
    arguments = parser("filter", __doc__, "ticks", 2000, "ticks of each controller").parse_args()
    robot = Robot.load(ROBOT)
    timed, parts = measure(robot, arguments.ticks, arguments.seed)
    table = rows(timed, parts)
    statuses = ", ".join(f"{name} {count}" for name, count in sorted(parts.kinds.items()))
    Report(
        name="filter",
        settings={"robot": ROBOT.name, "seed": arguments.seed, "ticks": arguments.ticks},
        columns={
            "what": "what",
            "calls": "calls",
            **{f"{name}_us": f"{name} [µs]" for name in PERCENTILES},
            "added_us": "added [µs]",
            "share_percent": "share of ticks [%]",
            "rows": "rows",
            "unsolved": "unsolved",
            "difference": "difference",
        },
        rows=table,
        notes=[
            f"{len(robot.monitored_links)} links, {OBSTACLES} obstacles, {len(robot.free)} free joints.",
            f"Ticks of the parts by how they ended: {statuses}; with a retreat: {parts.retreats}.",
            *NOTES.splitlines(),
        ],
        draw=lambda path: draw(msgspec.to_builtins(table), path),
    ).finish(arguments)


if __name__ == "__main__":
    main()

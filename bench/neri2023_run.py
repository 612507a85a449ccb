"""One run of a test case of [Neri2023]: the ideal loop, or one with rate, latency and lag."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from ssm_service.config import MotionConfig
from ssm_service.config.motion import ClikConfig
from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.motion import (
    LineSegmentParabolicBlend,
    LinkSegments,
    clik_velocity,
    influence_radius,
    link_segments,
    most_critical,
    pose_error,
)
from ssm_service.simulation import Plant

Array = NDArray[np.float64]

FILE = Path(__file__).with_name("neri2023.toml")
LOG_S = 0.002
"""Time from sample to sample of what is recorded and compared (the controller's 500 Hz)."""

TOOL_DOWN = np.diag([1.0, -1.0, -1.0])
CASES = {1: "line, free", 2: "line, sphere on it", 3: "standing, sphere crosses"}


class Loop(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A control loop: its rate, its gains (Table 3), and how late and slow everything in it is."""

    rate_hz: float
    repulsive_speed_m_s: float
    position_gain: float
    orientation_gain: float
    read_s: float
    send_s: float
    lag_s: float


class Line(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The planned motion of cases 1 and 2."""

    start_m: tuple[float, float, float]
    goal_m: tuple[float, float, float]
    speed_m_s: float
    acceleration_m_s2: float
    posture_rad: tuple[float, ...]


class Sphere(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The obstacle."""

    radius_m: float


class Fixed(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the sphere is in case 2."""

    centre_m: tuple[float, float, float]


class Crossing(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the robot stands, and how the sphere moves, in case 3."""

    place_m: tuple[float, float, float]
    from_m: tuple[float, float, float]
    to_m: tuple[float, float, float]
    speed_m_s: float


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file ``neri2023.toml``."""

    horizon_s: float
    deadline_s: float
    tolerance_m: float
    line: Line
    sphere: Sphere
    fixed: Fixed
    crossing: Crossing
    table1: dict[str, float]
    ideal: Loop
    real: Loop
    other_readings: dict[str, Loop] = {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """One run.

    Attributes:
        case: 1, 2 or 3.
        mode: 1, 2 or 3.
        loop: Of ``Scenario``: ``ideal``, ``real``, or one of the other readings of Table 3.
    """

    case: int
    mode: int
    loop: str


@dataclass(slots=True, kw_only=True, eq=False)
class Track:
    """What was recorded, m samples every ``LOG_S``.

    Attributes:
        time: (m,) [s].
        joints: (m, 6) [rad].
        speeds: (m, 6) [rad/s].
        place: (m, 3) of the tool's end [m], world frame.
        off: (m,) distance from where it was to be [m].
        turned: (m,) angle from the orientation that it was to have [rad].
        tilt: (m,) angle of the tool's axis from the vertical [rad].
        distance: (m,) of the whole arm and tool from the sphere, exact [m]; infinite without one.
        centre: (m, 3) of the sphere [m]; NaN without one.
        cut: Share of the ticks at which a joint was cut at its greatest speed.
    """

    time: Array
    joints: Array
    speeds: Array
    place: Array
    off: Array
    turned: Array
    tilt: Array
    distance: Array
    centre: Array
    cut: float


@cache
def scenario() -> Scenario:
    """Return the file."""
    return msgspec.toml.decode(FILE.read_bytes(), type=Scenario)


@cache
def robot() -> Robot:
    """Return the UR5e."""
    return Robot.load("ur5e")


@cache
def _segments() -> LinkSegments:
    return link_segments(robot())


@cache
def _distance() -> DistanceModel:
    return DistanceModel(robot())


def loop_of(name: str) -> Loop:
    """Return a loop by name."""
    chosen = scenario()
    return {"ideal": chosen.ideal, "real": chosen.real, **chosen.other_readings}[name]


def config_of(loop: Loop) -> MotionConfig:
    """Return the controller's configuration: Table 1, and the loop's gains."""
    table = dict(scenario().table1)
    damping = {name: table.pop(name) for name in ("singular_value_threshold", "max_damping")}
    gains = {
        name: getattr(loop, name) for name in ("repulsive_speed_m_s", "position_gain", "orientation_gain")
    }
    return MotionConfig(clik=ClikConfig(**table, **gains), **damping)


class Task:
    """What the tool's end is to do in one case, and where the sphere is."""

    def __init__(self, case: int) -> None:
        self.case = case
        chosen = scenario()
        line, self._crossing = chosen.line, chosen.crossing
        self._line = LineSegmentParabolicBlend(
            start=np.array(line.start_m),
            goal=np.array(line.goal_m),
            speed=line.speed_m_s,
            acceleration=line.acceleration_m_s2,
        )
        self.start = np.array(self._crossing.place_m if case == 3 else line.start_m)

    def position(self, time_s: float) -> Array:
        """Return P_d [m]."""
        return self.start if self.case == 3 else self._line.position(time_s)

    def twist(self, time_s: float) -> Array:
        """Return ẋ, (6,)."""
        twist = np.zeros(6)
        if self.case != 3:
            twist[:3] = self._line.velocity(time_s)
        return twist

    def sphere(self, time_s: float) -> Obstacle | None:
        """Return the obstacle."""
        if self.case == 1:
            return None
        velocity, centre = np.zeros(3), np.array(scenario().fixed.centre_m)
        if self.case == 3:
            begin, end = np.array(self._crossing.from_m), np.array(self._crossing.to_m)
            way = float(np.linalg.norm(end - begin))
            share = min(time_s * self._crossing.speed_m_s / way, 1.0)
            centre = begin + share * (end - begin)
            if share < 1.0:
                velocity = self._crossing.speed_m_s * (end - begin) / way
        return Obstacle(
            id="sphere",
            shape="sphere",
            size=(scenario().sphere.radius_m,),
            position=tuple(centre.tolist()),
            velocity=tuple(velocity.tolist()),
        )


def start_joints(place: Array) -> Array:
    """Return joint positions, (6,), with the tool straight down at a place [m], from the file's posture."""
    q = np.array(scenario().line.posture_rad)
    for _ in range(200):
        kinematics = robot().kinematics(q)
        pose = kinematics.transform_end_effector_to_base
        error = pose_error(pose[:3, 3], pose[:3, :3], place, TOOL_DOWN)
        if float(np.abs(error).max()) < 1e-13:
            break
        q = q + 0.5 * np.linalg.solve(kinematics.jacobian_full, error)
    return q


class Controller:
    """[Neri2023] (7), (9), (11) at one tick."""

    def __init__(self, task: Task, mode: int, loop: Loop) -> None:
        self._task, self._mode, self._config = task, mode, config_of(loop)
        self.ticks = self.cut = 0

    def velocity(self, time_s: float, q: Array) -> Array:
        """Return joint velocities, (6,) [rad/s], for joints seen at ``q``."""
        arm, task = robot(), self._task
        kinematics = arm.kinematics(q)
        pose = kinematics.transform_end_effector_to_base
        error = pose_error(pose[:3, 3], pose[:3, :3], task.position(time_s), TOOL_DOWN)
        pair, sphere = None, task.sphere(time_s)
        if sphere is not None:
            radius = influence_radius(math.hypot(*(sphere.velocity or ())), self._config)
            pair = most_critical(
                _segments(),
                arm.link_transforms(q),
                kinematics.spatial_jacobian,
                arm.free,
                np.array([sphere.position]),
                np.array([radius]),
            )
        velocity = clik_velocity(
            self._mode,  # type: ignore[arg-type]
            kinematics.jacobian_full,
            task.twist(time_s),
            error,
            None if pair is None else pair.critical,
            1.0 if pair is None else pair.radius,
            self._config,
        )
        self.ticks += 1
        self.cut += bool((np.abs(velocity) >= self._config.clik.joint_speed_max_rad_s).any())
        return velocity


class Arm:
    """The arm as it moves on: commands that come into force late, and a record every ``LOG_S``."""

    def __init__(self, start: Array, lag_s: float) -> None:
        self._plant = Plant(robot(), start, time_constant_s=lag_s)
        self._command, self._due = np.zeros(6), list[tuple[float, Array]]()
        self._now, self.log = 0.0, [(start.copy(), np.zeros(6))]

    def send(self, due_s: float, command: Array) -> None:
        """Let a command come into force at a time, not before those sent earlier."""
        self._due.append((due_s, command))

    def run_to(self, time_s: float) -> None:
        """Move on to a time [s]."""
        while self._now < time_s - 1e-12:
            while self._due and self._due[0][0] <= self._now + 1e-12:
                self._command = self._due.pop(0)[1]
            sample = len(self.log) * LOG_S
            until = min(time_s, sample, self._due[0][0] if self._due else math.inf)
            if until > self._now:
                self._plant.step(self._command, until - self._now)
            self._now = until
            if until > sample - 1e-12:  # the two are sums of other fractions
                velocity = self._plant.velocity
                self.log.append((self._plant.position.copy(), velocity.copy()))

    def seen(self, time_s: float) -> Array:
        """Return the newest recorded joint positions that are not newer than a time [s]."""
        index = math.floor(time_s / LOG_S + 1e-9)
        return self.log[max(index, 0)][0]


def run(piece: Piece) -> Track:
    """Run one case in one mode."""
    task, loop = Task(piece.case), loop_of(piece.loop)
    arm = Arm(start_joints(task.start), loop.lag_s)
    controller, tick = Controller(task, piece.mode, loop), 0
    while (now := tick / loop.rate_hz) < scenario().horizon_s - 1e-9:
        arm.run_to(now)
        command = controller.velocity(now, arm.seen(now - loop.read_s))
        arm.send(now + loop.send_s, command)
        tick += 1
    arm.run_to(scenario().horizon_s)
    return _track(task, arm, controller.cut / controller.ticks)


def _track(task: Task, arm: Arm, cut: float) -> Track:
    count, model = len(arm.log), _distance()
    time = np.arange(count) * LOG_S
    poses = np.empty((count, 4, 4))
    distance, centre = np.full(count, np.inf), np.full((count, 3), np.nan)
    for index, (q, _) in enumerate(arm.log):
        poses[index] = robot().kinematics(q).transform_end_effector_to_base
        sphere = task.sphere(float(time[index]))
        if sphere is not None:
            model.set_obstacles([sphere])
            nearest = model.nearest(q)
            distance[index] = -np.inf if nearest is None else nearest.distance
            centre[index] = sphere.position
    wanted = np.array([task.position(t) for t in time.tolist()])
    traces = np.einsum("mij,ij->m", poses[:, :3, :3], TOOL_DOWN)
    return Track(
        time=time,
        joints=np.array([q for q, _ in arm.log]),
        speeds=np.array([v for _, v in arm.log]),
        place=poses[:, :3, 3],
        off=np.linalg.norm(poses[:, :3, 3] - wanted, axis=1),
        turned=np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)),
        tilt=np.arctan2(np.hypot(poses[:, 0, 2], poses[:, 1, 2]), -poses[:, 2, 2]),
        distance=distance,
        centre=centre,
        cut=cut,
    )

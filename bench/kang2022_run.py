"""One run of ``bench.kang2022``: the ring's readings in, joint velocities out, everything recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from msgspec.structs import replace

from ssm_service.model import DistanceModel, Kinematics, Obstacle, Robot
from ssm_service.monitor import Inputs, JointSample, Monitor, Received, Target
from ssm_service.motion import (
    ObstaclePoint,
    conventional_field,
    field3d,
    field3d_as_printed,
    lspb_speed,
)
from ssm_service.simulation import Plant, RangeSensors

from .kang2022_scene import (
    FIELD,
    FREE,
    FULL,
    PLANTS,
    PRINTED,
    STEP_S,
    Array,
    Case,
    Scene,
    robot,
    scene,
    start,
)

RING_LINK = "forearm_link"
_APPROACH = 100.0  # 1/s: the field's own slowing down, so steep that the segment's rules


@dataclass(slots=True, kw_only=True)
class Record:
    """Samples of one run, one a tick, as arrays once it is over.

    Attributes:
        time: (t,) [s].
        joints: (t, k) free joints [rad].
        speeds: (t, k) their velocities [rad/s].
        place: (t, 3) end effector [m].
        sensed: (t,) the least reading in force [m], ``inf`` for silence.
        zone: (t,) 0 green, 1 yellow, 2 red, as the monitor's momentary zone.
        arm: (t,) exact distance of the whole arm [m].
        ringed: (t,) exact distance of the link that carries the ring [m].
    """

    time: Any = field(default_factory=list)
    joints: Any = field(default_factory=list)
    speeds: Any = field(default_factory=list)
    place: Any = field(default_factory=list)
    sensed: Any = field(default_factory=list)
    zone: Any = field(default_factory=list)
    arm: Any = field(default_factory=list)
    ringed: Any = field(default_factory=list)

    def close(self) -> None:
        """Turn the lists into arrays."""
        for name in self.__slots__:
            setattr(self, name, np.array(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run.

    Attributes:
        case: What was run.
        arrived_s: Time to the goal [s]; None where it was not reached.
        remaining_m: Distance from the goal at the end [m].
        contacts: Times that the arm came to touch the ball.
        record: All samples.
    """

    case: Case
    arrived_s: float | None
    remaining_m: float
    contacts: int
    record: Record


def wanted(case: Case, kinematics: Kinematics, ranges: Array, elapsed: float) -> Array:
    """Return the end effector's velocity, (3,) [m/s]: the field's direction at the segment's speed.

    Every method has the same gains, readings and speed. The segment (LSPB) is that of the line that remains.

    Args:
        case: Names the method.
        kinematics: The frames now.
        ranges: (m,) the newest readings [m], ``inf`` for no echo.
        elapsed: Time since the start [s].
    """
    told = scene()
    here, goal = kinematics.transform_end_effector_to_base[:3, 3], np.array(told.goal_m)
    remaining = math.dist(here.tolist(), told.goal_m)
    speed = lspb_speed(elapsed, remaining, speed=told.speed_m_s, acceleration=told.acceleration_m_s2)
    if speed == 0.0:
        return np.zeros(3)
    config = replace(robot(case.plant).config.file.motion, speed_m_s=speed, approach_gain=_APPROACH)
    sensors = kinematics.transform_sensors_to_base
    if case.method == FREE:
        return conventional_field(here, goal, None, config)
    if case.method == FIELD:
        return conventional_field(here, goal, _nearest(sensors, ranges), config)
    if case.method == PRINTED:
        return field3d_as_printed(here, goal, sensors, ranges, config)
    weight = 1.0 if case.method == FULL else told.step_of_sensor
    return field3d(here, goal, sensors, ranges, config, np.full(len(ranges), weight))


def _nearest(sensors: Array, ranges: Array) -> ObstaclePoint | None:
    """Return the one distance of the conventional field: the least reading, and that sensor's direction."""
    least = int(ranges.argmin())
    if math.isinf(ranges[least]):
        return None
    return ObstaclePoint(distance=float(ranges[least]), direction=-sensors[least, :3, 0])


@cache
def _monitor(plant: str, profile: str) -> Monitor:
    return Monitor(robot(plant), profile=profile, period_s=scene().tick_s)


def _monitor_of(case: Case, sim: _Sim) -> Monitor:
    """Return a monitor that has watched the arm stand at the start for longer than a zone lasts."""
    monitor = _monitor(case.plant, "kang2022" if case.limited else "unlimited")
    for _ in range(monitor.profile.config.recovery_ticks + 1):
        monitor.step(Inputs(joints=sim.joints, ranges=sim.ranges))
    return monitor


@cache
def _distance() -> DistanceModel:
    return DistanceModel(robot(PLANTS[0]))


class _Sim:
    """Plant, ring and link of one run, stepped by ``STEP_S``."""

    def __init__(self, case: Case) -> None:
        told, real = scene(), case.plant == PLANTS[1]
        self.arm: Robot = robot(case.plant)
        self.plant = Plant(
            self.arm, start(self.arm), time_constant_s=told.real.time_constant_s if real else 0.0
        )
        self.balls: tuple[Obstacle, ...] = () if case.method == FREE else (told.ball(case.ball_m),)
        self._sensors = RangeSensors(self.arm, seed=case.seed)
        self._link_steps = round((told.real.link_period_s if real else told.tick_s) / STEP_S)
        self.ranges: Received[Array] = Received()
        self.joints: Received[JointSample] = Received()
        self._came = [0.0, 0.0]
        self.decided = self._obeyed = np.zeros(len(self.arm.joint_names))
        self._step = 0

    @property
    def time_s(self) -> float:
        return self._step * STEP_S

    def sense(self) -> None:
        """Let the ring and the link deliver what is due now."""
        now = self.time_s
        ranges = self._sensors.step(now, lambda: self.plant.position, lambda: self.balls)
        if ranges is not None:
            self._came[0] = now
        if self._step % self._link_steps == 0:
            self._came[1] = now
            sample = JointSample(position=self.plant.position.copy(), velocity=self.plant.velocity.copy())
            self.joints = Received(value=sample, age_s=0.0)
        newest = self.ranges.value if ranges is None else ranges
        self.ranges = Received(value=newest, age_s=None if newest is None else now - self._came[0])
        self.joints = Received(value=self.joints.value, age_s=now - self._came[1])

    def move(self) -> None:
        """Obey, over one step, the command that the link handed over last."""
        if self._step % self._link_steps == 0:
            self._obeyed = self.decided
        self.plant.step(self._obeyed, STEP_S)
        self._step += 1


def run(case: Case) -> Run:
    """Run one case until the goal is reached, nothing moves on any more, or the time is over."""
    told, sim = scene(), _Sim(case)
    sim.sense()
    monitor = _monitor_of(case, sim)
    record, every = Record(), round(told.tick_s / STEP_S)
    arrived, contacts, touching = None, 0, False
    for step in range(round(told.horizon_s / STEP_S)):
        sim.sense()
        if step % every == 0:
            _decide(case, sim, monitor, record)
            touches = record.arm[-1] <= 0.0
            contacts, touching = contacts + (touches and not touching), touches
            if math.dist(record.place[-1], told.goal_m) <= told.arrival_m:
                arrived = sim.time_s
                break
            if _stuck(record, told):
                break
        sim.move()
    record.close()
    remaining = math.dist(record.place[-1], told.goal_m)
    return Run(case=case, arrived_s=arrived, remaining_m=remaining, contacts=contacts, record=record)


def _decide(case: Case, sim: _Sim, monitor: Monitor, record: Record) -> None:
    """Let the monitor take one tick, and record where everything truly is."""
    joints, ranges = sim.joints.value, sim.ranges.value
    if joints is None or ranges is None:
        raise RuntimeError("the first readings are due at once")
    told = scene()
    kinematics = sim.arm.kinematics(joints.position)
    linear = wanted(case, kinematics, ranges, sim.time_s + 0.5 * told.tick_s)
    target = Target(kind="twist", value=np.concatenate((linear, np.zeros(3))))
    decision = monitor.step(
        Inputs(joints=sim.joints, ranges=sim.ranges, target=Received(value=target, age_s=0.0))
    )
    sim.decided = decision.velocity
    _note(sim, record, ranges, int(decision.momentary_zone))


def _note(sim: _Sim, record: Record, ranges: Array, zone: int) -> None:
    position, free = sim.plant.position, sim.arm.free
    distance = _distance()
    distance.set_obstacles(sim.balls)
    pair = distance.nearest(position)
    ringed = distance.distance_from(RING_LINK)
    record.time.append(sim.time_s)
    record.joints.append(position[free])
    record.speeds.append(sim.plant.velocity[free])
    record.place.append(sim.arm.kinematics(position).transform_end_effector_to_base[:3, 3])
    record.sensed.append(float(ranges.min()))
    record.zone.append(zone)
    record.arm.append(math.inf if pair is None else pair.distance)
    record.ringed.append(math.inf if ringed is None else ringed)


def _stuck(record: Record, told: Scene) -> bool:
    """Tell whether the end effector has stayed within ``stuck_m`` for ``stuck_s``."""
    ticks = round(told.stuck_s / told.tick_s)
    if len(record.place) <= ticks or len(record.place) % 50:
        return False
    recent = np.array(record.place[-ticks:])
    return bool(np.linalg.norm(recent - recent[-1], axis=1).max() <= told.stuck_m)

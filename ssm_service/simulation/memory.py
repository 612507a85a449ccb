"""The in-memory twin: world and monitor tick by tick, without a clock or a network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..model import Obstacle, Robot
from ..monitor import Decision, Inputs, JointSample, Monitor, Received, Target
from .plant import DEFAULT_TIME_CONSTANT_S
from .scenario import Scenario
from .world import World

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryTick:
    """One tick.

    Attributes:
        time_s: Time of the world [s].
        inputs: What the monitor was given.
        decision: What it decided; the plant obeys it from here to the next tick.
    """

    time_s: float
    inputs: Inputs
    decision: Decision


class MemoryRun:
    """Simulation and monitor in one process: messages arrive at once, commands are obeyed at once.

    The same arguments give the same run, bit for bit.

    Args:
        robot: The robot.
        scenario: The scenario.
        seed: Seed of the sensors' errors.
        profile: Name of the zone profile; the robot's default where left out.
        period_s: Time from tick to tick [s].
        track_obstacles: Whether the monitor is sent the obstacles beside the readings.
        time_constant_s: The plant's lag [s].
    """

    def __init__(
        self,
        robot: Robot,
        scenario: Scenario,
        *,
        seed: int = 0,
        profile: str | None = None,
        period_s: float = 0.002,
        track_obstacles: bool = True,
        time_constant_s: float = DEFAULT_TIME_CONSTANT_S,
    ) -> None:
        self.world = World(
            robot, scenario, seed=seed, track_obstacles=track_obstacles, time_constant_s=time_constant_s
        )
        self.monitor = Monitor(robot, profile=profile, period_s=period_s)
        self._joints: _Held[JointSample] = _Held()
        self._ranges: _Held[NDArray[np.float64]] = _Held()
        self._obstacles: _Held[tuple[Obstacle, ...]] = _Held()
        self._target: _Held[Target] = _Held()

    def tick(self) -> MemoryTick:
        """Emit, decide, and let the plant obey until the next tick."""
        world = self.world
        now = world.time_s
        emitted = world.emit()
        inputs = Inputs(
            joints=self._joints.received(emitted.joints, now),
            ranges=self._ranges.received(emitted.ranges, now),
            obstacles=self._obstacles.received(emitted.obstacles, now),
            target=self._target.received(emitted.target, now),
        )
        decision = self.monitor.step(inputs)
        world.step(decision.velocity, self.monitor.period_s)
        return MemoryTick(time_s=now, inputs=inputs, decision=decision)


class _Held(Generic[T]):
    """The newest value of a source and when it came."""

    def __init__(self) -> None:
        self._value: T | None = None
        self._time_s = 0.0

    def received(self, value: T | None, now: float) -> Received[T]:
        """Take a new value, if there is one, and return what is known now [s]."""
        if value is not None:
            self._value, self._time_s = value, now
        return Received(value=self._value, age_s=None if self._value is None else now - self._time_s)

"""Everything outside the service: robot, sensors, obstacles and task, in their own time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import Obstacle, Robot
from ..monitor import JointSample, Target
from .plant import DEFAULT_TIME_CONSTANT_S, Plant
from .scenario import Scenario
from .schedule import Periodic
from .sensors import RangeSensors

JOINTS_PERIOD_S = 0.008
"""As a CB3 controller speaks: 125 Hz."""

OBSTACLES_PERIOD_S = 1.0 / 30.0
"""As a camera with a tracker speaks: 30 Hz."""

TARGET_PERIOD_S = 0.05
"""A task planner at 20 Hz."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Emitted:
    """What drivers send at one instant; ``None`` where nothing is due.

    Attributes:
        joints: Joint state.
        ranges: (m,) readings [m], ``inf`` for no echo.
        obstacles: Tracked obstacles.
        target: Wanted motion.
    """

    joints: JointSample | None = None
    ranges: NDArray[np.float64] | None = None
    obstacles: tuple[Obstacle, ...] | None = None
    target: Target | None = None


class World:
    """A scenario with its robot, stepped by whoever holds the clock. The same seed gives the same run.

    Args:
        robot: The robot.
        scenario: The scenario.
        seed: Seed of the sensors' errors.
        track_obstacles: Whether a tracker sends the obstacles; otherwise only the sensor rings see them.
        time_constant_s: The plant's lag [s].
    """

    def __init__(
        self,
        robot: Robot,
        scenario: Scenario,
        *,
        seed: int = 0,
        track_obstacles: bool = True,
        time_constant_s: float = DEFAULT_TIME_CONSTANT_S,
    ) -> None:
        self.robot = robot
        self.scenario = scenario
        self.plant = Plant(robot, scenario.start, time_constant_s=time_constant_s)
        self.time_s = 0.0
        self._sensors = RangeSensors(robot, seed=seed)
        self._track_obstacles = track_obstacles
        self._joints = Periodic(JOINTS_PERIOD_S)
        self._obstacles = Periodic(OBSTACLES_PERIOD_S)
        self._target = Periodic(TARGET_PERIOD_S)

    def step(self, command: NDArray[np.float64], dt: float) -> None:
        """Let the plant obey ``command`` (n,) [rad/s] for ``dt`` [s], while everything else moves on, too."""
        self.plant.step(command, dt)
        self.time_s += dt

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return all obstacles now."""
        return self.scenario.obstacles_at(self.time_s)

    def emit(self) -> Emitted:
        """Return what is due now; ask once a step."""
        now = self.time_s
        joints = None
        if self._joints.due(now):
            joints = JointSample(position=self.plant.position.copy(), velocity=self.plant.velocity.copy())
        tracked = self._obstacles.due(now) and self._track_obstacles
        return Emitted(
            joints=joints,
            ranges=self._sensors.step(now, self._position, self._seen),
            obstacles=self.obstacles() if tracked else None,
            target=self.scenario.target_at(now, self.plant.position) if self._target.due(now) else None,
        )

    def _position(self) -> NDArray[np.float64]:
        return self.plant.position

    def _seen(self) -> Sequence[Obstacle]:
        return self.obstacles()

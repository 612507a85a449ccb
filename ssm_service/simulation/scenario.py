"""Scenarios: what happens round the robot, and what the arm is told to do meanwhile."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import Obstacle
from ..monitor import Target
from .paths import Path3
from .schema import ShapeConfig
from .sway import Sway


@dataclass(frozen=True, slots=True, kw_only=True)
class Mover:
    """One shape on its path.

    Attributes:
        config: The shape.
        path: The path of its group.
    """

    config: ShapeConfig
    path: Path3

    def at(self, time_s: float) -> Obstacle:
        """Return the obstacle at a time [s], with the path's velocity."""
        (x, y, z), velocity = self.path.at(time_s)
        dx, dy, dz = self.config.offset_m
        return Obstacle(
            id=self.config.id,
            shape=self.config.shape,
            size=tuple(self.config.size_m),
            position=(x + dx, y + dy, z + dz),
            quaternion_xyzw=self.config.quaternion_xyzw,
            velocity=velocity,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenario:
    """A scenario for one robot.

    Attributes:
        name: The file's name without its ending.
        description: One sentence for people.
        duration_s: Length of the targets' cycle [s], and a good length for a run.
        start: (n,) joint position at the start [rad or m].
        movers: The shapes on their paths.
        target_times: (k,) when each target begins within the cycle [s].
        targets: (k,) the targets.
        sway: What the arm does in place of targets that were written for another arm.
        remark: One line for people where the scenario was fitted to this robot; empty otherwise.
    """

    name: str
    description: str
    duration_s: float
    start: NDArray[np.float64]
    movers: tuple[Mover, ...]
    target_times: tuple[float, ...]
    targets: tuple[Target, ...]
    sway: Sway | None = None
    remark: str = ""

    def obstacles_at(self, time_s: float) -> tuple[Obstacle, ...]:
        """Return all obstacles at a time [s]."""
        return tuple([mover.at(time_s) for mover in self.movers])

    def target_at(self, time_s: float, position: NDArray[np.float64] | None = None) -> Target | None:
        """Return the target in force at a time [s]; ``None`` where the scenario has none.

        Args:
            time_s: Time since the start [s].
            position: (n,) where the arm is then [rad or m], which a sway goes by; the start where left out.
        """
        if self.sway is not None:
            return self.sway.target_at(time_s, self.start if position is None else position)
        if not self.targets:
            return None
        phase = math.fmod(max(time_s, 0.0), self.duration_s)
        return self.targets[bisect.bisect_right(self.target_times, phase) - 1]

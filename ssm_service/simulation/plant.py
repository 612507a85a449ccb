"""A kinematic robot: joints that follow a commanded velocity with a lag."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model import Robot

DEFAULT_TIME_CONSTANT_S = 0.02
"""Time constant of the velocity loop [s]: the joints reach 95 % of a commanded speed in 60 ms."""


class Plant:
    """Joints with a first-order lag from commanded to actual velocity.

    With command u held over a step, velocity v and time constant τ, ``v' = (u − v)/τ`` has the solution

        v(t) = u + (v₀ − u)·e^(−t/τ)
        x(t) = x₀ + u·t + (v₀ − u)·τ·(1 − e^(−t/τ))

    which each step takes exactly, so that step lengths make no difference. A commanded speed above the
    joint's own limit is cut to it. A joint that would pass a position limit stands there with velocity 0.

    Args:
        robot: The robot.
        position: (n,) at the start [rad or m]; the robot's rest position where left out.
        time_constant_s: τ [s]; 0 follows at once.

    Raises:
        InputError: ``out_of_range`` or ``wrong_length``.
    """

    def __init__(
        self,
        robot: Robot,
        position: NDArray[np.float64] | None = None,
        *,
        time_constant_s: float = DEFAULT_TIME_CONSTANT_S,
    ) -> None:
        if not 0.0 <= time_constant_s < math.inf:
            raise InputError("out_of_range", "time_constant_s", time_constant_s, "0 or more, finite")
        self._robot = robot
        self._time_constant = time_constant_s
        start = robot.rest_position if position is None else position
        self.position = _checked("position", start, len(robot.joint_names)).copy()
        if not bool(np.all((robot.position_lower <= start) & (start <= robot.position_upper))):
            raise InputError("out_of_range", "position", start.tolist(), "within the joints' limits")
        self.velocity = np.zeros(len(robot.joint_names))
        self.limit_hits = 0

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Joints that stand at a position limit."""
        robot = self._robot
        there = (self.position <= robot.position_lower) | (self.position >= robot.position_upper)
        return tuple(name for name, hit in zip(robot.joint_names, there, strict=True) if hit)

    def step(self, command: NDArray[np.float64], dt: float) -> None:
        """Move on by ``dt`` [s] under a command (n,) [rad/s or m/s] that is held meanwhile.

        Raises:
            InputError: ``wrong_length``, ``not_finite``; ``out_of_range`` where ``dt`` is not above 0.
        """
        if not 0.0 < dt < math.inf:
            raise InputError("out_of_range", "dt", dt, "above 0, finite")
        robot, tau = self._robot, self._time_constant
        wanted = _checked("command", command, len(robot.joint_names))
        wanted = np.clip(wanted, -robot.velocity_limit, robot.velocity_limit)
        excess = self.velocity - wanted
        decay = math.exp(-dt / tau) if tau > 0.0 else 0.0
        moved = self.position + wanted * dt + excess * (tau * (1.0 - decay))
        velocity = wanted + excess * decay
        # A joint that stands at its limit already is not hit anew.
        beyond = (moved < robot.position_lower) | (moved > robot.position_upper)
        inside = (self.position > robot.position_lower) & (self.position < robot.position_upper)
        self.limit_hits += int(np.count_nonzero(beyond & inside))
        velocity[beyond] = 0.0
        self.position = np.clip(moved, robot.position_lower, robot.position_upper)
        self.velocity = velocity


def _checked(where: str, values: NDArray[np.float64], length: int) -> NDArray[np.float64]:
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape != (length,):
        raise InputError("wrong_length", where, vector.shape, f"{length} numbers")
    if not np.isfinite(vector).all():
        raise InputError("not_finite", where, vector.tolist(), "finite numbers")
    return vector

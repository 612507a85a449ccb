"""How long the robot takes to stop, and how far it gets meanwhile, by the makers' data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import StoppingConfig, StoppingPoint


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoppingLevels:
    """Stopping time and distance of the worst joint, in steps of the robot's speed.

    While no joint is faster than ``shares[l]`` of its own limit, the robot stops within ``times[l]``, and its
    nearest point moves on by at most ``gains[l]`` for each unit of its speed: ``S_s = v · gains[l]``. Both
    are the greatest over the free joints, each taken from the next listed speed that is not below its own,
    so nothing is interpolated. (One gain for all is true of a stop that keeps to the path. Where the joints
    stop each in its own time, the worst joint's covers what they add up to, not what they take off one
    another.)

    Attributes:
        shares: (L,) rising; the last is 1.
        times: (L,) T_s [s], never falling.
        gains: (L,) stopping distance for each unit of speed [s], never falling.
    """

    shares: NDArray[np.float64]
    times: NDArray[np.float64]
    gains: NDArray[np.float64]

    @classmethod
    def of(
        cls, stopping: Mapping[str, StoppingConfig], joints: Sequence[str], limits: Sequence[float]
    ) -> StoppingLevels:
        """Return the levels of a robot file's stopping data.

        Args:
            stopping: By joint; each of ``joints`` is among them, with data up to its limit at least.
            joints: The free joints.
            limits: Their greatest speeds [rad/s or m/s].
        """
        tables = [_steps(stopping[joint], limit) for joint, limit in zip(joints, limits, strict=True)]
        shares = sorted({share for table in tables for share, _, _ in table})
        rows: list[tuple[float, float, float]] = []
        for share in shares:
            steps = [next(step for step in table if step[0] >= share) for table in tables]
            row = (share, max(step[1] for step in steps), max(step[2] for step in steps))
            if rows and rows[-1][1:] == row[1:]:
                rows.pop()  # the same at a higher speed
            rows.append(row)
        table = np.array(rows)
        columns = table[:, 0], np.maximum.accumulate(table[:, 1]), np.maximum.accumulate(table[:, 2])
        for column in columns:
            column.flags.writeable = False
        return cls(shares=columns[0], times=columns[1], gains=columns[2])

    def level_at(self, share: float) -> int:
        """Return the level of a speed share; the last one beyond 1, and for what is not a number."""
        fitting = (self.shares >= share).nonzero()[0]
        return int(fitting[0]) if len(fitting) else len(self.shares) - 1


def _steps(data: StoppingConfig, limit: float) -> list[tuple[float, float, float]]:
    """Return share of the limit, stopping time [s] and gain [s] of each listed speed, in rising order."""
    points: list[StoppingPoint | StoppingConfig] = [*data.slower, data]
    return [
        (min(point.speed_rad_s / limit, 1.0), point.time_s, point.distance_rad / point.speed_rad_s)
        for point in points
    ]

"""Where something is at a time: straight lines between waypoints."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Path3:
    """A path through waypoints, each leg a straight line at constant speed.

    Attributes:
        times: (k,), [s], rising from 0.
        positions: (k, 3), [m].
        loop: Begin again after the last waypoint; otherwise stay there.
    """

    times: tuple[float, ...]
    positions: tuple[Vector3, ...]
    loop: bool

    @classmethod
    def of(cls, times: Sequence[float], positions: Sequence[Vector3], *, loop: bool) -> Path3:
        """Return the path through ``positions`` at ``times`` (checked where the file is read)."""
        return cls(times=tuple(times), positions=tuple(positions), loop=loop)

    def at(self, time_s: float) -> tuple[Vector3, Vector3]:
        """Return position [m] and velocity [m/s]; at a waypoint, the velocity of the leg that begins there.

        Args:
            time_s: Time since the start [s]; before it, the path stands at its first waypoint.
        """
        length = self.times[-1]
        if time_s < 0.0 or length == 0.0:
            return self.positions[0], (0.0, 0.0, 0.0)
        if self.loop:
            time_s = math.fmod(time_s, length)
        elif time_s >= length:
            return self.positions[-1], (0.0, 0.0, 0.0)
        leg = bisect.bisect_right(self.times, time_s) - 1
        begin, end = self.times[leg], self.times[leg + 1]
        (ax, ay, az), (bx, by, bz) = self.positions[leg], self.positions[leg + 1]
        part, rate = (time_s - begin) / (end - begin), 1.0 / (end - begin)
        position = (ax + part * (bx - ax), ay + part * (by - ay), az + part * (bz - az))
        return position, ((bx - ax) * rate, (by - ay) * rate, (bz - az) * rate)

"""The simulated sensor rings: ideal readings, each ring at its own period, with errors and latency."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..model import Obstacle, Robot
from ..perception import SimulatedSensorModel, scan
from ..perception.own_links import OwnLinks
from .schedule import Periodic


class RangeSensors:
    """All sensor rings of a robot.

    Each ring measures all its sensors at one instant, once every period of its own; ring ``i`` of ``r``
    begins ``i/r`` of its period late, so that rings with equal periods take turns. Errors come from the
    robot file (``rings[].simulated``); a scan is handed over ``latency_s`` after it was measured, in the
    state of the world in which it was measured.

    A range sensor cannot tell the arm from anything else: each reads the nearer of the obstacles and the
    arm's own links (``perception.OwnLinks``).

    One message holds all rings, so whenever a scan of any ring is handed over there is a message, with the
    newest scan of each. A reading of another ring in it is up to that ring's period older. The
    first message comes when every ring has given its first scan: nothing measured is not 'no echo'.

    Args:
        robot: The robot.
        seed: Seed of the errors; each ring has a generator of its own.
    """

    def __init__(self, robot: Robot, *, seed: int = 0) -> None:
        self._robot = robot
        self._own_links = OwnLinks(robot) if robot.sensor_count else None
        self._rings = [
            _RingClock(robot, index, np.random.default_rng([seed, index]))
            for index in range(len(robot.rings))
        ]
        self._latest = np.full(robot.sensor_count, math.inf)
        self._missing = set(range(len(robot.rings)))

    def step(
        self,
        time_s: float,
        position: Callable[[], NDArray[np.float64]],
        obstacles: Callable[[], Sequence[Obstacle]],
    ) -> NDArray[np.float64] | None:
        """Measure what is due and return the message that is due.

        Args:
            time_s: Time since the start [s], rising from call to call.
            position: Gives the joint positions now, (n,) [rad or m]; called only when a ring measures.
            obstacles: Gives the obstacles now; likewise.

        Returns:
            (m,), [m], ``inf`` for no echo; ``None`` when no scan was handed over.
        """
        fresh = False
        for index, ring in enumerate(self._rings):
            if ring.clock.due(time_s) and self._own_links is not None:
                joints = position()
                transforms = self._robot.kinematics(joints).transform_sensors_to_base
                ring.measure(time_s, transforms, obstacles(), self._own_links.readings(joints))
            ranges = ring.take(time_s)
            if ranges is not None:
                self._latest[self._robot.ring_slices[index]] = ranges
                self._missing.discard(index)
                fresh = True
        return self._latest.copy() if fresh and not self._missing else None


class _RingClock:
    """One ring: when it measures, and the scans that are still under way."""

    def __init__(self, robot: Robot, index: int, generator: np.random.Generator) -> None:
        self._ring = robot.rings[index]
        self._slice = robot.ring_slices[index]
        self._errors = SimulatedSensorModel.of_ring(self._ring)
        self._generator = generator
        self._under_way: deque[tuple[float, NDArray[np.float64]]] = deque()
        self.clock = Periodic(self._ring.period, phase_s=self._ring.period * index / len(robot.rings))

    def measure(
        self,
        time_s: float,
        transform_sensors_to_base: NDArray[np.float64],
        obstacles: Sequence[Obstacle],
        own: NDArray[np.float64],
    ) -> None:
        """Take one scan, given all sensors' poses (m, 4, 4) and what they read of the arm, (m,)."""
        ring = self._ring
        ideal = scan(
            obstacles,
            transform_sensors_to_base[self._slice],
            ring.half_angle,
            ring.range_max,
            ring.range_min,
        )
        ranges = self._errors.apply(np.minimum(ideal, own[self._slice]), self._generator)
        self._under_way.append((time_s + ring.simulated.latency_s, ranges))

    def take(self, time_s: float) -> NDArray[np.float64] | None:
        """Return the newest scan whose latency has passed since the last call, if there is one."""
        newest = None
        while self._under_way and self._under_way[0][0] <= time_s + 1e-9:
            newest = self._under_way.popleft()[1]
        return newest

"""Inputs that are in due form and cannot be true: what a joint cannot do, and what a sensor cannot say.

Every check is configured in the robot file's ``plausibility`` and off where it is not. None can make a zone
milder: each adds a reason word, which is a stop. What one sensor says of itself alone and consistently is
believed: a single range sensor that reads too far, or a joint encoder that was wrong from the start, is not
found here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..config import PlausibilityConfig
from ..model import Kinematics, Obstacle, Robot
from ..perception.reading import sphere_readings
from .inputs import Inputs, JointSample

JOINTS = "implausible:joints"
FROZEN = "frozen:ranges"
MISSING = "missing:ranges"

INNER = 0.5
"""Share of a sensor's half angle within which it is sure to see a thing that stands there."""


class Plausibility:
    """Compares the newest inputs with those before them, with the commands, and with each other.

    A pure function of the inputs over the ticks. A finding holds for ``hold_s`` after the last tick that had
    it.

    Args:
        robot: The robot.
        period_s: Time from tick to tick [s].
        valid_for_s: For how long a command may be acted on [s].
    """

    def __init__(self, robot: Robot, period_s: float, valid_for_s: float) -> None:
        self._config = robot.config.file.plausibility
        self._period_s = period_s
        self._joints = JointCheck(robot, self._config, period_s, valid_for_s)
        self._ranges = RangeCheck(robot, self._config)
        self._left_s: dict[str, float] = {}

    @classmethod
    def of(cls, robot: Robot, period_s: float, valid_for_s: float) -> Plausibility | None:
        """Return the checks of a robot file; ``None`` where it has none."""
        config = robot.config.file.plausibility
        keys = (config.joint_speed_factor, config.follow_window_s, config.frozen_scans, config.echo_margin_m)
        return None if keys == (None,) * 4 else cls(robot, period_s, valid_for_s)

    def step(
        self,
        inputs: Inputs,
        fresh: set[str],
        velocity: NDArray[np.float64],
        kinematics: Kinematics | None,
    ) -> tuple[str, ...]:
        """Return the reason words of this tick; each is worth a stop.

        Args:
            inputs: What is known now.
            fresh: The sources that are fresh.
            velocity: (n,), [rad/s], the command of the tick before.
            kinematics: The frames now; ``None`` without fresh joints.
        """
        elapsed_s = self._period_s + (inputs.overrun_s + self._period_s if inputs.overrun_s > 0.0 else 0.0)
        self._left_s = {word: left - elapsed_s for word, left in self._left_s.items() if left > elapsed_s}
        sample = inputs.joints.value if "joints" in fresh else None
        if not self._joints.plausible(sample, inputs.joints.age_s or 0.0, velocity, elapsed_s):
            self._left_s[JOINTS] = self._config.hold_s
        ranges = inputs.ranges.value if "ranges" in fresh else None
        obstacles = inputs.obstacles.value if "obstacles" in fresh else None
        for word in self._ranges.findings(ranges, obstacles, kinematics):
            self._left_s[word] = self._config.hold_s
        return tuple(self._left_s)


class JointCheck:
    """Joints that move faster than they can, or not as they are commanded.

    Two measurements are at most as far apart in time as the ticks between their arrivals and the age of the
    first together. A robot that follows the commands by a delay and a lag of whatever kind moves, within any
    window, by a mean of what was commanded within the same window some time before: never by less than the
    least, never by more than the greatest of them.

    Args:
        robot: The robot.
        config: The bounds.
        period_s: Time from tick to tick [s].
        valid_for_s: For how long a command may be acted on [s].
    """

    def __init__(self, robot: Robot, config: PlausibilityConfig, period_s: float, valid_for_s: float) -> None:
        self._config = config
        self._period_s = period_s
        self._valid_for_s = valid_for_s
        self._limit = robot.velocity_limit
        self._free = robot.free
        window_s = config.follow_window_s or 0.0
        self._window = max(round(window_s / period_s), 1)
        self._delay = max(round(config.follow_delay_s / period_s), 1)
        self._last: JointSample | None = None
        self._since_s = 0.0
        self._past: deque[tuple[NDArray[np.float64], NDArray[np.float64], float]] = deque(
            maxlen=self._window + self._delay + 1
        )
        self._commanded = np.zeros(len(robot.joint_names))

    def plausible(
        self, sample: JointSample | None, age_s: float, velocity: NDArray[np.float64], elapsed_s: float
    ) -> bool:
        """Tell whether a sample can be true after those before it.

        Args:
            sample: The newest; ``None`` where it is not fresh.
            age_s: Upper bound of its age [s].
            velocity: (n,), [rad/s], the command of the tick before.
            elapsed_s: Since that tick, at most [s].
        """
        self._since_s += elapsed_s
        # Nobody acts on a command for longer than it is valid.
        self._commanded = self._commanded + velocity * min(elapsed_s, self._valid_for_s)
        if sample is None:
            self._past.clear()
            return True
        possible = self._possible(sample)
        if sample is not self._last:
            self._last, self._since_s = sample, age_s
        self._past.append((self._commanded, sample.position, age_s))
        if possible and self._follows():
            return True
        self._past.clear()
        return False

    def _possible(self, sample: JointSample) -> bool:
        factor = self._config.joint_speed_factor
        if factor is None or self._last is None or sample is self._last:
            return True
        farthest = factor * self._limit * self._since_s + self._config.joint_tolerance_rad
        return bool(np.all(np.abs(sample.position - self._last.position) <= farthest))

    def _follows(self) -> bool:
        if self._config.follow_window_s is None or len(self._past) < (self._past.maxlen or 0):
            return True
        commanded = np.array([entry[0] for entry in self._past])[:, self._free]
        moves = commanded[self._window :] - commanded[: -self._window]
        newest, before = self._past[-1], self._past[-1 - self._window]
        moved = (newest[1] - before[1])[self._free]
        fastest = np.abs(np.diff(commanded, axis=0)).max(axis=0) / self._period_s
        slack = self._config.joint_tolerance_rad + fastest * max(newest[2], before[2])
        return bool(np.all((moves.min(axis=0) - slack <= moved) & (moved <= moves.max(axis=0) + slack)))


class RangeCheck:
    """Readings that stay the same to the last digit, and echoes that must be there and are not.

    Args:
        robot: The robot.
        config: The bounds.
    """

    def __init__(self, robot: Robot, config: PlausibilityConfig) -> None:
        self._robot = robot
        self._config = config
        self._last: NDArray[np.float64] | None = None
        self._same = np.zeros(robot.sensor_count, dtype=np.int64)
        self._looked: tuple[object, object] = (None, None)
        self._misses = False

    def findings(
        self,
        ranges: NDArray[np.float64] | None,
        obstacles: tuple[Obstacle, ...] | None,
        kinematics: Kinematics | None,
    ) -> Sequence[str]:
        """Return ``frozen:ranges`` or ``missing:ranges``, or both.

        Args:
            ranges: (m,), [m], the newest scan, the same object while there is no newer one; ``None`` where
                it is not fresh.
            obstacles: What is tracked, the same object likewise; ``None`` where nobody looks.
            kinematics: The frames now; ``None`` without fresh joints.
        """
        if ranges is None:
            return ()
        checks = ((FROZEN, self._frozen(ranges)), (MISSING, self._missing(ranges, obstacles, kinematics)))
        return [word for word, found in checks if found]

    def _frozen(self, ranges: NDArray[np.float64]) -> bool:
        most = self._config.frozen_scans
        if most is None:
            return False
        if ranges is not self._last:
            same = np.isfinite(ranges) if self._last is None else (ranges == self._last) & np.isfinite(ranges)
            self._same = np.where(same, self._same + 1, 0)
            self._last = ranges
        # A message holds the newest scan of every ring, so one of several repeats what was said before.
        return bool((self._same >= most * max(len(self._robot.rings), 1)).any())

    def _missing(
        self,
        ranges: NDArray[np.float64],
        obstacles: tuple[Obstacle, ...] | None,
        kinematics: Kinematics | None,
    ) -> bool:
        margin = self._config.echo_margin_m
        if margin is None or kinematics is None or not obstacles:
            return False
        if ranges is not self._looked[0] or obstacles is not self._looked[1]:
            self._looked = (ranges, obstacles)
            expected = self._expected(kinematics.transform_sensors_to_base, obstacles, margin)
            self._misses = bool((expected + margin < ranges).any())  # no echo is infinitely far
        return self._misses

    def _expected(
        self, transforms: NDArray[np.float64], obstacles: tuple[Obstacle, ...], margin: float
    ) -> NDArray[np.float64]:
        """Return what each sensor must read at most, (m,) [m]: the balls inside what is tracked."""
        centres = np.array([obstacle.position for obstacle in obstacles])
        radii = np.array([_inner_radius(obstacle) for obstacle in obstacles])
        expected = np.full(len(transforms), np.inf)
        for ring, part in zip(self._robot.rings, self._robot.ring_slices, strict=True):
            T = transforms[part]
            from_sensors = (centres[np.newaxis] - T[:, np.newaxis, :3, 3]) @ T[:, :3, :3]
            readings = sphere_readings(from_sensors, radii, INNER * ring.half_angle).min(axis=1)
            expected[part] = np.where(readings <= ring.range_max - margin, readings, np.inf)
        return expected


def _inner_radius(obstacle: Obstacle) -> float:
    """Return the radius [m] of a ball about its centre that lies inside an obstacle."""
    if obstacle.shape in ("sphere", "capsule"):
        return obstacle.size[0]
    if obstacle.shape == "cylinder":
        return min(obstacle.size[0], 0.5 * obstacle.size[1])
    return 0.5 * min(obstacle.size)

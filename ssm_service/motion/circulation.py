"""Going round what blocks the way: a tangential velocity, one sense at a time, for a bounded time.

The filter stops the end effector where everything that leads to the goal closes in on something: a local
minimum. As a part of the task, never of the constraints, a velocity along the obstacle leads out of it, much
as the 'bug' algorithms of mobile robots follow a wall. With n the unit normal of the blocking pair and a an
axis chosen once for each sense,

    t = (a × n)/|a × n|,        v = speed · t, and what the wanted velocity has against t taken out

so the motion stays in one plane across the obstacle, and its sense stays too, while n turns with the surface.
Four senses are tried: two in the plane that is nearest to horizontal and two across; first the one towards
which the wanted velocity leans, and of equal ones upwards, where an arm on a table has the most room.

A sense ends well when the surface no longer opposes the wanted velocity, or nothing blocks just before the
goal, and badly when the arm stays blocked in spite of it or its time is over. The next block before the goal
has come nearer than ever tries the next sense; after the last one it gives up (``exhausted``), and a planner
is asked. It is a heuristic: the blocking link need not be the end effector, and a way out of a maze is not
among the things that it finds.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..config import FilterConfig
from ..errors import InputError

Array = NDArray[np.float64]

WAIT_S: Final = 0.25
"""So long the way must be blocked before it goes round: an arm that speeds up is slow as well."""

STUCK_S: Final = 0.75
"""A sense in which the arm is blocked for so long is wrong."""

SENSE_S: Final = 6.0
"""A sense that has not brought the goal nearer for so long is wrong."""

LEAVE_S: Final = 0.2
"""So long the way must be free before it is taken again."""

PROGRESS_M: Final = 0.02
"""By so much the goal must come nearer than ever before to count as progress."""

_FACING: Final = 0.2  # a normal within asin(0.2) = 11.5° of the tangent plane of the way no longer opposes it
_UPWARDS: Final = (
    0.03,
    0.02,
    0.01,
    0.0,
)  # breaks the tie of up, left, right, down where the way leans nowhere


class Circulation:
    """Finds a way round; remembers what it tried. The same inputs give the same velocities.

    Attributes:
        exhausted: Whether every sense was tried since the goal last came nearer; there is no more to expect.

    Args:
        config: The speed of going round; 0 never does.
    """

    def __init__(self, config: FilterConfig) -> None:
        self._speed = config.circulation_m_s
        self.reset()

    def reset(self) -> None:
        """Forget everything: there is a new goal."""
        self.exhausted = False
        self._best = math.inf
        self._axes: list[Array] = []
        self._axis: Array | None = None
        self._tangent = np.zeros(3)
        self._blocked_s = self._free_s = self._sense_s = 0.0

    @property
    def circulating(self) -> bool:
        """Whether it is on its way round."""
        return self._axis is not None

    def step(
        self, wanted_linear: Array, normal: Array, blocked: bool, distance_to_goal: float, dt: float
    ) -> Array:
        """Return what to add to the wanted velocity of the end effector, (3,) [m/s].

        Args:
            wanted_linear: (3,) towards the goal [m/s], base frame; 0 on arrival, which resets everything.
            normal: (3,) unit, from the blocking obstacle to the link, base frame; zeros where nothing blocks.
            blocked: Whether the velocity of late, this one's part included, fell far short of what was wanted
                and the joints would have done, and pairs were the reason.
            distance_to_goal: Of the end effector [m].
            dt: Time since the last step [s].

        Raises:
            InputError: ``not_finite``, ``out_of_range``.
        """
        _check(wanted_linear, normal, distance_to_goal, dt)
        size = math.hypot(*wanted_linear.tolist())
        if self._speed == 0.0 or size == 0.0:
            self.reset()
            return np.zeros(3)
        way = wanted_linear / size
        self._count(blocked, distance_to_goal, dt)
        if self._axis is None:
            if not blocked or self._blocked_s < WAIT_S or not self._begin(way, normal):
                return np.zeros(3)
        elif self._left(way, normal, blocked, distance_to_goal, dt):
            self._axis = None
            return np.zeros(3)
        elif (self._blocked_s >= STUCK_S or self._sense_s >= SENSE_S) and not self._next():
            return np.zeros(3)
        return self._velocity(wanted_linear, normal)

    def _count(self, blocked: bool, distance: float, dt: float) -> None:
        self._blocked_s = self._blocked_s + dt if blocked else 0.0
        self._sense_s += dt
        if distance < self._best - PROGRESS_M:
            self._best, self._sense_s, self.exhausted = distance, 0.0, False
            if self._axis is None:
                self._axes = []

    def _begin(self, way: Array, normal: Array) -> bool:
        """Take the first sense, or the next one where there was no progress since the last."""
        if self.exhausted or not normal.any():
            return False
        if not self._axes:
            self._axes = _senses(way, normal)
            self._axis, self._sense_s, self._blocked_s, self._free_s = self._axes[0], 0.0, 0.0, 0.0
            self._tangent = np.zeros(3)
            return True
        return self._next()

    def _next(self) -> bool:
        """Give up the present sense, or the last one, for the next; tell whether there is one."""
        self._axes = self._axes[1:]
        self._sense_s = self._blocked_s = self._free_s = 0.0
        self._tangent = np.zeros(3)
        self.exhausted = not self._axes
        self._axis = self._axes[0] if self._axes else None
        return not self.exhausted

    def _left(self, way: Array, normal: Array, blocked: bool, distance: float, dt: float) -> bool:
        """Tell whether the surface has not opposed the way for long enough, or the goal is at hand."""
        free = not blocked and (distance < PROGRESS_M or float(way @ normal) >= -_FACING)
        self._free_s = self._free_s + dt if free else 0.0
        return self._free_s >= LEAVE_S

    def _velocity(self, wanted: Array, normal: Array) -> Array:
        if self._axis is None:
            return np.zeros(3)
        tangent = _cross(self._axis, normal)
        size = math.hypot(*tangent.tolist())
        # Where the normal is the axis, or nothing touches, go on as before.
        if size > 0.1:
            self._tangent = tangent / size
        against = min(0.0, float(wanted @ self._tangent))
        return (self._speed - against) * self._tangent


def _senses(way: Array, normal: Array) -> list[Array]:
    """Return the axes of the four senses, the likeliest first.

    ``a = n × e`` turns so that ``a × n = e``, with e up, left, right and down along the surface.
    """
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    across = up - float(up @ normal) * normal
    across /= math.hypot(*across.tolist())
    left = _cross(normal, across)
    directions = [across, left, -left, -across]
    leaning = [float(way @ e) + more for e, more in zip(directions, _UPWARDS, strict=True)]
    order = sorted(range(4), key=lambda i: -leaning[i])
    return [_cross(normal, directions[i]) for i in order]


def _cross(a: Array, b: Array) -> Array:
    x, y, z = a.tolist()
    u, v, w = b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def _check(wanted: Array, normal: Array, distance: float, dt: float) -> None:
    if wanted.shape != (3,) or normal.shape != (3,):
        raise InputError("wrong_length", "circulation", [wanted.shape, normal.shape], "3 numbers each")
    if not math.isfinite(float(wanted.sum()) + float(normal.sum()) + distance):
        found = {"wanted": wanted.tolist(), "normal": normal.tolist(), "distance": distance}
        raise InputError("not_finite", "circulation", found, "finite numbers")
    if not (distance >= 0.0 and 0.0 < dt < math.inf):
        raise InputError("out_of_range", "circulation", [distance, dt], "distance ≥ 0, dt > 0")

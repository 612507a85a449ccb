"""Timing along a straight line: a linear segment with parabolic blends (LSPB).

The path of [Kang2022] III-C is sampled from such a segment every 0.01 s. With length ``L``, cruising speed
``v`` and acceleration ``a``, the travelled way is ``½ a t²`` in the first blend, grows at ``v`` in the linear
segment, and is ``L − ½ a (T − t)²`` in the last blend:

    v_peak = min(v, √(a L))      t_b = v_peak / a      T = L/v_peak + t_b

A line that is too short to reach ``v`` has no linear segment: ``v_peak = √(a L)``, ``T = 2 √(L/a)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError


def lspb_speed(elapsed: float, remaining: float, *, speed: float, acceleration: float) -> float:
    """Return the speed of the segment by its clock and its way: ``min(v, a·t, √(2 a e))``.

    Along an undisturbed segment this is the segment's own speed. What was held up or led astray on the
    way goes by what remains instead of by the clock: it need not catch up, and still comes to rest.

    Args:
        elapsed: t, time since the start [s]; not above 0 gives 0.
        remaining: e, way that is left [m]; not above 0 gives 0.
        speed: v, cruising speed [m/s].
        acceleration: a, of the blends [m/s²].

    Returns:
        [m/s], from 0 to ``speed``.

    Raises:
        InputError: ``not_finite``; ``out_of_range`` where speed or acceleration is not above 0.
    """
    _check_positive(speed=speed, acceleration=acceleration)
    for where, value in (("elapsed", elapsed), ("remaining", remaining)):
        if not math.isfinite(value):
            raise InputError("not_finite", where, value, "a finite number")
    if elapsed <= 0.0 or remaining <= 0.0:
        return 0.0
    return min(speed, acceleration * elapsed, math.sqrt(2.0 * acceleration * remaining))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LineSegmentParabolicBlend:
    """A straight line from a start to a goal, at rest at both ends (see the module).

    Start and goal may be plain numbers or points of any dimension; all results have their shape.

    Attributes:
        start: (d,) or () [m, or rad], read-only.
        goal: Of the same shape, read-only.
        speed: v, cruising speed along the line [m/s], above 0.
        acceleration: a, of both blends [m/s²], above 0.
        length: L [m].
        peak_speed: Greatest speed [m/s]; below ``speed`` where the line is too short.
        blend_s: Time of each blend [s].
        duration: Time of the whole line [s]; 0 where the start is the goal.

    Raises:
        InputError: ``not_finite``, ``wrong_length``, ``out_of_range``.
    """

    start: NDArray[np.float64]
    goal: NDArray[np.float64]
    speed: float
    acceleration: float
    length: float = field(init=False)
    peak_speed: float = field(init=False)
    blend_s: float = field(init=False)
    duration: float = field(init=False)

    def __post_init__(self) -> None:
        start, goal = _end("start", self.start), _end("goal", self.goal)
        if start.shape != goal.shape:
            raise InputError("wrong_length", "goal", goal.shape, f"the start's shape, {start.shape}")
        _check_positive(speed=self.speed, acceleration=self.acceleration)
        length = float(np.linalg.norm(np.atleast_1d(goal - start)))
        peak = min(self.speed, math.sqrt(self.acceleration * length))
        blend = peak / self.acceleration
        found = {
            "start": start,
            "goal": goal,
            "length": length,
            "peak_speed": peak,
            "blend_s": blend,
            "duration": length / peak + blend if peak > 0.0 else 0.0,
        }
        for name, value in found.items():
            object.__setattr__(self, name, value)

    def travelled(self, time_s: float) -> float:
        """Return the way from the start [m] at a time [s]: 0 before the start, ``length`` after the end.

        Raises:
            InputError: ``not_finite`` if the time is NaN.
        """
        now = self._within(time_s)
        if now < self.blend_s:
            return 0.5 * self.acceleration * now * now
        left = self.duration - now
        if left < self.blend_s:
            return self.length - 0.5 * self.acceleration * left * left
        return self.peak_speed * (now - 0.5 * self.blend_s)

    def rate(self, time_s: float) -> float:
        """Return the speed along the line [m/s] at a time [s]: 0 before the start and after the end.

        Raises:
            InputError: ``not_finite`` if the time is NaN.
        """
        now = self._within(time_s)
        return min(self.peak_speed, self.acceleration * min(now, self.duration - now))

    def position(self, time_s: float) -> NDArray[np.float64]:
        """Return the place [m] at a time [s].

        Raises:
            InputError: ``not_finite`` if the time is NaN.
        """
        way = self.travelled(time_s)
        return self.start + (way / self.length if self.length > 0.0 else 0.0) * (self.goal - self.start)

    def velocity(self, time_s: float) -> NDArray[np.float64]:
        """Return the velocity [m/s] at a time [s].

        Raises:
            InputError: ``not_finite`` if the time is NaN.
        """
        rate = self.rate(time_s)
        return (rate / self.length if self.length > 0.0 else 0.0) * (self.goal - self.start)

    def _within(self, time_s: float) -> float:
        if math.isnan(time_s):
            raise InputError("not_finite", "time_s", time_s, "a number")
        return min(max(time_s, 0.0), self.duration)


def _check_positive(**values: float) -> None:
    for where, value in values.items():
        if not 0.0 < value < math.inf:
            raise InputError("out_of_range", where, value, "above 0, finite")


def _end(where: str, values: ArrayLike) -> NDArray[np.float64]:
    end = np.array(values, dtype=np.float64)
    if not np.isfinite(end).all():
        raise InputError("not_finite", where, end.tolist(), "finite numbers")
    end.setflags(write=False)
    return end

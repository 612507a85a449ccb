"""A path of joint positions: straight from waypoint to waypoint, measured by its length."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """Joint positions joined by straight lines in joint space.

    Attributes:
        waypoints: (w, n) [rad or m], w ≥ 1, copied and read-only. Neighbours that are equal are merged.
        goal: (3,) position of the end effector that the last waypoint reaches [m], base frame; ``None`` where
            it was asked for as a joint position.
        arc: (w,) length of the path from its beginning to each waypoint [rad], read-only.

    Raises:
        InputError: ``wrong_length`` without waypoints, ``not_finite``.
    """

    waypoints: NDArray[np.float64]
    goal: NDArray[np.float64] | None = None
    arc: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        points = np.array(self.waypoints, dtype=np.float64)
        if points.ndim != 2 or 0 in points.shape:
            raise InputError("wrong_length", "waypoints", f"shape {points.shape}", "(w, n), at least one")
        if not np.isfinite(points).all():
            raise InputError("not_finite", "waypoints", points.tolist(), "finite numbers")
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        points = points[np.concatenate([[True], lengths > 0.0])]
        arc = np.concatenate([[0.0], np.cumsum(lengths[lengths > 0.0])])
        goal = None if self.goal is None else np.array(self.goal, dtype=np.float64)
        for name, array in (("waypoints", points), ("arc", arc), ("goal", goal)):
            if array is not None:
                array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def length(self) -> float:
        """Euclidean length in joint space [rad]."""
        return float(self.arc[-1])

    def at(self, arc: float) -> NDArray[np.float64]:
        """Return the joint position, (n,), at a length from the beginning [rad]; beyond an end, that end."""
        index = int(np.searchsorted(self.arc, arc, side="right"))
        before, after = self.waypoints[max(index - 1, 0)], self.waypoints[min(index, len(self.arc) - 1)]
        if not 0 < index < len(self.arc):
            return np.array(after, dtype=np.float64)
        start, end = self.arc[index - 1], self.arc[index]
        share = (arc - start) / (end - start)
        point: NDArray[np.float64] = (1.0 - share) * before + share * after
        return point

    def nearest(self, position: NDArray[np.float64], least: float, most: float) -> tuple[float, float]:
        """Return where the path comes nearest to a joint position, within a stretch of it, and how near.

        Args:
            position: (n,) [rad or m].
            least: Where the stretch begins [rad].
            most: Where it ends [rad].

        Returns:
            Length from the path's beginning [rad], the first of equally near places; and the distance [rad].
        """
        best, nearest = least, float(np.linalg.norm(position - self.at(least)))
        for index in range(len(self.arc) - 1):
            low, high = max(self.arc[index], least), min(self.arc[index + 1], most)
            if low >= high:
                continue
            along = self.waypoints[index + 1] - self.waypoints[index]
            along = along / (self.arc[index + 1] - self.arc[index])
            arc = self.arc[index] + float((position - self.waypoints[index]) @ along)
            arc = min(max(arc, low), high)
            distance = float(np.linalg.norm(position - self.at(arc)))
            if distance < nearest:
                best, nearest = arc, distance
        return best, nearest

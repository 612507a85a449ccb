"""Shorter paths by shortcuts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .path import Path

EdgeFree = Callable[[NDArray[np.float64], NDArray[np.float64]], bool]


def shortened(
    waypoints: NDArray[np.float64],
    edge_free: EdgeFree,
    rng: np.random.Generator,
    *,
    attempts: int,
    over: Callable[[], bool],
) -> NDArray[np.float64] | None:
    """Return waypoints, (w, n), of a path that is not longer and whose every edge was checked, or None.

    A shortcut joins two places of the path, drawn by length, with a straight line where that is free. The
    ends stay.

    Args:
        waypoints: (w, n) [rad or m].
        edge_free: Whether a straight way is free.
        rng: Draws the places.
        attempts: Number of shortcuts tried.
        over: Ends the trying, not the last check.

    Returns:
        None if an edge of the result is not free: a planner may have looked more coarsely.
    """
    points = waypoints
    for _ in range(attempts):
        if len(points) <= 2 or over():
            break
        path = Path(waypoints=points)
        low, high = np.sort(rng.uniform(0.0, path.length, 2)).tolist()
        before, after = points[path.arc < low], points[path.arc > high]
        if len(before) + len(after) == len(points):
            continue  # both on one edge
        start, end = path.at(low), path.at(high)
        if edge_free(start, end):
            points = np.concatenate([before, [start, end], after])
    free = all(edge_free(points[i], points[i + 1]) for i in range(len(points) - 1))
    return points if free else None

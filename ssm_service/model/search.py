"""Hull distances of all pieces to all obstacles: measured already, or only where they could matter."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .hulls import Part
from .scene import Scene

SLACK_M: Final = 5e-6
"""GJK's hull distances exceed the mesh's by up to 1.7 µm."""


class Known:
    """Hull distances that are measured already, as ``Search`` gives them.

    Args:
        hulls: (n_obstacles, n_pieces) [m].
    """

    def __init__(self, hulls: NDArray[np.float64]) -> None:
        self._hulls = hulls

    def nearest_hull(self) -> int:
        """Return the index of the least hull distance."""
        return int(self._hulls.argmin())

    def hulls_below(self, limit: float) -> list[tuple[float, int]]:
        """Return all hull distances below a limit [m] with their indices, in rising order."""
        flat = self._hulls.ravel()
        near = (flat < limit).nonzero()[0]
        return sorted(zip(flat[near].tolist(), near.tolist(), strict=True))

    def of_part(self, index: int, part: Part) -> list[float]:
        """Return the hull distances of all of a part's pieces to the obstacle of ``index`` [m]."""
        found: list[float] = self._hulls[index // self._hulls.shape[1], part.first : part.last].tolist()
        return found


class Search:
    """Hull distances measured only where the balls' bounds say that they could matter.

    Indices speak of obstacle and piece, ``obstacle * piece_count + piece``, as in ``Scene.compute``.
    """

    def __init__(self, scene: Scene, bounds: NDArray[np.float64]) -> None:
        self._scene = scene
        self._count = scene.piece_count
        self._bounds = bounds.ravel() - SLACK_M  # rounding, with plenty of room
        self._hulls: dict[int, float] = {}

    def nearest_hull(self) -> int:
        """Return the index of the least hull distance."""
        best = int(self._bounds.argmin())
        least = self._hull(best)
        for bound, index in self._below(least):
            if bound >= least:
                break
            hull = self._hull(index)
            if hull < least:
                best, least = index, hull
        return best

    def hulls_below(self, limit: float) -> list[tuple[float, int]]:
        """Return all hull distances below a limit [m] with their indices, in rising order."""
        return sorted([(hull, i) for _, i in self._below(limit) if (hull := self._hull(i)) < limit])

    def of_part(self, index: int, part: Part) -> list[float]:
        """Return the hull distances of all of a part's pieces to the obstacle of ``index`` [m]."""
        start = index - index % self._count
        return [self._hull(start + piece) for piece in range(part.first, part.last)]

    def _below(self, limit: float) -> list[tuple[float, int]]:
        near = (self._bounds < limit).nonzero()[0].tolist()
        return sorted([(float(self._bounds[index]), index) for index in near])

    def _hull(self, index: int) -> float:
        hull = self._hulls.get(index)
        if hull is None:
            hull = self._hulls[index] = self._scene.measure(*divmod(index, self._count))
        return hull

"""Boxes that are halved until they are decided: the deterministic integrals and proofs of coverage."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Boxes of one size, in whatever coordinates.

    Attributes:
        centres: (n, 3).
        half: (3,) half edges; an axis of half edge 0 is never split.
        marks: (n,) what is known of each all over, which its halves inherit; None: nothing.
    """

    centres: Array
    half: Array
    marks: NDArray[np.intp] | None = None

    @classmethod
    def filling(cls, lower: Array, upper: Array, edges: Array) -> Cells:
        """Fill a box, corners (3,), with cells of at most the given edges, (3,)."""
        spans = upper - lower
        counts = [max(1, int(np.ceil(s / e - 1e-9))) for s, e in zip(spans, edges, strict=True)]
        half = np.array([s / (2.0 * n) for s, n in zip(spans, counts, strict=True)])
        axes = [low + h * (2.0 * np.arange(n) + 1.0) for low, h, n in zip(lower, half, counts, strict=True)]
        grid = np.meshgrid(*axes, indexing="ij")
        return cls(centres=np.stack([axis.ravel() for axis in grid], axis=1), half=half)

    @property
    def diagonal(self) -> float:
        """Half of a box's diagonal."""
        return float(np.linalg.norm(self.half))

    @property
    def volume(self) -> float:
        """Product of the edges that are not 0."""
        edges = 2.0 * self.half
        return float(np.prod(edges[edges > 0.0]))

    def where(self, mask: NDArray[np.bool_]) -> Cells:
        """Return the cells of a mask, (n,)."""
        marks = None if self.marks is None else self.marks[mask]
        return Cells(centres=self.centres[mask], half=self.half, marks=marks)

    def marked(self, marks: NDArray[np.intp]) -> Cells:
        """Return the same cells with marks."""
        return Cells(centres=self.centres, half=self.half, marks=marks)

    def split(self) -> Cells:
        """Halve every cell along each axis."""
        half = 0.5 * self.half
        signs = [(-1.0, 1.0) if h > 0.0 else (0.0,) for h in half]
        shifts = np.array(list(itertools.product(*signs))) * half
        centres = (self.centres[:, np.newaxis, :] + shifts).reshape(-1, 3)
        marks = None if self.marks is None else np.repeat(self.marks, len(shifts))
        return Cells(centres=centres, half=half, marks=marks)

    def blocks(self, size: int) -> list[Cells]:
        """Cut into blocks of at most ``size`` cells, in order."""
        parts = [slice(start, start + size) for start in range(0, len(self.centres), size)]
        marks = [None if self.marks is None else self.marks[part] for part in parts]
        return [
            Cells(centres=self.centres[part], half=self.half, marks=mark)
            for part, mark in zip(parts, marks, strict=True)
        ]

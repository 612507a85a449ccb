"""Which share of places and directions is seen by how many sensors, by gap: integrals with bounds."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model import Ring
from .coverage_cells import Cells
from .coverage_link import SensedLink

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

CLASSES: Final = 4
"""A ball is seen by 0, 1, 2, or more sensors."""

_BLOCK: Final = 65_536  # cells judged at once


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenShares:
    """By bins of the gap, the shares of balls that 0, 1, 2 or more sensors see.

    Attributes:
        edges: (b + 1,) of the bins [m].
        shares: (b, 4), each row sums to 1; the best guess within the bounds.
        lower: (b, 4) no share is below this.
        upper: (b, 4) no share is above this.
    """

    edges: Array
    shares: Array
    lower: Array
    upper: Array

    @property
    def errors(self) -> Array:
        """(b, 4) by how much each share may be off."""
        return np.maximum(self.upper - self.shares, self.shares - self.lower)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Verdict:
    """What is known of cells; all (n,). Bins −1 and b lie below and above all bins.

    Attributes:
        bins: At the middle; and the least and greatest anywhere in the cell.
        classes: Likewise.
    """

    bins: tuple[Integers, Integers, Integers]
    classes: tuple[Integers, Integers, Integers]


def place_shares(link: SensedLink, radius: float, edges: Array, resolution: float = 0.004) -> SeenShares:
    """Return the shares of the places round a link: the volume of all centres whose ball has a gap in a bin.

    Args:
        link: The link.
        radius: Of the balls [m].
        edges: (b + 1,) rising, of the bins of the gap to the link's real surface [m].
        resolution: Least edge of the boxes [m]: what they leave undecided is the error.

    Raises:
        InputError: ``out_of_range``.
    """
    edges = _checked(radius, edges, resolution)

    def _bins(gaps: Array) -> Integers:
        return np.searchsorted(edges, gaps, side="right") - 1

    def judge(cells: Cells) -> _Verdict:
        """Return bin and class of each cell's middle, and the bounds of both over the whole cell."""
        reach = cells.diagonal
        known = np.full(len(cells.centres), -1) if cells.marks is None else cells.marks
        bins, first, last = known.copy(), known.copy(), known.copy()
        open_ = known < 0
        near, far = link.distances(cells.centres[open_])
        bins[open_] = _bins(0.5 * (near + far) - radius)
        first[open_], last[open_] = _bins(near - reach - radius), _bins(far + reach - radius)
        return _Verdict(bins=(bins, first, last), classes=_classes(link, cells.centres, radius, reach))

    return _integrate(link.cells(radius + edges[-1], 0.064), judge, edges, resolution)


def ring_shares(
    link: SensedLink,
    ring: Ring,
    transform_ring_to_link: Array,
    radius: float,
    edges: Array,
    axial: float = 0.1,
    resolution: float = 0.004,
) -> SeenShares:
    """Return the shares of the directions round a ring: bearing × axial offset × gap, each uniform.

    The gap is that from the cylinder on which the ring's sensors sit, as in SCIENCE 3.

    Args:
        link: The link with all of its sensors.
        ring: The ring.
        transform_ring_to_link: (4, 4) [m].
        radius: Of the balls [m].
        edges: (b + 1,) rising, of the bins of the gap [m].
        axial: Balls' centres lie within ± this of the ring's plane [m]; 0: in the plane.
        resolution: As for ``place_shares``.

    Raises:
        InputError: ``out_of_range``.
    """
    edges = _checked(radius, edges, resolution)
    rotation, origin = transform_ring_to_link[:3, :3], transform_ring_to_link[:3, 3]
    parts = []
    for bin_, (low, high) in enumerate(itertools.pairwise(edges.tolist())):
        farthest = ring.radius + radius + high

        def judge(cells: Cells, bin_: int = bin_) -> _Verdict:
            """Return the class of each cell's middle and its bounds over the cell; all are of this bin."""
            bearing, z, gap = cells.centres.T
            rho = ring.radius + radius + gap
            local = np.stack([rho * np.cos(bearing), rho * np.sin(bearing), z], axis=1)
            greatest = float(rho.max()) + cells.half[2]
            reach = float(np.linalg.norm(cells.half * [greatest, 1.0, 1.0]))
            bins = np.full(len(z), bin_)
            centres = local @ rotation.T + origin
            return _Verdict(bins=(bins, bins, bins), classes=_classes(link, centres, radius, reach))

        box = np.array([0.0, -axial, low]), np.array([2.0 * np.pi, axial, high])
        cells = Cells.filling(*box, np.array([0.064 / farthest, 0.064, 0.064]))
        parts.append(_integrate(cells, judge, edges, resolution, scale=np.array([farthest, 1.0, 1.0])))
    rows = range(len(parts))
    return SeenShares(
        edges=edges,
        shares=np.array([parts[i].shares[i] for i in rows]),
        lower=np.array([parts[i].lower[i] for i in rows]),
        upper=np.array([parts[i].upper[i] for i in rows]),
    )


def _classes(
    link: SensedLink, centres: Array, radius: float, reach: float
) -> tuple[Integers, Integers, Integers]:
    radii = np.array([radius, radius - reach, radius + reach])
    found = np.minimum(link.cones.counts(centres, radii), CLASSES - 1).astype(np.intp)
    return found[0], found[1], found[2]


def _integrate(
    cells: Cells,
    judge: Callable[[Cells], _Verdict],
    edges: Array,
    resolution: float,
    scale: Array | float = 1.0,
) -> SeenShares:
    """Halve cells until bin and class are the same all over each, or its longest edge is small."""
    count = len(edges) - 1
    guess, sure, may, other = (np.zeros((count, CLASSES)) for _ in range(4))
    stack = cells.blocks(_BLOCK)
    while stack:
        block = stack.pop()
        verdict = judge(block)
        (bins, first, last), (classes, fewest, most) = verdict.bins, verdict.classes
        relevant = (last >= 0) & (first < count)
        decided = relevant & (first == last) & (fewest == most)
        volume = block.volume
        np.add.at(sure, (bins[decided], classes[decided]), volume)
        np.add.at(guess, (bins[decided], classes[decided]), volume)
        open_ = relevant & ~decided
        if not open_.any():
            continue
        if float((2.0 * block.half * scale).max()) > resolution * (1.0 + 1e-9):
            sure_bins = np.where(first == last, bins, -1)  # need not be asked for again
            stack += block.marked(sure_bins).where(open_).split().blocks(_BLOCK)
            continue
        inside = open_ & (bins >= 0) & (bins < count)
        np.add.at(guess, (bins[inside], classes[inside]), volume)
        for b in range(count):
            touching = open_ & (first <= b) & (last >= b)
            for k in range(CLASSES):
                may[b, k] += volume * np.count_nonzero(touching & (fewest <= k) & (most >= k))
                other[b, k] += volume * np.count_nonzero(touching & ~((fewest == k) & (most == k)))
    return _shares(edges, guess, sure, may, other)


def _shares(edges: Array, guess: Array, sure: Array, may: Array, other: Array) -> SeenShares:
    all_sure = sure.sum(axis=1, keepdims=True)
    lower = sure / np.maximum(all_sure + other, 1e-300)
    upper = (sure + may) / np.maximum(all_sure + may, 1e-300)
    shares = guess / np.maximum(guess.sum(axis=1, keepdims=True), 1e-300)
    return SeenShares(edges=edges, shares=np.clip(shares, lower, upper), lower=lower, upper=upper)


def _checked(radius: float, edges: Array, resolution: float) -> Array:
    edges = np.asarray(edges, dtype=np.float64)
    if not 0.0 < radius < np.inf:
        raise InputError("out_of_range", "radius", radius, "a number of metres above 0")
    if not 0.0 < resolution < np.inf:
        raise InputError("out_of_range", "resolution", resolution, "a number of metres above 0")
    if edges.ndim != 1 or len(edges) < 2 or not (np.isfinite(edges).all() and (np.diff(edges) > 0.0).all()):
        raise InputError("out_of_range", "edges", edges.tolist(), "two or more finite, rising numbers")
    return edges

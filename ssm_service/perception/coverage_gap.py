"""How near a ball can come to a link unseen, and how large one can touch it unseen, with bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .coverage_link import SensedLink

Array = NDArray[np.float64]

_FIRST_EDGE_M: Final = 0.064
_MOST_CELLS: Final = 4_000_000
"""Cells of one size that are still split; beyond, the bounds stay as wide as they are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClearDistance:
    """The greatest gap up to which every ball of one radius is seen.

    Attributes:
        radius: The balls' radius [m].
        lower: Every ball that lies nearer than this is seen [m]: proved.
        upper: Some ball at this gap is not [m]; None: none was found up to ``limit``.
        limit: How far was looked [m].
        witness: Centre of that ball, (x, y, z) [m], link frame; None where there is none.
        cells: How many boxes were looked at.
    """

    radius: float
    lower: float
    upper: float | None
    limit: float
    witness: tuple[float, float, float] | None
    cells: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LargestUnseen:
    """The largest ball that can touch a link unseen; any larger one is seen before it touches.

    Attributes:
        lower: Some ball of this radius touches unseen [m]; 0 where none was found.
        upper: No ball above this radius does [m]; infinite where ``lower`` reaches ``cap``.
        cap: Largest radius that was looked at [m].
        witness: Centre of the ball of radius ``lower``, (x, y, z) [m], link frame; None where there is none.
    """

    lower: float
    upper: float
    cap: float
    witness: tuple[float, float, float] | None


def clear_distance(link: SensedLink, radius: float, limit: float, resolution: float = 0.002) -> ClearDistance:
    """Find the greatest gap up to which every ball is seen, by halving boxes of centres.

    With f the distance of a centre from the nearest sector and D that from the link, a ball is unseen where
    f > R and its gap is D − R. Neither changes by more than the centre moves, so a box of half diagonal η is
    done with where f ≤ R − η at its middle (all seen), where D < R − η (all overlap the link), and where
    D − η − R is not below the least gap of an unseen ball found so far.

    Args:
        link: The link.
        radius: R [m].
        limit: How far to look [m].
        resolution: Least edge of a box [m].

    Raises:
        InputError: ``out_of_range``.
    """
    _require(radius=radius, limit=limit, resolution=resolution)
    cells = link.cells(radius + limit, _FIRST_EDGE_M)
    best, witness, looked, lower = limit, None, 0, limit
    while True:
        looked += len(cells.centres)
        unseen = link.cones.least_distances(cells.centres)
        keep = unseen + cells.diagonal > radius
        cells, unseen = cells.where(keep), unseen[keep]
        rough = link.body.lower(cells.centres)
        keep = rough - cells.diagonal - radius < best
        cells, unseen = cells.where(keep), unseen[keep]
        near, far = link.distances(cells.centres)
        gaps = np.where((unseen > radius) & (near >= radius), far - radius, np.inf)
        if len(gaps) and gaps.min() < best:
            best = float(gaps.min())
            witness = tuple(cells.centres[int(gaps.argmin())].tolist())
        bounds = np.maximum(near - cells.diagonal - radius, 0.0)
        open_ = (bounds < best) & (far + cells.diagonal >= radius)
        lower = float(bounds[open_].min()) if open_.any() else best
        cells = cells.where(open_)
        done = not open_.any() or best - lower <= 0.25 * resolution
        if done or 2.0 * cells.half.max() <= resolution or len(cells.centres) > _MOST_CELLS:
            break
        cells = cells.split()
    upper = best if witness is not None else None
    return ClearDistance(radius=radius, lower=lower, upper=upper, limit=limit, witness=witness, cells=looked)


def largest_unseen(link: SensedLink, cap: float = 0.5, resolution: float = 0.001) -> LargestUnseen:
    """Find the largest ball that can touch a link unseen, by halving boxes of centres.

    The ball round c that touches the link has the radius D(c), and is unseen where f(c) > D(c). Balls that
    touch at one point with one normal lie within each other, so along the normal they are unseen up to one
    radius and seen from there on. A box of half diagonal η is done with where f + η ≤ D − η at its middle
    and where D + η is not above the largest radius found so far.

    Args:
        link: The link.
        cap: Largest radius to look at [m].
        resolution: How near the bounds are to come, where they can [m].

    Raises:
        InputError: ``out_of_range``.
    """
    _require(cap=cap, resolution=resolution)
    cells = link.cells(cap, _FIRST_EDGE_M)
    best, witness, upper = 0.0, None, cap
    while True:
        unseen = link.cones.least_distances(cells.centres)
        keep = unseen + 2.0 * cells.diagonal > link.body.lower(cells.centres)
        cells, unseen = cells.where(keep), unseen[keep]
        near, far = link.distances(cells.centres)
        radii = np.where(unseen > far, near, 0.0)
        if len(radii) and radii.max() > best:
            best = float(radii.max())
            witness = tuple(cells.centres[int(radii.argmax())].tolist())
        open_ = (unseen + 2.0 * cells.diagonal > near) & (far + cells.diagonal > best)
        upper = float((far + cells.diagonal)[open_].max()) if open_.any() else best
        if best >= cap or upper - best <= resolution or not open_.any():
            break
        if 2.0 * cells.half.max() <= 0.25 * resolution or open_.sum() > _MOST_CELLS:
            break
        cells = cells.where(open_).split()
    if best >= cap or upper >= cap:
        upper = np.inf
    return LargestUnseen(lower=min(best, cap), upper=upper, cap=cap, witness=witness)


def _require(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < np.inf:
            raise InputError("out_of_range", name, value, "a number of metres above 0")

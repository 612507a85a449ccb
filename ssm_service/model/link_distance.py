"""Distance of points from one link, from a table: fast, and never above the truth."""

from __future__ import annotations

import hashlib
import sys
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, listed
from . import store
from .link_samples import LinkGeometry
from .robot import Robot

Array = NDArray[np.float64]

# Box round the link larger by [m], spacing of its nodes [m], covering radius of the mesh's samples [m].
_LEVELS: Final = (
    (0.1, 0.006, 0.003),
    (0.25, 0.010, 0.0035),
    (0.6, 0.022, 0.005),
    (1.7, 0.06, 0.010),
    (12.0, 0.8, 0.03),
)
_WITH_POINTS: Final = 2  # levels, the finest, whose nodes' nearest points are kept
_ROUNDING: Final = 1e-9  # [m²]; of the expressions in double precision, at the size of the table

_Tables = tuple[Array, NDArray[np.float32], Array, NDArray[np.float32]]

_KEPT: Final = 16
_MADE: Final[dict[bytes, _Tables]] = {}
"""Tables by the shape they are of: a process that asks for a link again need not wait again."""


class LinkDistance:
    """Distance of points from one link's collision geometry, in the link's frame.

    For any closed set, D(c)² − |c|² = min over its points p of |p|² − 2 p·c is concave, as the least of
    affine functions. Between exact values at the nodes of a grid, multilinear interpolation of it is
    therefore never above it. It is below it by at most 0.75 h² (h the spacing) where one smooth patch is
    nearest, and by up to about h·D where the nearest points jump, over hollows. Boxes about the link hold
    grids that widen outwards; beyond the last, the distance from the box round the link is taken.

    Points inside the link have distance 0 as soon as they lie one cell deep. Inside is what a ball of 9 mm
    cannot get to from outside: hollow links count as solid, and narrower passages as closed.

    The table is made at the first use (one to two seconds) and holds some 8 MB. It is kept in the user's
    cache, and shared by all links of the same shape. Calls from several threads are safe once it is made.
    """

    def __init__(self, robot: Robot, link: str) -> None:
        """Gather the link's geometry.

        Raises:
            InputError: ``unknown_link``: no link of that name has collision geometry.
            ConfigError: A shape is none that URDF knows, or a mesh is not finite.
        """
        if link not in robot.geometry_of_link:
            allowed = f"a link with collision geometry: {listed(robot.geometry_of_link)}"
            raise InputError("unknown_link", "link", link, allowed)
        self.link = link
        self._geometry = LinkGeometry(robot, link)

    @property
    def box(self) -> Array:
        """(6,) least and greatest corner of the box round the link [m]."""
        return np.concatenate([self._geometry.lower, self._geometry.upper])

    @property
    def table(self) -> tuple[Array, NDArray[np.float32], Array]:
        """What ``link_table.squared_minus`` takes: levels (n, 8), node values, box (6,); read-only."""
        return self._tables[:3]

    @property
    def near_points(self) -> NDArray[np.float32]:
        """(m, 3) a point of the link near each node of the first two levels [m]; read-only.

        Such a point is never nearer than the link itself, so those of a cell's corners bound D from above.
        """
        return self._tables[3]

    @cached_property
    def _tables(self) -> _Tables:
        shape = self._geometry.fingerprint()
        made = _MADE.get(shape)
        if made is None:
            made = self._kept(f"link-{_digest(shape)}")
            while len(_MADE) >= _KEPT:
                _MADE.pop(next(iter(_MADE)), None)
            _MADE[shape] = made
        return made

    def _kept(self, name: str) -> _Tables:
        """Return the tables from disk; where they are not, make them and put them there."""
        levels, nodes, near = self._levels()
        content = store.load(name, 4 * nodes + 12 * near)
        if content is None:
            made = self._make()
            store.save(name, made[1].tobytes() + made[3].tobytes())
            return made
        values = np.frombuffer(content, np.float32, nodes)
        points = np.frombuffer(content, np.float32, offset=4 * nodes).reshape(near, 3)
        for array in (levels, box := self.box):
            array.flags.writeable = False
        return levels, values, box, points

    def _levels(self) -> tuple[Array, int, int]:
        """Return the levels (n, 8), the number of nodes of all, and of those with near points."""
        levels, first, near = [], 0, 0
        for number, (margin, spacing, _) in enumerate(_LEVELS):
            origin = self._geometry.lower - margin
            counts = np.ceil((self._geometry.upper + margin - origin) / spacing).astype(int) + 1
            levels.append([*origin, spacing, *counts, first])
            first += int(np.prod(counts))
            near = first if number < _WITH_POINTS else near
        return np.array(levels), first, near

    def _make(self) -> _Tables:
        levels, _, _ = self._levels()
        values, points = [], []
        for number, (level, (_, spacing, covering)) in enumerate(zip(levels, _LEVELS, strict=True)):
            counts = level[4:7].astype(int)
            axes = [level[i] + spacing * np.arange(counts[i]) for i in range(3)]
            nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
            near, squared = self._geometry.nearest(nodes, covering)
            if number == 0:
                squared[_inside(squared.reshape(counts), spacing).ravel()] = 0.0
            if number < _WITH_POINTS:
                points.append(near.astype(np.float32))
            exact = squared - np.einsum("ij,ij->i", nodes, nodes) - _ROUNDING
            values.append(np.nextafter(exact.astype(np.float32), np.float32(-np.inf)))
        made = levels, np.concatenate(values), self.box, np.concatenate(points)
        for array in made:
            array.flags.writeable = False
        return made

    def lower(self, points: ArrayLike) -> Array:
        """Return the distances from below: never above the truth, (n,) [m].

        Args:
            points: (n, 3) [m], link frame.

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        from .link_table import distances  # numba takes half a second to import

        where = np.asarray(points, dtype=np.float64)
        if where.ndim != 2 or where.shape[1] != 3:
            raise InputError("wrong_length", "points", where.shape, "(n, 3)")
        if not np.isfinite(where).all():
            raise InputError("not_finite", "points", "numbers that are not finite", "finite numbers")
        return distances(*self.table, where)

    def distance(self, points: ArrayLike) -> Array:
        """Return the distances, (n,) [m]: those of ``lower``, which are at most ``tolerance`` too small.

        Args:
            points: (n, 3) [m], link frame.

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        return self.lower(points)

    def tolerance(self, distance: ArrayLike) -> Array:
        """Return by how much [m] ``distance`` and ``lower`` may be too small where they say ``distance`` [m].

        That is over a hollow of the link; 99 of 100 values are off by less than a tenth of it. It holds
        outside the link, up to 12 m from it.
        """
        d = np.asarray(distance, dtype=np.float64)
        margins, spacings = np.array(_LEVELS)[:, :2].T
        # Nodes at distances s of c have D_j ≥ D − s, so D_low² = Σ w (D_j² − s²) ≥ D² − 2 D·s, s ≤ √3 h; and
        # a point nearer than the margin lies in that level. One level more, as d itself is too small.
        level = np.minimum(np.searchsorted(0.9 * margins, d), len(margins) - 1)
        return np.asarray(2.0 * np.sqrt(3.0) * spacings[level])


def _digest(shape: bytes) -> str:
    """Return a digest of all that a table depends on: the link's shape, and how tables are made."""
    here = Path(__file__).parent
    how = b"".join((here / name).read_bytes() for name in ("link_distance.py", "link_samples.py"))
    return hashlib.sha256(shape + how + sys.byteorder.encode()).hexdigest()


def _inside(squared: Array, spacing: float) -> NDArray[np.bool_]:
    """Return which nodes lie inside the link, of those more than half a spacing off its surface.

    Between two neighbours that both do, no surface crosses the grid's edge. Nodes not joined to the border by
    such edges are inside: the centre of a ball of radius 1.37 h could not be moved there from outside, as all
    nodes of the cells along its way would be more than half a spacing off the surface, and joined.
    """
    from scipy import ndimage  # a quarter of a second to import

    labels, _ = ndimage.label(squared > (0.5 * spacing) ** 2)
    outside = labels[0, 0, 0]
    return np.asarray((labels != 0) & (labels != outside))

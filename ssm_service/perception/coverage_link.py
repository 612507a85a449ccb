"""One link with the sensors that it carries: what coverage is asked of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model import Robot
from ..model.link_distance import LinkDistance
from ..model.link_samples import LinkGeometry
from .coverage_cells import Cells
from .coverage_cones import Cones

Array = NDArray[np.float64]

_APART_M: Final = 0.008
_ROUNDING_M: Final = 1e-9
_COVERING_M: Final = 0.005
_INSIDE_M: Final = 0.0209  # shallower than this, the table may say 0


class Solid(Protocol):
    """A body's distance from below, by a table: 0 inside."""

    @property
    def box(self) -> Array:
        """(6,) least and greatest corner of the box round it [m]."""

    @property
    def near_points(self) -> NDArray[np.float32]:
        """(m, 3) points of its surface, here and there [m]."""

    def lower(self, points: ArrayLike) -> Array:
        """Return distances of points, (n, 3) [m], never above the truth, (n,) [m]."""


class Surface(Protocol):
    """The same body's distance more exactly, and more slowly; inside, that from its surface."""

    def nearest(self, points: Array, covering: float) -> tuple[Array, Array]:
        """Return points of the surface, (n, 3) [m], and squared distances D², too small by ≤ covering²."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensedLink:
    """A link and its own sensors, without the rest of the arm: nothing stands in the sensors' way.

    Attributes:
        name: The link's name.
        body: Its solid, in the link's frame.
        surface: Its surface, likewise.
        points: (m, 3) points of the surface, about 8 mm apart [m], which no cone may hold.
        cones: Its sensors, in the same frame.
    """

    name: str
    body: Solid
    surface: Surface
    points: Array
    cones: Cones

    @classmethod
    def of(cls, name: str, body: Solid, surface: Surface, cones: Cones) -> SensedLink:
        """Join a body and its sensors."""
        points = np.asarray(body.near_points, dtype=np.float64)
        return cls(
            name=name,
            body=body,
            surface=surface,
            points=_thinned(points, _APART_M),
            cones=cones,
        )

    def with_cones(self, cones: Cones) -> SensedLink:
        """Return the same link with other sensors."""
        return replace(self, cones=cones)

    def distances(self, centres: Array) -> tuple[Array, Array]:
        """Return bounds of the distance from the link, (n,) and (n,) [m], of centres, (n, 3) [m].

        Outside the link they are at most 0.3 mm apart at 0.05 m, less beyond.
        """
        solid = self.body.lower(centres)
        _, squared = self.surface.nearest(centres, _COVERING_M)
        lower = np.maximum(solid, np.sqrt(squared) - _ROUNDING_M)
        upper = np.maximum(np.sqrt(squared + _COVERING_M**2) + _ROUNDING_M, lower)
        inside = solid <= 0.0
        lower[inside], upper[inside] = 0.0, np.minimum(upper[inside], _INSIDE_M)
        return lower, upper

    def cells(self, margin: float, edge: float) -> Cells:
        """Return cubes of at most ``edge`` [m] that fill the box round the link, larger by ``margin`` [m]."""
        box = self.body.box
        return Cells.filling(box[:3] - margin, box[3:] + margin, np.full(3, edge))


def sensed_link(robot: Robot, link: str, cones: Cones) -> SensedLink:
    """Return a link of a robot with any sensors.

    Raises:
        InputError: ``unknown_link``: it has no collision geometry.
    """
    return SensedLink.of(link, LinkDistance(robot, link), LinkGeometry(robot, link), cones)


def sensed_links(
    robot: Robot, reading_error: float | None = None, position: ArrayLike | None = None
) -> tuple[SensedLink, ...]:
    """Return every link that carries sensors, in the order of the robot's sensor arrays.

    Args:
        robot: The robot.
        reading_error: Greatest error of a reading [m]; left out: that of the file's assumptions, else 0.
        position: (n,) joint positions [rad or m] at which the arm's other links stand in the sensors' way: a
            sensor that sees one is taken to see no farther than that. Left out: none does.

    Raises:
        InputError: ``wrong_length``, ``not_finite``, or an error that leaves a sensor no range.
    """
    if reading_error is None:
        assumptions = robot.config.file.assumptions
        reading_error = assumptions.reading_error_m if assumptions is not None else 0.0
    clear = np.full(robot.sensor_count, np.inf)
    if position is not None:
        from .own_links import OwnLinks

        clear = OwnLinks(robot).readings(position)
    return tuple(
        sensed_link(
            robot,
            array.link,
            Cones.of_array(array, reading_error).cut(clear[array.indices] - reading_error),
        )
        for array in robot.sensor_arrays
    )


def _thinned(points: Array, apart: float) -> Array:
    """Return one of the points, (n, 3) [m], in each cube of edge ``apart`` [m] that holds any."""
    _, first = np.unique(np.floor(points / apart).astype(np.int64), axis=0, return_index=True)
    kept = np.ascontiguousarray(points[np.sort(first)])
    kept.flags.writeable = False
    return kept

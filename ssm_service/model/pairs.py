"""Every monitored link with every obstacle, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .distance import ClosestPair


@dataclass(slots=True, kw_only=True, eq=False)
class Pairs:
    """Some p or all pairs of links (outer) and obstacles (inner) at one joint position, in the base frame.

    Each pair is that of the link's hull pieces at first, whose distance is never too large, and of its
    triangles once ``DistanceModel.refine`` was asked for it.

    Attributes:
        links: Names of the links.
        obstacles: Ids of the obstacles.
        link: (p,) indices into ``links``.
        obstacle: (p,) indices into ``obstacles``.
        distance: (p,) [m], signed; ``-inf`` where Coal failed.
        exact: (p,) whether the triangles were asked.
        point_on_link: (p, 3) [m].
        point_on_obstacle: (p, 3) [m].
        normal: (p, 3) unit, from the obstacle to the link in every case, also in penetration.
    """

    links: tuple[str, ...]
    obstacles: tuple[str, ...]
    link: NDArray[np.intp]
    obstacle: NDArray[np.intp]
    distance: NDArray[np.float64]
    exact: NDArray[np.bool_]
    point_on_link: NDArray[np.float64]
    point_on_obstacle: NDArray[np.float64]
    normal: NDArray[np.float64]

    @classmethod
    def of(cls, closest: Sequence[ClosestPair], links: tuple[str, ...], obstacles: tuple[str, ...]) -> Pairs:
        """Return what ``DistanceModel.all_pairs`` found as arrays.

        Args:
            closest: All pairs.
            links: The monitored links.
            obstacles: The obstacles' ids.
        """
        link, obstacle = (index.ravel() for index in np.indices((len(links), len(obstacles))))
        return cls(
            links=links,
            obstacles=obstacles,
            link=link,
            obstacle=obstacle,
            distance=np.array([pair.distance for pair in closest], dtype=np.float64),
            exact=np.ones(len(closest), dtype=np.bool_),
            point_on_link=np.array([pair.point_on_link for pair in closest]).reshape(-1, 3),
            point_on_obstacle=np.array([pair.point_on_obstacle for pair in closest]).reshape(-1, 3),
            normal=np.array([pair.normal for pair in closest]).reshape(-1, 3),
        )

    def __len__(self) -> int:
        return len(self.distance)

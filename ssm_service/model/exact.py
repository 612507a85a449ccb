"""The exact tier: one link geometry against one obstacle, measured to the mesh's own triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import coal
import numpy as np
from numpy.typing import NDArray

from .hulls import Part
from .scene import Scene, Slot

_INSIDE: Final = 2e-6  # [m]; GJK is off by up to 1.7 µm: nearer than this to a hull counts as inside
_FARTHEST_M: Final = 1e5
"""No distance of a robot to an obstacle within 1 km is beyond this; Coal's 'not computed' is."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """A signed distance and where it was measured.

    Attributes:
        distance: [m]; negative in penetration.
        part: The link's geometry.
        obstacle: Index of the obstacle.
        piece: Index, among all pieces, of the part's hull piece that is nearest to the obstacle.
        point_on_mesh: (3,) base frame [m]; None where the distance is that of the hull piece.
        point_on_core: (3,) base frame [m]; likewise.
    """

    distance: float
    part: Part
    obstacle: int
    piece: int
    point_on_mesh: NDArray[np.float64] | None = None
    point_on_core: NDArray[np.float64] | None = None


class ExactTier:
    """Measures pairs of the scene's last computation.

    Coal's distance to a mesh has no inside: it is right only for what lies outside the mesh. The hull pieces
    are signed. So the mesh decides while the obstacle's core (centre of a sphere, segment of a capsule,
    the solid itself otherwise) does not touch it and the obstacle's centre is outside all pieces of the
    part; otherwise the deepest piece decides. The distance to the core, less the radius, is then signed
    and exact, and six to ten times faster than the distance to the thick shape.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._request = coal.DistanceRequest()
        self._result = coal.DistanceResult()
        self._point = coal.Sphere(0.0)

    def measure(
        self, part: Part, obstacle: int, hulls: list[float], limit: float = math.inf
    ) -> Measured | None:
        """Measure one part against one obstacle.

        Args:
            part: The link's geometry.
            obstacle: Index of the obstacle.
            hulls: What ``Scene.compute`` returned.
            limit: Only distances below this are of interest [m].

        Returns:
            The signed distance, or None where it is not below ``limit``.
        """
        start = obstacle * self._scene.piece_count
        distances = hulls[start + part.first : start + part.last]
        hull = min(distances)
        piece = part.first + distances.index(hull)
        if hull == -math.inf:  # Coal failed on a piece: contact, as far as anybody knows
            return Measured(distance=0.0, part=part, obstacle=obstacle, piece=piece) if limit > 0.0 else None
        slot = self._scene.slots[obstacle]
        if part.is_mesh and not self._centre_inside(part, slot, hull):
            core_limit = limit + slot.radius
            distance = self._to_core(part, slot, core_limit)
            if distance == core_limit:
                return None  # the limit was not beaten; Coal has no points then
            if 0.0 < distance < _FARTHEST_M or (distance == 0.0 and slot.shape == "sphere"):
                return Measured(
                    distance=distance - slot.radius,
                    part=part,
                    obstacle=obstacle,
                    piece=piece,
                    point_on_mesh=self._result.getNearestPoint1(),
                    point_on_core=self._result.getNearestPoint2(),
                )
        return Measured(distance=hull, part=part, obstacle=obstacle, piece=piece) if hull < limit else None

    def _to_core(self, part: Part, slot: Slot, limit: float) -> float:
        """Return the distance to the core, or ``limit`` where it is not below it [m]."""
        self._result.clear()  # also a limit that an earlier pair left there
        if limit < _FARTHEST_M:
            self._result.min_distance = limit
        transform_mesh = coal.Transform3s(self._scene.placement_of(part))
        return float(
            coal.distance(
                part.source.geometry,
                transform_mesh,
                slot.core,
                slot.transform_core,
                self._request,
                self._result,
            )
        )

    def _centre_inside(self, part: Part, slot: Slot, hull: float) -> bool:
        """Tell whether the obstacle's centre lies inside one of the part's hull pieces."""
        if slot.shape == "sphere":
            return hull + slot.radius <= _INSIDE
        if hull > 0.0:
            return False
        transform_mesh = coal.Transform3s(self._scene.placement_of(part))
        centre = coal.Transform3s(slot.transform_core.getTranslation())
        for piece in part.pieces:
            self._result.clear()
            distance = coal.distance(piece, transform_mesh, self._point, centre, self._request, self._result)
            if not distance > _INSIDE:
                return True
        return False

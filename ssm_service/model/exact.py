"""The exact tier: one link geometry against one obstacle, measured to the mesh's own triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import coal
import numpy as np
from numpy.typing import NDArray

from .hulls import Part
from .scene import Scene, Slot
from .surface import Separation, Surface, SurfaceDistance

_INSIDE_M: Final = 2e-6  # [m]; GJK is off by up to 1.7 µm: nearer than this to a hull counts as inside
_TIGHT_M: Final = 1e-6  # [m]; bounds this close to each other are taken as equal
_TOUCH_M: Final = 1e-9
_NEAR_HULL_M: Final = (5e-6, 1e-3)
_FARTHEST_M: Final = 1e5
"""No distance of a robot to an obstacle within 1 km is beyond this; Coal's 'not computed' is."""


@dataclass(slots=True, eq=False)
class Measured:
    """A signed distance and where it was measured.

    Attributes:
        distance: [m]; negative in penetration.
        part: The link's geometry.
        obstacle: Index of the obstacle.
        piece: Index, among all pieces, of the part's hull piece that is nearest to the obstacle.
        by_mesh: Whether the triangles decided; else that hull piece did.
        link_point: (3,) base frame [m], on the mesh or on the hull piece.
        obstacle_point: (3,) base frame [m], on the obstacle's core (``by_mesh``) or on its surface.
        normal: (3,) Coal's normal between hull piece and obstacle; None where ``by_mesh``.
    """

    distance: float
    part: Part
    obstacle: int
    piece: int
    by_mesh: bool
    link_point: NDArray[np.float64]
    obstacle_point: NDArray[np.float64]
    normal: NDArray[np.float64] | None


@lru_cache(maxsize=256)
def _surface(part: Part) -> Surface:
    return Surface(part.source.geometry)


class ExactTier:
    """Measures pairs of the scene's last computation.

    Coal's distance to a mesh has no inside: it is right only for what lies outside the mesh. The hull pieces
    are signed. So the mesh decides while the obstacle's core (centre of a sphere, segment of a capsule,
    the solid itself otherwise) does not touch it and the obstacle's centre is outside all pieces of the
    part; otherwise the deepest piece decides. The distance to the core, less the radius, is then signed
    and exact, and six to ten times faster than the distance to the thick shape. Coal is fast from a mesh
    to a point or a segment; to boxes and cylinders ``SurfaceDistance`` is, where the hull does not tell.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._request = coal.DistanceRequest()
        self._result = coal.DistanceResult()
        self._point = coal.Sphere(0.0)
        self._surfaces = {p.first: _surface(p) for p in scene.parts if p.is_mesh}
        self._surface_distance = SurfaceDistance()

    def measure(
        self, part: Part, obstacle: int, hulls: list[float], limit: float = math.inf
    ) -> Measured | None:
        """Measure one part against one obstacle.

        Args:
            part: The link's geometry.
            obstacle: Index of the obstacle.
            hulls: Distances of the part's hull pieces to the obstacle, in their order [m].
            limit: Only distances below this are of interest [m].

        Returns:
            The signed distance, or None where it is not below ``limit``.
        """
        hull = min(hulls)
        slot = self._scene.slot(obstacle)
        transform_link = self._scene.transform_of(part)
        if not part.is_mesh or self._centre_inside(part, transform_link, slot, hull):
            return self._by_hull(part, transform_link, obstacle, limit)
        piece = part.first + hulls.index(hull)
        core_limit = max(limit + slot.radius, _TOUCH_M)  # above 0, or a core through the surface goes unseen
        if slot.core is slot.solid:
            found = self._to_solid(part, transform_link, slot, piece, core_limit)
        else:
            found = self._to_thin_core(part, transform_link, slot, hull, core_limit)
        if found is None:
            return None
        if found.distance > 0.0:
            distance = found.distance - slot.radius
            if not distance < limit:
                return None
            return Measured(distance, part, obstacle, piece, True, found.mesh_point, found.solid_point, None)
        return self._by_hull(part, transform_link, obstacle, limit)

    def _by_hull(self, part: Part, transform_link: Any, obstacle: int, limit: float) -> Measured | None:
        """Measure the hull pieces anew: unlike the scene's, this does not depend on earlier calls.

        (The scene's solvers keep where they last looked, which moves results within GJK's tolerance.)
        """
        slot = self._scene.slot(obstacle)
        best: Measured | None = None
        for index, shape in enumerate(part.pieces):
            self._result.clear()
            distance = coal.distance(
                shape, transform_link, slot.solid, slot.transform_core, self._request, self._result
            )
            if not abs(distance) < _FARTHEST_M:
                distance = 0.0  # Coal failed: contact, as far as anybody knows
            if distance < limit:
                limit = distance
                points = self._result.getNearestPoint1(), self._result.getNearestPoint2()
                normal = np.array(self._result.normal)
                best = Measured(distance, part, obstacle, part.first + index, False, *points, normal)
        return best

    def _to_thin_core(
        self, part: Part, transform_link: Any, slot: Slot, hull: float, limit: float
    ) -> Separation | None:
        """Return mesh and centre or segment apart, or None where they are not below ``limit`` [m]."""
        # The hull mostly lies on the mesh: a limit just above it prunes nearly all triangles.
        for above in _NEAR_HULL_M:
            seed = hull + slot.radius + above
            if 0.0 < seed < limit:
                distance = self._run(part, transform_link, slot.core, slot.transform_core, seed)
                if distance != seed:
                    return self._separation(distance)
        distance = self._run(part, transform_link, slot.core, slot.transform_core, limit)
        if distance == limit < _FARTHEST_M:
            return None  # the limit was not beaten; Coal has no points then
        return self._separation(distance)

    def _to_solid(
        self, part: Part, transform_link: Any, slot: Slot, piece: int, limit: float
    ) -> Separation | None:
        """Return mesh and box or cylinder apart, or None where they are not below ``limit`` [m]."""
        surface = self._surfaces[part.first]
        # The mesh's distance to the solid's point nearest to the hull is an upper bound; where the hull lies
        # on the mesh, as it mostly does, it is the distance.
        self._result.clear()
        hull = coal.distance(
            part.pieces[piece - part.first],
            transform_link,
            slot.solid,
            slot.transform_core,
            self._request,
            self._result,
        )
        if 0.0 < hull < limit:
            witness = coal.Transform3s(self._result.getNearestPoint2())
            upper = self._run(part, transform_link, self._point, witness, limit)
            if upper < min(limit, hull + _TIGHT_M):
                return self._separation(upper)
            seed = upper + _TIGHT_M
            if 0.0 < seed < limit:
                found = self._surface_distance.measure(surface, transform_link, slot, seed)
                if found is not None:
                    return found
        return self._surface_distance.measure(surface, transform_link, slot, limit)

    def _separation(self, distance: float) -> Separation:
        return Separation(
            distance=distance if 0.0 < distance < _FARTHEST_M else 0.0,
            mesh_point=self._result.getNearestPoint1(),
            solid_point=self._result.getNearestPoint2(),
        )

    def _run(self, part: Part, transform_link: Any, shape: Any, transform: Any, limit: float) -> float:
        self._result.clear()  # also a limit that an earlier pair left there
        if limit < _FARTHEST_M:
            self._result.min_distance = limit
        mesh = part.source.geometry
        return float(coal.distance(mesh, transform_link, shape, transform, self._request, self._result))

    def _centre_inside(self, part: Part, transform_link: Any, slot: Slot, hull: float) -> bool:
        """Tell whether the obstacle's centre lies inside one of the part's hull pieces."""
        if slot.shape == "sphere":
            return hull + slot.radius <= _INSIDE_M
        if hull > 0.0:
            return False
        centre = coal.Transform3s(slot.transform_core.getTranslation())
        for shape in part.pieces:
            self._result.clear()
            distance = coal.distance(shape, transform_link, self._point, centre, self._request, self._result)
            if not distance > _INSIDE_M:
                return True
        return False

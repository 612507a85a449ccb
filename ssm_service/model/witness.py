"""Nearest points and the direction between them, finite and unit in every case."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from .exact import Measured
from .scene import Scene, Slot

_TOO_NEAR: Final = {"sphere": 1e-9, "capsule": 1e-5, "cylinder": 1e-5, "box": 1e-5}
"""Where mesh and core are nearer than this [m], their witness points do not tell a direction."""
_UNIT: Final = 1e-6

Vector = NDArray[np.float64]


class Witness:
    """Turns what was measured into points and a normal, as of the scene's last computation."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def of(self, measured: Measured) -> tuple[Vector, Vector, Vector]:
        """Return point on link, point on obstacle and normal (obstacle to link), each (3,), base frame."""
        slot = self._scene.slot(measured.obstacle)
        if not measured.by_mesh:
            link_point, obstacle_point = measured.link_point, measured.obstacle_point
            if not (_finite(link_point) and _finite(obstacle_point)):
                link_point, obstacle_point = self._link_centre(measured), slot.placement.translation.copy()
            return link_point, obstacle_point, self._hull_normal(measured, slot)
        mesh_point, core_point = measured.link_point, measured.obstacle_point
        delta = mesh_point - core_point
        length = math.sqrt(delta @ delta)
        far = length > _TOO_NEAR[slot.shape]
        normal = delta / length if far else self._hull_normal(measured, slot)
        return mesh_point, core_point + slot.radius * normal, normal

    def of_hulls(self, pieces: list[int], obstacles: list[int]) -> tuple[Vector, Vector, Vector]:
        """Return the same for k pairs of hull pieces and obstacles, (k, 3) each, of the last computation."""
        scene = self._scene
        results = [scene.results[j * scene.piece_count + i] for i, j in zip(pieces, obstacles, strict=True)]
        return self.sound(pieces, obstacles, [coal_vectors(result) for result in results])

    def sound(
        self, pieces: list[int], obstacles: list[int], found: list[tuple[Vector, Vector, Vector]]
    ) -> tuple[Vector, Vector, Vector]:
        """Return what Coal said of k pairs, (k, 3) each, with stand-ins for what is no point or direction.

        Args:
            pieces: Of the links.
            obstacles: Their indices.
            found: Of each pair, ``coal_vectors``.
        """
        scene, vectors = self._scene, np.array(found).reshape(-1, 3, 3)
        on_link, on_obstacle, normal = vectors[:, 0], vectors[:, 1], -vectors[:, 2]
        finite = np.isfinite(on_link).all(axis=1) & np.isfinite(on_obstacle).all(axis=1)
        lengths = np.sqrt((normal * normal).sum(axis=1))
        for row in (~(finite & (np.abs(lengths - 1.0) < _UNIT))).nonzero()[0].tolist():
            centre, position = scene.centre_of(pieces[row]), scene.slot(obstacles[row]).placement.translation
            if not finite[row]:
                on_link[row], on_obstacle[row] = centre, position
            if not abs(lengths[row] - 1.0) < _UNIT:
                normal[row] = _direction(centre - position)
        return on_link, on_obstacle, normal

    def _hull_normal(self, measured: Measured, slot: Slot) -> Vector:
        """Return Coal's normal, turned to point from obstacle to link, or the nearest thing to it."""
        normal = measured.normal
        if normal is None:  # not the slot's results: a search for the nearest pair does not compute them
            normal = self._scene.hull_normal(measured.obstacle, measured.piece)
        normal = -normal  # Coal's points from the first shape, the hull, to the second
        if _finite(normal) and abs(math.sqrt(normal @ normal) - 1.0) < _UNIT:
            return normal
        return _direction(self._link_centre(measured) - slot.placement.translation)

    def _link_centre(self, measured: Measured) -> Vector:
        """Return the middle of the nearest hull piece's box, (3,) in the base frame."""
        part = measured.part
        shape = part.pieces[measured.piece - part.first]
        centre: Vector = self._scene.placement_of(part).act(np.array(shape.aabb_center))
        return centre


def coal_vectors(result: Any) -> tuple[Vector, Vector, Vector]:
    """Return the nearest points of the first and the second shape, and Coal's normal between them, (3,) each.

    The normal is a copy, as Coal rewrites its own; the points are copies by themselves.
    """
    return result.getNearestPoint1(), result.getNearestPoint2(), np.array(result.normal)


def _direction(delta: Vector) -> Vector:
    """Return ``delta`` with unit length, or up where it has none."""
    length = math.sqrt(delta @ delta)
    return delta / length if length > _UNIT else np.array([0.0, 0.0, 1.0])


def _finite(vector: Vector) -> bool:
    return math.isfinite(vector[0] + vector[1] + vector[2])

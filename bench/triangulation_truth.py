"""The truth of the ball scenes: Coal's exact distance of the sensed link, as fast as it goes."""

from __future__ import annotations

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ssm_service.errors import ConfigError
from ssm_service.model import Robot
from ssm_service.model.hulls import triangles

Floats = NDArray[np.float64]


class LinkTruth:
    """Exact distance of balls from one link, in the link's frame.

    Coal measures from the mesh to the ball's centre, less the radius: six times faster than to the ball, and
    as exact. That distance has no inside: a centre inside the link's convex hull counts as 0 from it.

    Args:
        robot: The robot.
        link: A link whose geometry is meshes.
    """

    def __init__(self, robot: Robot, link: str) -> None:
        self._request, self._result, self._point = (
            coal.DistanceRequest(),
            coal.DistanceResult(),
            coal.Sphere(0.0),
        )
        T_link_joint = robot.model.frames[robot.model.getFrameId(link)].placement.inverse()
        self._meshes = []
        corners = []
        for index in robot.geometry_of_link[link]:
            source = robot.collision.geometryObjects[index]
            if not isinstance(source.geometry, coal.BVHModelBase):
                raise ConfigError(
                    robot.config.path, f"links.{link}", type(source.geometry).__name__, "a mesh"
                )
            T = T_link_joint * source.placement
            self._meshes.append((source.geometry, coal.Transform3s(T.rotation, T.translation)))
            corners.append(triangles(source.geometry)[0] @ T.rotation.T + T.translation)
        points = np.concatenate(corners)
        self._lower, self._upper = points.min(axis=0), points.max(axis=0)
        self._planes = ConvexHull(points).equations

    def balls(self, centres: Floats, radius: float) -> tuple[Floats, Floats]:
        """Return the balls' distances, (n,) [m], and their points nearest to the link, (n, 3) [m].

        Args:
            centres: (n, 3) [m], link frame.
            radius: Of all balls [m].
        """
        to_centre, on_link = np.full(len(centres), np.inf), np.empty((len(centres), 3))
        place, run, result = coal.Transform3s(), coal.distance, self._result
        for mesh, T_link_mesh in self._meshes:
            for i, centre in enumerate(centres):
                place.setTranslation(centre)
                result.clear()
                distance = run(mesh, T_link_mesh, self._point, place, self._request, result)
                if distance < to_centre[i]:
                    to_centre[i] = distance
                    on_link[i] = result.getNearestPoint1()
        to_centre[self._inside(centres)] = 0.0
        away = np.maximum(to_centre, 1e-12)[:, np.newaxis]
        return to_centre - radius, centres + radius * (on_link - centres) / away

    def _inside(self, points: Floats) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = ((points >= self._lower) & (points <= self._upper)).all(axis=1)
        near = points[inside]
        inside[inside] = [bool((self._planes[:, :3] @ p + self._planes[:, 3] <= 0.0).all()) for p in near]
        return inside

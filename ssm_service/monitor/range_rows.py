"""What the rings see, and what they cannot rule out, as pairs of link and obstacle."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..config import SeparationConfig
from ..model import (
    Kinematics,
    Robot,
    SensorArray,
    closing_gradients,
    moved_by,
    outermost_points,
    point_jacobians,
)
from .decision import Nearest
from .ranges import RangeReading, ball_as_nearest, link_pose

Array = NDArray[np.float64]


class RangeRows(Struct, frozen=True, kw_only=True, eq=False):
    """The r pairs of one scan, the directed ones first; vectors in the base frame.

    Attributes:
        link: (r,) indices into ``Robot.sensor_arrays``.
        distance: (r,) [m].
        point_on_link: (r, 3) [m].
        point_on_obstacle: (r, 3) [m].
        normal: (r, 3) unit, from the obstacle to the link; of undirected pairs only one of many.
        uncertainty: (r,) Z_d [m].
        gradients: (d, n) [m/rad] of the directed pairs.
        jacobians: (u, c, 3, n) [m/rad] of the outermost points of the undirected pairs' links.
    """

    link: NDArray[np.intp]
    distance: Array
    point_on_link: Array
    point_on_obstacle: Array
    normal: Array
    uncertainty: Array
    gradients: Array
    jacobians: Array


class RangeRowMaker:
    """Turns readings into pairs.

    With the estimator ``nearest`` each echo is an obstacle at its reading, in the direction of its sensor;
    where nobody else looks, silence is an obstacle of any direction, as near as something could be unseen: at
    the least ``range_max_m`` of its link's sensors, or nearer where the blind angles are known and
    ``uncovered`` says that they count. With ``lower_bound`` there is one obstacle of any direction for each
    link, at its bound; beside a tracker only where one of the link's sensors has an echo.

    Args:
        robot: The robot.
        config: The profile's separation.
        estimator: The profile's.
    """

    def __init__(self, robot: Robot, config: SeparationConfig, estimator: str) -> None:
        self._arrays = robot.sensor_arrays
        self._directed = estimator == "nearest"
        of_sensor = {int(i): k for k, array in enumerate(self._arrays) for i in array.indices}
        self._array_of_sensor = np.array([of_sensor[i] for i in range(robot.sensor_count)], dtype=np.intp)
        self._accuracy = np.maximum(
            config.human_uncertainty_m, [ring.accuracy for ring in robot.ring_of_sensor]
        )
        self._moved = np.array([moved_by(robot, array.link) for array in self._arrays])
        points = [outermost_points(robot, array.link) for array in self._arrays]
        most = max((len(row) for row in points), default=0)
        # All links with the same number of points, so that they go into one array.
        self._points = [np.concatenate([row, np.repeat(row[:1], most - len(row), axis=0)]) for row in points]

    def rows(self, reading: RangeReading, kinematics: Kinematics, *, tracked: bool) -> RangeRows | None:
        """Return the pairs of a scan; ``None`` where there are none.

        Args:
            reading: The scan.
            kinematics: The frames now.
            tracked: Whether another source looks everywhere now.
        """
        directed = np.isfinite(reading.ranges).nonzero()[0] if self._directed else np.empty(0, dtype=np.intp)
        others = (self._silent if self._directed else self._bounded)(reading, kinematics, tracked)
        if not (len(directed) or others):
            return None
        T_base_sensor = kinematics.transform_sensors_to_base[directed]
        direction, origin = T_base_sensor[:, :3, 0], T_base_sensor[:, :3, 3]
        distance = reading.ranges[directed]
        link = self._array_of_sensor[directed]
        arrays = [k for k, _ in others]
        nearest = [thing for _, thing in others]
        joints = kinematics.spatial_jacobian.shape[1]
        jacobians = [self._jacobians(k, kinematics) for k in arrays] or np.empty((0, 1, 3, joints))
        return RangeRows(
            link=np.concatenate([link, np.array(arrays, dtype=np.intp)]),
            distance=np.concatenate([distance, [thing.distance for thing in nearest]]),
            point_on_link=_stacked(origin, [thing.point_on_link for thing in nearest]),
            point_on_obstacle=_stacked(
                origin + distance[:, np.newaxis] * direction, [thing.point_on_obstacle for thing in nearest]
            ),
            normal=_stacked(-direction, [thing.normal for thing in nearest]),
            uncertainty=np.concatenate(
                [self._accuracy[directed], [self._accuracy[self._arrays[k].indices].max() for k in arrays]]
            ),
            gradients=closing_gradients(kinematics.spatial_jacobian, self._moved[link], origin, -direction),
            jacobians=np.array(jacobians),
        )

    def _silent(
        self, reading: RangeReading, kinematics: Kinematics, tracked: bool
    ) -> list[tuple[int, Nearest]]:
        """Return what silence may hide, as if it stood before the sensor that sees least far."""
        if tracked:
            return []
        found = []
        for k, array in enumerate(self._arrays):
            distance = reading.silent.get(array.link)
            if distance is not None:
                place = int(array.ranges_max.argmin())
                T = link_pose(array, kinematics) @ array.transforms_sensor_to_link[place]
                found.append((k, _before(array, T, distance)))
        return found

    def _bounded(
        self, reading: RangeReading, kinematics: Kinematics, tracked: bool
    ) -> list[tuple[int, Nearest]]:
        """Return the balls that attain the links' bounds; what nothing explains is a stop by itself."""
        found = []
        for array, bound, surface in reading.bounds:
            if bound.distance is None or (tracked and math.isinf(reading.least[array.link])):
                continue
            distance = min(bound.distance, float(array.ranges_max.min()))
            found.append(
                (self._arrays.index(array), ball_as_nearest(array, bound, distance, surface, kinematics))
            )
        return found

    def _jacobians(self, index: int, kinematics: Kinematics) -> Array:
        T = link_pose(self._arrays[index], kinematics)
        points = self._points[index] @ T[:3, :3].T + T[:3, 3]
        return point_jacobians(kinematics.spatial_jacobian, self._moved[index], points)


def _before(array: SensorArray, T_base_sensor: Array, distance: float) -> Nearest:
    direction, origin = T_base_sensor[:3, 0], T_base_sensor[:3, 3]
    return Nearest(
        source="ranges",
        link=array.link,
        obstacle=None,
        distance=distance,
        point_on_link=origin,
        point_on_obstacle=origin + distance * direction,
        normal=-direction,
    )


def _stacked(rows: Array, more: list[Array]) -> Array:
    stacked: Array = np.concatenate([rows, np.array(more).reshape(-1, 3)])
    return stacked

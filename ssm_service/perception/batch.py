"""The ideal readings of many scenes at once, for sweeps: compiled, one obstacle or a few each."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..model import Obstacle, SensorArray
from .batch_kernels import read_boxes, read_capsules, read_spheres
from .reading import cone_reading


class ArrayScan:
    """What the sensors of one link read of obstacles given in the link's frame.

    The same readings as ``scan``'s, clamped in the same way: ``inf`` beyond a sensor's greatest range, and
    from nearer than its least range that one. Balls and boxes are exact to rounding, capsules to 1e-9 m.

    Args:
        array: The sensors.
    """

    def __init__(self, array: SensorArray) -> None:
        self._array = array
        self._apexes = np.ascontiguousarray(array.transforms_sensor_to_link[:, :3, 3])
        self._looks = np.ascontiguousarray(array.transforms_sensor_to_link[:, :3, 0])
        self._cos, self._sin = np.cos(array.half_angles), np.sin(array.half_angles)

    def spheres(self, centres: ArrayLike, radii: ArrayLike) -> NDArray[np.float64]:
        """Return the readings of N scenes of one ball each, (N, k) [m].

        Args:
            centres: (N, 3) [m], link frame.
            radii: (N,) or one for all [m].

        Raises:
            InputError: ``wrong_length``, ``not_finite`` or ``out_of_range``.
        """
        at = _points("centres", centres)
        return self._read(read_spheres, len(at), at, _sizes("radii", radii, (len(at),)))

    def capsules(self, starts: ArrayLike, ends: ArrayLike, radii: ArrayLike) -> NDArray[np.float64]:
        """Return the readings of N scenes of one capsule each, (N, k) [m].

        Args:
            starts: (N, 3) centres of one cap [m], link frame.
            ends: (N, 3) centres of the other.
            radii: (N,) or one for all [m].

        Raises:
            InputError: As above.
        """
        start, end = _points("starts", starts), _points("ends", ends)
        if start.shape != end.shape:
            raise InputError("wrong_length", "ends", end.shape, f"as many as starts: {start.shape}")
        return self._read(read_capsules, len(start), start, end, _sizes("radii", radii, (len(start),)))

    def boxes(self, centres: ArrayLike, rotations: ArrayLike, sizes: ArrayLike) -> NDArray[np.float64]:
        """Return the readings of N scenes of one box each, (N, k) [m].

        Args:
            centres: (N, 3) [m], link frame.
            rotations: (N, 3, 3), box frame to link frame.
            sizes: (N, 3) or (3,) full edges [m].

        Raises:
            InputError: As above.
        """
        at = _points("centres", centres)
        turns = np.ascontiguousarray(rotations, dtype=np.float64)
        if turns.shape != (len(at), 3, 3):
            raise InputError("wrong_length", "rotations", turns.shape, f"({len(at)}, 3, 3)")
        if not np.isfinite(turns).all():
            raise InputError("not_finite", "rotations", "a value that is not", "finite numbers")
        return self._read(read_boxes, len(at), at, turns, 0.5 * _sizes("sizes", sizes, (len(at), 3)))

    def scan(
        self, obstacles: Sequence[Obstacle], transform_link_to_base: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the least readings of one scene of any obstacles, (k,) [m].

        Args:
            obstacles: In the base frame; none gives no echo.
            transform_link_to_base: (4, 4) [m].

        Raises:
            InputError: As above.
            SsmError: A cylinder's reading was not solved (see ``cone_program.least_distance``).
        """
        T = transform_link_to_base
        least = np.full(len(self._apexes), math.inf)
        rounds = [obstacle for obstacle in obstacles if obstacle.shape in ("sphere", "capsule")]
        if rounds:
            at = (np.array([obstacle.position for obstacle in rounds]) - T[:3, 3]) @ T[:3, :3]
            half = [0.5 * obstacle.size[1] if obstacle.shape == "capsule" else 0.0 for obstacle in rounds]
            reach = np.array(half)[:, None] * (np.array([obstacle.axis for obstacle in rounds]) @ T[:3, :3])
            radii = [obstacle.size[0] for obstacle in rounds]
            least = self.capsules(at - reach, at + reach, radii).min(axis=0)
        for obstacle in obstacles:
            if obstacle.shape == "box":
                at = (np.array(obstacle.position) - T[:3, 3]) @ T[:3, :3]
                turn = T[:3, :3].T @ obstacle.rotation()
                least = np.minimum(least, self.boxes(at[None], turn[None], obstacle.size)[0])
            elif obstacle.shape == "cylinder":
                least = np.minimum(least, self._cylinder(obstacle, T))
        return least

    def _cylinder(
        self, obstacle: Obstacle, transform_link_to_base: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        array = self._array
        poses = transform_link_to_base @ array.transforms_sensor_to_link
        return np.array(
            [
                cone_reading(obstacle, pose, float(half_angle), float(range_max), float(range_min))
                for pose, half_angle, range_max, range_min in zip(
                    poses, array.half_angles, array.ranges_max, array.ranges_min, strict=True
                )
            ]
        )

    def _read(self, kernel: object, count: int, *shapes: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.empty((count, len(self._apexes)))
        kernel(*shapes, self._apexes, self._looks, self._cos, self._sin, out)  # type: ignore[operator]
        out[out > self._array.ranges_max] = math.inf
        raised: NDArray[np.float64] = np.maximum(out, self._array.ranges_min)
        return raised


def _points(where: str, values: ArrayLike) -> NDArray[np.float64]:
    points = np.ascontiguousarray(values, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError("wrong_length", where, points.shape, "(N, 3)")
    if not np.isfinite(points).all():
        raise InputError("not_finite", where, "a value that is not", "finite numbers")
    return points


def _sizes(where: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    given = np.asarray(values, dtype=np.float64)
    try:
        sizes = np.ascontiguousarray(np.broadcast_to(given, shape))
    except ValueError as error:
        raise InputError("wrong_length", where, given.shape, f"{shape}, or one for all") from error
    if not ((sizes > 0.0) & (sizes < math.inf)).all():
        raise InputError("out_of_range", where, "a size that is not", "above 0 and finite")
    return sizes

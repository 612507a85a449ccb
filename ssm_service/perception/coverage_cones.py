"""What sensors see of balls: the distance of a ball's centre from the cones, each cut at its range."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model import SensorArray

Array = NDArray[np.float64]

_FACE_M: Final = 1e-9
"""What is left of a cone whose sensor is blocked: its face."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cones:
    """Cones of sensors, cut where a silence is no longer certain: spherical sectors, which are convex.

    A ball is seen by a sensor if and only if the distance of its centre from the sensor's sector is at most
    its radius. That distance never changes by more than the centre moves.

    Attributes:
        apexes: (k, 3) the sensors' faces [m], link frame.
        axes: (k, 3) unit sensing directions, link frame.
        half_angles: (k,) [rad], in (0, π/2).
        reaches: (k,) [m]; range less the greatest reading error.
    """

    apexes: Array
    axes: Array
    half_angles: Array
    reaches: Array

    def __post_init__(self) -> None:
        if not (np.all(self.half_angles > 0.0) and np.all(self.half_angles < math.pi / 2.0)):
            raise InputError("out_of_range", "half_angles", self.half_angles, "above 0 and below π/2 rad")
        if not np.all(self.reaches > 0.0):
            raise InputError("out_of_range", "reaches", self.reaches, "ranges above the reading error")
        for array in (self.apexes, self.axes, self.half_angles, self.reaches):
            array.flags.writeable = False

    @classmethod
    def of_array(cls, array: SensorArray, reading_error: float = 0.0) -> Cones:
        """Take the sensors of one link.

        Args:
            array: The sensors.
            reading_error: Greatest error of a reading [m]: an echo from nearer than the range less this is
                certain to be reported.

        Raises:
            InputError: ``out_of_range``: the error is not below every range.
        """
        T_link_sensors = array.transforms_sensor_to_link
        return cls(
            apexes=np.ascontiguousarray(T_link_sensors[:, :3, 3]),
            axes=np.ascontiguousarray(T_link_sensors[:, :3, 0]),
            half_angles=array.half_angles.copy(),
            reaches=array.ranges_max - reading_error,
        )

    def cut(self, reaches: Array) -> Cones:
        """Return the cones, each cut at its reach, (k,) [m], where that is nearer; at 0 a face is left."""
        nearer = np.minimum(self.reaches, np.maximum(reaches, _FACE_M))
        return Cones(apexes=self.apexes, axes=self.axes, half_angles=self.half_angles, reaches=nearer)

    @property
    def count(self) -> int:
        """Number of sensors."""
        return len(self.half_angles)

    def least_distances(self, centres: Array) -> Array:
        """Return the distance of each centre, (n, 3) [m], from the nearest sector, (n,) [m]."""
        from .coverage_loops import least

        distances: Array = least(np.ascontiguousarray(centres), *self._numbers())
        return distances

    def counts(self, centres: Array, radii: Array) -> NDArray[np.int64]:
        """Return how many sensors see balls of several radii at each centre, (r, n).

        Args:
            centres: (n, 3) [m].
            radii: (r,) [m]; if negative, none does.
        """
        from .coverage_loops import counts

        found: NDArray[np.int64] = counts(np.ascontiguousarray(centres), radii, *self._numbers())
        return found

    def without(self, sensor: int) -> Cones:
        """Return the cones of all sensors but one."""
        left = np.delete(np.arange(self.count), sensor)
        return Cones(
            apexes=self.apexes[left],
            axes=self.axes[left],
            half_angles=self.half_angles[left],
            reaches=self.reaches[left],
        )

    def _numbers(self) -> tuple[Array, Array, Array, Array, Array]:
        return self.apexes, self.axes, np.cos(self.half_angles), np.sin(self.half_angles), self.reaches

"""Where everything is at one joint position, and how it moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .rings import Ring


class Kinematics:
    """Poses and Jacobian at one joint position; all arrays are the caller's own.

    The sensors' poses are worked out when they are first asked for: a tick mostly needs one of them.

    Attributes:
        transform_end_effector_to_base: (4, 4) [m].
        jacobian_full: (6, n) of the end effector's frame: its linear rows [m/rad] over its angular rows,
            in the axes of the base frame, one column per joint of the messages.
        jacobian: (3, k) linear rows of the free joints, the reduced Jacobian.
        spatial_jacobian: (6, n) of the point of the moving body that is now in the base frame's origin:
            a column for each joint as if it moved the body in question.
    """

    __slots__ = (
        "_T_base_parents",
        "_T_base_rings",
        "_T_base_sensors",
        "_rings",
        "jacobian",
        "jacobian_full",
        "spatial_jacobian",
        "transform_end_effector_to_base",
    )

    def __init__(
        self,
        *,
        transform_end_effector_to_base: NDArray[np.float64],
        jacobian_full: NDArray[np.float64],
        jacobian: NDArray[np.float64],
        spatial_jacobian: NDArray[np.float64],
        rings: Sequence[Ring],
        transforms_parent_to_base: Sequence[NDArray[np.float64]],
    ) -> None:
        self.transform_end_effector_to_base = transform_end_effector_to_base
        self.jacobian_full = jacobian_full
        self.jacobian = jacobian
        self.spatial_jacobian = spatial_jacobian
        self._rings = rings
        self._T_base_parents = transforms_parent_to_base
        self._T_base_rings: NDArray[np.float64] | None = None
        self._T_base_sensors: NDArray[np.float64] | None = None

    @property
    def transform_rings_to_base(self) -> NDArray[np.float64]:
        """(r, 4, 4) [m]."""
        if self._T_base_rings is None:
            self._T_base_rings = np.empty((len(self._rings), 4, 4))
            for T, T_base_parent, ring in zip(
                self._T_base_rings, self._T_base_parents, self._rings, strict=True
            ):
                np.matmul(T_base_parent, ring.transform_ring_to_parent, out=T)
        return self._T_base_rings

    @property
    def transform_sensors_to_base(self) -> NDArray[np.float64]:
        """(m, 4, 4) [m], the sensors of all rings in the order of the readings."""
        if self._T_base_sensors is None:
            parts = [
                T_base_ring @ ring.transform_sensors_to_ring
                for T_base_ring, ring in zip(self.transform_rings_to_base, self._rings, strict=True)
            ]
            self._T_base_sensors = np.concatenate(parts) if parts else np.empty((0, 4, 4))
        return self._T_base_sensors

    def transform_sensor_to_base(self, index: int) -> NDArray[np.float64]:
        """Return one sensor's (4, 4) [m]; ``index`` counts from 0 in the order of the readings."""
        first = 0
        for T_base_parent, ring in zip(self._T_base_parents, self._rings, strict=True):
            if index < first + ring.count:
                T_base_ring = T_base_parent @ ring.transform_ring_to_parent
                T_base_sensor: NDArray[np.float64] = (
                    T_base_ring @ ring.transform_sensors_to_ring[index - first]
                )
                return T_base_sensor
            first += ring.count
        raise IndexError(f"sensor {index} of {first}")

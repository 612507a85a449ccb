"""All estimators on many scans of one ring, in the frame of its link."""

from __future__ import annotations

import numpy as np

from ssm_service.model import Robot, SensorArray
from ssm_service.perception.estimators_batch import estimate_many

from .triangulation_scenes import Floats

TRIANGULATED = ("as_printed", "corrected", "nearest")
ESTIMATORS = TRIANGULATED


class Estimators:
    """The estimators of one sensor array.

    Args:
        robot: The robot.
        array: Its sensors; those of the array's first ring are read.
    """

    def __init__(self, robot: Robot, array: SensorArray) -> None:
        ring = array.rings[0]
        T_link_sensor = array.transforms_sensor_to_link[0]
        self.transform_ring_to_link: Floats = T_link_sensor @ np.linalg.inv(ring.transform_sensors_to_ring[0])
        self._ring = ring

    def of(
        self, readings: Floats, noise: str, names: tuple[str, ...]
    ) -> dict[str, tuple[Floats, Floats | None]]:
        """Return distances, (n,) [m], and bearings, (n,) [rad], by estimator; NaN where it says nothing.

        Args:
            readings: (n, sensors) [m], ``inf`` for no echo.
            noise: How they err: it decides what ``lower_bound`` takes for granted.
            names: Which are wanted.
        """
        found: dict[str, tuple[Floats, Floats | None]] = {}
        if set(names) & set(TRIANGULATED):
            for name, many in estimate_many(self._ring, readings, self.transform_ring_to_link).items():
                found[name] = many.distances, None if name == "as_printed" else many.bearings
        return {name: found[name] for name in names}

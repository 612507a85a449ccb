"""All estimators on many scans of one ring, in the frame of its link."""

from __future__ import annotations

import msgspec
import numpy as np

from ssm_service.errors import ConfigError
from ssm_service.model import Robot, SensorArray
from ssm_service.model.link_distance import LinkDistance
from ssm_service.perception.bound import LowerBound
from ssm_service.perception.estimators_batch import estimate_many
from ssm_service.perception.fit import SphereFit

from .triangulation_noise import greatest_error
from .triangulation_scenes import Floats

TRIANGULATED = ("as_printed", "corrected", "nearest")
TIGHT = "lower_bound_tight"
"""The bound for readings that are known to err as little as the noise of the row."""
BOUNDS = ("lower_bound", TIGHT)
ESTIMATORS = (*TRIANGULATED, "sphere_fit", *BOUNDS)
_ROUNDING_M = 1e-9


class Estimators:
    """The estimators of one sensor array, each made when it is first asked for.

    Args:
        robot: The robot.
        array: Its sensors, all of one ring.

    Raises:
        ConfigError: The array has more than one ring, or the robot file no assumptions.
    """

    def __init__(self, robot: Robot, array: SensorArray) -> None:
        path, assumptions = robot.config.path, robot.config.file.assumptions
        if len(array.rings) != 1:
            raise ConfigError(path, "rings", f"{len(array.rings)} on {array.link}", "one ring")
        if assumptions is None:
            raise ConfigError(path, "assumptions", "nothing", "what sphere_fit and lower_bound assume")
        ring = array.rings[0]
        T_link_sensor = array.transforms_sensor_to_link[0]
        self.transform_ring_to_link: Floats = T_link_sensor @ np.linalg.inv(ring.transform_sensors_to_ring[0])
        self._ring, self._array, self._assumptions = ring, array, assumptions
        self._distance = LinkDistance(robot, array.link)
        self._fit: SphereFit | None = None
        self._bounds: dict[float, LowerBound] = {}

    def of(
        self, readings: Floats, noise: str, names: tuple[str, ...]
    ) -> dict[str, tuple[Floats, Floats | None]]:
        """Return distances, (n,) [m], and bearings, (n,) [rad], by estimator; NaN where it says nothing.

        Args:
            readings: (n, sensors) [m], ``inf`` for no echo.
            noise: How they err: it decides what ``TIGHT`` takes for granted.
            names: Which are wanted.
        """
        found: dict[str, tuple[Floats, Floats | None]] = {}
        if set(names) & set(TRIANGULATED):
            for name, many in estimate_many(self._ring, readings, self.transform_ring_to_link).items():
                found[name] = many.distances, None if name == "as_printed" else many.bearings
        if "sphere_fit" in names:
            found["sphere_fit"] = self._fitted(readings)
        declared = self._assumptions.reading_error_m
        if "lower_bound" in names:
            found["lower_bound"] = self._bound(declared).of_many(readings), None
        if TIGHT in names:
            error = min(declared, greatest_error(noise, self._ring.accuracy) + _ROUNDING_M)
            found[TIGHT] = self._bound(error).of_many(readings), None
        return {name: found[name] for name in names}

    def _fitted(self, readings: Floats) -> tuple[Floats, Floats]:
        if self._fit is None:
            self._fit = SphereFit(self._array, self._distance, self._assumptions)
        distances, positions = self._fit.of_many(readings)
        T = self.transform_ring_to_link
        in_ring = (positions - T[:3, 3]) @ T[:3, :3]
        return distances, np.arctan2(in_ring[:, 1], in_ring[:, 0])

    def _bound(self, error: float) -> LowerBound:
        if error not in self._bounds:
            assumptions = msgspec.structs.replace(self._assumptions, reading_error_m=error)
            self._bounds[error] = LowerBound(self._array, self._distance, assumptions)
        return self._bounds[error]

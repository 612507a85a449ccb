"""All estimators side by side, for whoever asks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..model import Kinematics, LinkDistance, Robot, SensorArray
from ..perception import Estimate, LowerBound, RingEstimates, SphereFit, estimate
from ..perception.estimators import NO_ASSUMPTIONS, NO_BALL, NO_ECHO
from .ranges import answering_arrays, link_pose, towards_link


class _Solvers(Struct, frozen=True, kw_only=True, eq=False):
    """The estimators that look at all sensors of a link at once."""

    surface: LinkDistance
    fit: SphereFit
    bound: LowerBound
    transform_link_to_ring: NDArray[np.float64]


class Estimators:
    """The estimators of a robot's rings. Building it takes some seconds where there are assumptions.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._solvers: dict[str, _Solvers] = {}
        self._arrays = {array.link: array for array in robot.sensor_arrays}
        self._ring_of_sensor = [i for i, ring in enumerate(robot.rings) for _ in range(ring.count)]
        assumptions = robot.config.file.assumptions
        if assumptions is not None:
            for array in answering_arrays(robot):
                surface = LinkDistance(robot, array.link)
                T_ring_sensor = array.rings[0].transform_sensors_to_ring[0]
                self._solvers[array.link] = _Solvers(
                    transform_link_to_ring=T_ring_sensor @ array.transform_link_to_first_sensor,
                    surface=surface,
                    fit=SphereFit(array, surface, assumptions),
                    bound=LowerBound(array, surface, assumptions),
                )

    def bound(self, link: str) -> LowerBound | None:
        """Return the bound of a link's sensors, None where nothing is assumed or no ring answers for it."""
        solvers = self._solvers.get(link)
        return None if solvers is None else solvers.bound

    def fill(self) -> None:
        """Make the bounds' tables of single echoes, where they are worth one; half a minute at first."""
        for solvers in self._solvers.values():
            solvers.bound.fill()

    def of(self, ranges: NDArray[np.float64], kinematics: Kinematics) -> RingEstimates:
        """Return what one scan says of the link that is nearest to something.

        The paper's estimators take the ring with the least reading, the others all rings on its link.

        Args:
            ranges: (m,), [m], ``inf`` for no echo.
            kinematics: The frames now.
        """
        robot = self._robot
        index = self._ring_of_sensor[int(ranges.argmin())]
        part = robot.ring_slices[index]
        by_ring = estimate(
            robot.rings[index],
            ranges[part],
            kinematics.transform_rings_to_base[index],
            first_sensor=part.start + 1,
        )
        link = robot.link_of_sensor[part.start]
        array = self._arrays[link]
        solvers = self._solvers.get(link)
        if solvers is None:
            reasons = {"sphere_fit": NO_ASSUMPTIONS, "lower_bound": NO_ASSUMPTIONS}
            return replace(by_ring, reasons={**by_ring.reasons, **reasons})
        return self._with_solvers(by_ring, ranges[array.indices], array, solvers, kinematics)

    def _with_solvers(
        self,
        by_ring: RingEstimates,
        readings: NDArray[np.float64],
        array: SensorArray,
        solvers: _Solvers,
        kinematics: Kinematics,
    ) -> RingEstimates:
        T_base_link = link_pose(array, kinematics)
        reasons = dict(by_ring.reasons)
        fit, bound = (
            _fit(solvers, readings, array, T_base_link),
            _bound(solvers, readings, array, T_base_link),
        )
        if fit is None:
            reasons["sphere_fit"] = NO_ECHO
        if bound is None:
            reasons["lower_bound"] = NO_BALL
        return replace(by_ring, sphere_fit=fit, lower_bound=bound, reasons=reasons)


def _fit(
    solvers: _Solvers, readings: NDArray[np.float64], array: SensorArray, T_base_link: NDArray[np.float64]
) -> Estimate | None:
    found = solvers.fit.of(readings)
    if found is None:
        return None
    return Estimate(
        distance=found.distance,
        position=_in_base(T_base_link, found.position),
        bearing=found.bearing,
        sensors=_numbers(array, found.sensors),
        std=found.distance_std,
    )


def _bound(
    solvers: _Solvers, readings: NDArray[np.float64], array: SensorArray, T_base_link: NDArray[np.float64]
) -> Estimate | None:
    found = solvers.bound.of(readings)
    if found.distance is None:
        return None
    if found.centre is None or found.radius is None:
        return Estimate(distance=found.distance, position=None, bearing=None, sensors=())
    on_ball = found.centre + found.radius * towards_link(solvers.surface, found.centre)
    return Estimate(
        distance=found.distance,
        position=_in_base(T_base_link, on_ball),
        bearing=_bearing(solvers.transform_link_to_ring, found.centre),
        sensors=_numbers(array, np.flatnonzero(np.isfinite(readings)).tolist()),
    )


def _bearing(T_ring_link: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Return the bearing of ``point`` (3,), link frame, about the first ring's axis from its sensor 1."""
    x, y, _ = (T_ring_link[:3, :3] @ point + T_ring_link[:3, 3]).tolist()
    return math.atan2(y, x)


def _numbers(array: SensorArray, places: tuple[int, ...] | list[int]) -> tuple[int, ...]:
    """Return sensors' numbers over all rings, from 1."""
    return tuple(int(array.indices[place]) + 1 for place in places)


def _in_base(T_base_link: NDArray[np.float64], point: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (T_base_link[:3, :3] @ point + T_base_link[:3, 3]).tolist()
    return x, y, z

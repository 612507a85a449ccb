"""Sensor rings: where the range sensors sit, and what the device can do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import RingConfig, SimulatedSensorConfig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ring:
    """Range sensors round a link, evenly spaced, looking outwards ([Kang2022] eqs 3–4, Fig. 6).

    The ring's frame has its origin in the ring's centre, z along its axis and x through sensor 1. A
    sensor's frame has x along its sensing direction, which ``tilt`` raises from the ring's plane towards
    its axis, and y along the ring; without tilt its z is the ring's axis.

    Attributes:
        name: Name of the ring.
        parent_frame: Frame of the robot that carries it.
        transform_ring_to_parent: (4, 4) [m].
        transform_sensors_to_ring: (count, 4, 4) [m], read-only, like the above.
        count: Number of sensors.
        radius: Distance of the sensors from the axis [m].
        tilt: Elevation of the sensing directions out of the ring's plane [rad].
        half_angle: Half of a sensor's field of view [rad].
        range_min: Least distance that the device resolves [m].
        range_max: Greatest distance that the device reports [m].
        period: Time of one scan [s].
        accuracy: Greatest error of a reading [m].
        simulated: Errors of the simulated sensors.
    """

    name: str
    parent_frame: str
    transform_ring_to_parent: NDArray[np.float64]
    transform_sensors_to_ring: NDArray[np.float64]
    count: int
    radius: float
    tilt: float
    half_angle: float
    range_min: float
    range_max: float
    period: float
    accuracy: float
    simulated: SimulatedSensorConfig

    @classmethod
    def from_config(cls, config: RingConfig) -> Ring:
        """Build the ring that a robot file describes (checked there: the axes are sound)."""
        return cls(
            name=config.name,
            parent_frame=config.parent_frame,
            transform_ring_to_parent=_ring_to_parent(config),
            transform_sensors_to_ring=_sensors_to_ring(
                config.count, config.radius_m, math.radians(config.tilt_deg)
            ),
            count=config.count,
            radius=config.radius_m,
            tilt=math.radians(config.tilt_deg),
            half_angle=math.radians(config.field_of_view_deg) / 2.0,
            range_min=config.range_min_m,
            range_max=config.range_max_m,
            period=config.period_s,
            accuracy=config.accuracy_m,
            simulated=config.simulated,
        )


def _ring_to_parent(config: RingConfig) -> NDArray[np.float64]:
    z = np.array(config.axis) / math.hypot(*config.axis)
    x = np.array(config.first_direction)
    x -= (x @ z) * z  # the file may be off a right angle by 1e-6
    x /= np.linalg.norm(x)
    T_parent_ring = np.eye(4)
    T_parent_ring[:3, 0], T_parent_ring[:3, 1], T_parent_ring[:3, 2] = x, np.cross(z, x), z
    T_parent_ring[:3, 3] = config.origin_m
    T_parent_ring.flags.writeable = False
    return T_parent_ring


def _sensors_to_ring(count: int, radius: float, tilt: float) -> NDArray[np.float64]:
    """Return rotz(2π/count·(i − 1))·translate(radius, 0, 0)·roty(−tilt) for i = 1..count, (count, 4, 4)."""
    angles = 2.0 * math.pi / count * np.arange(count)
    cos, sin = np.cos(angles), np.sin(angles)
    rise, run = math.sin(tilt), math.cos(tilt)
    T_ring_sensors = np.tile(np.eye(4), (count, 1, 1))
    T_ring_sensors[:, 0, 0], T_ring_sensors[:, 0, 1], T_ring_sensors[:, 0, 2] = cos * run, -sin, -cos * rise
    T_ring_sensors[:, 1, 0], T_ring_sensors[:, 1, 1], T_ring_sensors[:, 1, 2] = sin * run, cos, -sin * rise
    T_ring_sensors[:, 2, 0], T_ring_sensors[:, 2, 2] = rise, run
    T_ring_sensors[:, 0, 3], T_ring_sensors[:, 1, 3] = radius * cos, radius * sin
    T_ring_sensors.flags.writeable = False
    return T_ring_sensors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorArray:
    """All sensors that one link carries, of one or several rings: a rigid body that looks outwards.

    Attributes:
        link: The link that carries them, and that they answer for.
        rings: Its rings, in the order of the robot file.
        indices: (k,) places of its sensors in the readings of all rings.
        transforms_sensor_to_link: (k, 4, 4) [m], read-only, like all arrays here.
        transform_link_to_first_sensor: (4, 4) [m], the inverse of the first of them.
        half_angles: (k,) [rad].
        ranges_min: (k,) [m].
        ranges_max: (k,) [m].
    """

    link: str
    rings: tuple[Ring, ...]
    indices: NDArray[np.intp]
    transforms_sensor_to_link: NDArray[np.float64]
    transform_link_to_first_sensor: NDArray[np.float64]
    half_angles: NDArray[np.float64]
    ranges_min: NDArray[np.float64]
    ranges_max: NDArray[np.float64]

    @classmethod
    def of_rings(
        cls,
        link: str,
        rings: Sequence[Ring],
        slices: Sequence[slice],
        transforms_parent_to_link: Sequence[NDArray[np.float64]],
    ) -> SensorArray:
        """Gather rings that one link carries.

        Args:
            link: The link's name.
            rings: The rings.
            slices: Each ring's part of the readings.
            transforms_parent_to_link: Each ring's parent frame in the link's frame, (4, 4) [m].
        """
        counts = [ring.count for ring in rings]
        transforms = [
            T_link_parent @ ring.transform_ring_to_parent @ ring.transform_sensors_to_ring
            for ring, T_link_parent in zip(rings, transforms_parent_to_link, strict=True)
        ]
        every = np.concatenate(transforms)
        made = cls(
            link=link,
            rings=tuple(rings),
            indices=np.concatenate([np.arange(part.start, part.stop, dtype=np.intp) for part in slices]),
            transforms_sensor_to_link=every,
            transform_link_to_first_sensor=np.linalg.inv(every[0]),
            half_angles=np.repeat([ring.half_angle for ring in rings], counts),
            ranges_min=np.repeat([ring.range_min for ring in rings], counts),
            ranges_max=np.repeat([ring.range_max for ring in rings], counts),
        )
        for array in (
            made.indices,
            made.transforms_sensor_to_link,
            made.transform_link_to_first_sensor,
            made.half_angles,
            made.ranges_min,
            made.ranges_max,
        ):
            array.flags.writeable = False
        return made

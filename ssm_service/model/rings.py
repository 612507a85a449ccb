"""Sensor rings: where the range sensors sit, and what the device can do."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import RingConfig, SimulatedSensorConfig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ring:
    """Range sensors round a link, evenly spaced, looking outwards ([Kang2022] eqs 3–4, Fig. 6).

    The ring's frame has its origin in the ring's centre, z along its axis and x through sensor 1. A
    sensor's frame has x along its sensing direction and z along the ring's axis.

    Attributes:
        name: Name of the ring.
        parent_frame: Frame of the robot that carries it.
        transform_ring_to_parent: (4, 4) [m].
        transform_sensors_to_ring: (count, 4, 4) [m], read-only, like the above.
        count: Number of sensors.
        radius: Distance of the sensors from the axis [m].
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
            transform_sensors_to_ring=_sensors_to_ring(config.count, config.radius_m),
            count=config.count,
            radius=config.radius_m,
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


def _sensors_to_ring(count: int, radius: float) -> NDArray[np.float64]:
    """Return rotz(2π/count·(i − 1))·translate(radius, 0, 0) for i = 1..count, (count, 4, 4)."""
    angles = 2.0 * math.pi / count * np.arange(count)
    cos, sin = np.cos(angles), np.sin(angles)
    T_ring_sensors = np.tile(np.eye(4), (count, 1, 1))
    T_ring_sensors[:, 0, 0], T_ring_sensors[:, 0, 1], T_ring_sensors[:, 0, 3] = cos, -sin, radius * cos
    T_ring_sensors[:, 1, 0], T_ring_sensors[:, 1, 1], T_ring_sensors[:, 1, 3] = sin, cos, radius * sin
    T_ring_sensors.flags.writeable = False
    return T_ring_sensors

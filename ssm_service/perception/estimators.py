"""Where an obstacle is, by the paper's triangulation and by the least reading ([Kang2022] 5–6).

Estimates are estimates: nothing here is a bound on the true distance (``bound`` is).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model.rings import Ring

NO_ECHO: Final = "no_echo"
ONE_ECHO: Final = "one_echo"
NOT_NEIGHBOURS: Final = "not_neighbours"
NO_TRIANGLE: Final = "no_triangle"
TILTED: Final = "tilted"
NO_ASSUMPTIONS: Final = "no_assumptions"
NO_BALL: Final = "no_ball"


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """One estimate of where the nearest obstacle point is.

    Attributes:
        distance: From the link's surface, a cylinder of the ring's radius [m].
        position: (3,) in the base frame [m], or None where the estimator gives none.
        bearing: About the ring's axis from sensor 1, in (−π, π] [rad], or None.
        sensors: The sensors that it rests on, numbered from 1 over all rings, the least reading first.
        std: Standard deviation of the distance [m], where the estimator knows one.
    """

    distance: float
    position: tuple[float, float, float] | None
    bearing: float | None
    sensors: tuple[int, ...]
    std: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RingEstimates:
    """What one scan says: the first three of one ring, the other two of all rings on its link.

    Attributes:
        as_printed: (5) into (6) literally. The angle of (5) is not that of (6), so the distance is short by
            about the ring's radius (and negative nearer than that); without a direction.
        corrected: (6) with the angle at S1 between the link's centre and the obstacle.
        nearest: The least reading, in the direction in which its sensor looks.
        sphere_fit: The ball of the assumed radius that best explains readings and silences.
        lower_bound: The least distance that any admissible obstacle could have; sound within the
            robot file's ``assumptions``. Its position is that ball's nearest point.
        reasons: For each estimator that is None, why: ``no_echo``; ``one_echo``; ``not_neighbours`` (no
            neighbour of the least reading has an echo); ``no_triangle`` (the two readings and the chord
            close no triangle, or one that puts the obstacle inside the link, or the least reading is 0);
            ``tilted`` (the paper's triangle lies in the ring's plane, these sensors do not look along it);
            ``no_assumptions`` (the robot file makes none); ``no_ball`` (no admissible obstacle explains the
            readings, so the assumptions do not hold).
    """

    as_printed: Estimate | None
    corrected: Estimate | None
    nearest: Estimate | None
    reasons: dict[str, str]
    sphere_fit: Estimate | None = None
    lower_bound: Estimate | None = None


def estimate(
    ring: Ring,
    ranges: NDArray[np.float64],
    transform_ring_to_base: NDArray[np.float64],
    *,
    first_sensor: int = 1,
) -> RingEstimates:
    """Return the estimates of one scan of one ring.

    S1 is the sensor with the least reading, S2 the neighbour of S1 with the lesser echo; of
    equals, the first in the ring's order for S1 and the one after S1 for S2.

    Args:
        ring: The ring that was read.
        ranges: (count,) readings [m], ``inf`` for no echo.
        transform_ring_to_base: (4, 4) [m].
        first_sensor: Number of the ring's first sensor among those of all rings.

    Raises:
        InputError: ``wrong_length``, ``not_finite`` (NaN) or ``out_of_range`` (negative) readings; a pose
            that is not (4, 4) or not finite.
    """
    readings, pose = _checked(ring, ranges, transform_ring_to_base)
    d1 = min(readings)
    if d1 == math.inf:
        return RingEstimates(
            as_printed=None,
            corrected=None,
            nearest=None,
            reasons=dict.fromkeys(("as_printed", "corrected", "nearest"), NO_ECHO),
        )
    first = readings.index(d1)
    nearest = _placed(pose, ring, d1, 2.0 * math.pi / ring.count * first, (first_sensor + first,))
    if ring.tilt != 0.0:
        reasons = {"as_printed": TILTED, "corrected": TILTED}
        return RingEstimates(as_printed=None, corrected=None, nearest=nearest, reasons=reasons)
    step = _side_of_second(readings, first)
    if step == 0:
        reason = ONE_ECHO if sum(reading < math.inf for reading in readings) == 1 else NOT_NEIGHBOURS
        reasons = {"as_printed": reason, "corrected": reason}
        return RingEstimates(as_printed=None, corrected=None, nearest=nearest, reasons=reasons)
    as_printed, corrected = _triangulated(ring, readings, first, step, pose, first_sensor)
    found = {"as_printed": as_printed, "corrected": corrected}
    reasons = {name: NO_TRIANGLE for name, value in found.items() if value is None}
    return RingEstimates(as_printed=as_printed, corrected=corrected, nearest=nearest, reasons=reasons)


def _side_of_second(readings: list[float], first: int) -> int:
    """Return +1 where S2 comes after S1 in the ring, −1 where before, 0 where no neighbour has an echo."""
    count = len(readings)
    if count < 2:
        return 0
    after, before = readings[(first + 1) % count], readings[(first - 1) % count]
    if min(after, before) == math.inf:
        return 0
    return 1 if after <= before else -1


def _triangulated(
    ring: Ring, readings: list[float], first: int, step: int, pose: NDArray[np.float64], first_sensor: int
) -> tuple[Estimate | None, Estimate | None]:
    """Return ``as_printed`` and ``corrected`` from S1 and the neighbour ``step`` places on."""
    second = (first + step) % ring.count
    sensors = (first_sensor + first, first_sensor + second)
    r, d1, d2 = ring.radius, readings[first], readings[second]
    chord = 2.0 * r * math.sin(math.pi / ring.count)  # r·√(2 − √2) for eight sensors
    # [Kang2022] (5): the angle at S1 between S2 and the obstacle.
    above, below = d1 * d1 + chord * chord - d2 * d2, 2.0 * d1 * chord
    if below == 0.0 or not abs(above) <= below:
        return None, None
    phi = math.acos(above / below)
    # [Kang2022] (6), an angle at S1 between the *centre* and the obstacle, with (5) as it stands.
    printed = math.sqrt(max(0.0, r * r + d1 * d1 - 2.0 * d1 * r * math.cos(phi))) - r
    as_printed = Estimate(distance=printed, position=None, bearing=None, sensors=sensors)
    # The chord and the radius enclose π/2 − π/count at S1: 67.5° for eight sensors.
    theta = phi + math.pi / 2.0 - math.pi / ring.count
    # The obstacle from the centre, along S1's radius and square to it towards S2; its length is (6).
    outward, sideways = r - d1 * math.cos(theta), d1 * math.sin(theta)
    distance = math.hypot(outward, sideways) - r
    if distance < 0.0:
        return as_printed, None
    if ring.count == 2:  # S1, centre and S2 are in line: either side of that line is as good
        return as_printed, Estimate(distance=distance, position=None, bearing=None, sensors=sensors)
    bearing = 2.0 * math.pi / ring.count * first + step * math.atan2(sideways, outward)
    return as_printed, _placed(pose, ring, distance, bearing, sensors)


def _placed(
    pose: NDArray[np.float64], ring: Ring, distance: float, bearing: float, sensors: tuple[int, ...]
) -> Estimate:
    """Return the estimate ``distance`` from the sensors' faces at ``bearing``, raised by the ring's tilt."""
    from_axis = ring.radius + distance * math.cos(ring.tilt)
    height = distance * math.sin(ring.tilt)
    in_ring = np.array([from_axis * math.cos(bearing), from_axis * math.sin(bearing), height])
    x, y, z = (pose[:3, :3] @ in_ring + pose[:3, 3]).tolist()
    return Estimate(distance=distance, position=(x, y, z), bearing=_wrapped(bearing), sensors=sensors)


def _wrapped(angle: float) -> float:
    """Return ``angle`` in (−π, π] [rad]."""
    turned = math.remainder(angle, 2.0 * math.pi)
    return math.pi if turned == -math.pi else turned


def _checked(
    ring: Ring, ranges: NDArray[np.float64], transform_ring_to_base: NDArray[np.float64]
) -> tuple[list[float], NDArray[np.float64]]:
    values = np.asarray(ranges, dtype=np.float64)
    if values.shape != (ring.count,):
        raise InputError("wrong_length", "ranges", values.shape, f"{ring.count} readings of ring {ring.name}")
    if np.isnan(values).any():
        raise InputError("not_finite", "ranges", values.tolist(), "numbers, or inf for no echo")
    if (values < 0.0).any():
        raise InputError("out_of_range", "ranges", values.tolist(), "0 or more, or inf for no echo")
    pose = np.asarray(transform_ring_to_base, dtype=np.float64)
    if pose.shape != (4, 4):
        raise InputError("wrong_length", "transform_ring_to_base", pose.shape, "4 × 4")
    if not np.isfinite(pose).all():
        raise InputError("not_finite", "transform_ring_to_base", pose.tolist(), "finite numbers")
    return values.tolist(), pose

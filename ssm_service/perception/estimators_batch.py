"""Many scans at once: what ``estimators.estimate`` says of each, for sweeps ([Kang2022] 5–6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model.rings import Ring
from .estimators import NO_ECHO, NO_TRIANGLE, NOT_NEIGHBOURS, ONE_ECHO

REASONS: Final = ("", NO_ECHO, ONE_ECHO, NOT_NEIGHBOURS, NO_TRIANGLE)
"""What the numbers of ``ManyEstimates.reasons`` mean; the first: there is an estimate."""

_NO_ECHO, _ONE_ECHO, _NOT_NEIGHBOURS, _NO_TRIANGLE = range(1, len(REASONS))

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ManyEstimates:
    """What one estimator says of N scans; NaN or 0 where it says nothing.

    Attributes:
        distances: (N,) from the link's surface, a cylinder of the ring's radius [m].
        bearings: (N,) about the ring's axis from sensor 1, in (−π, π] [rad].
        positions: (N, 3) in the frame that the ring's pose leads to [m].
        sensors: (N, 2) sensors that it rests on, numbered from 1, the least reading first.
        reasons: (N,) places in ``REASONS``.
    """

    distances: Floats
    bearings: Floats
    positions: Floats
    sensors: NDArray[np.intp]
    reasons: NDArray[np.int8]


def estimate_many(ring: Ring, ranges: Floats, transform_ring_to_base: Floats) -> dict[str, ManyEstimates]:
    """Return the estimates of many scans: of ``as_printed``, ``corrected`` and ``nearest``, by name.

    Scan for scan the same as ``estimate``, to rounding.

    Args:
        ring: The ring that was read.
        ranges: (N, count) readings [m], ``inf`` for no echo.
        transform_ring_to_base: (4, 4) [m], one for all scans.

    Raises:
        InputError: ``wrong_length``, ``not_finite`` (NaN) or ``out_of_range`` (negative) readings; a pose
            that is not (4, 4) or not finite.
    """
    readings, pose = _checked(ring, ranges, transform_ring_to_base)
    rows = np.arange(len(readings))
    first = readings.argmin(axis=1) if len(readings) else np.zeros(0, dtype=np.intp)
    d1 = readings[rows, first]
    step, d2 = _second(readings, rows, first)
    why = np.where(np.isfinite(readings).sum(axis=1) == 1, _ONE_ECHO, _NOT_NEIGHBOURS)
    why = np.where(step == 0, why, 0)
    why = np.where(np.isfinite(d1), why, _NO_ECHO).astype(np.int8)
    second = np.where(step == 0, 0, (first + step) % ring.count + 1)
    sensors = np.stack([first + 1, second], axis=1)
    printed, distance, turned = _triangulated(ring, d1, d2)
    printed, distance, turned = (np.where(why == 0, value, np.nan) for value in (printed, distance, turned))
    bearings = 2.0 * math.pi / ring.count * first.astype(np.float64)
    silent = np.where(why == _NO_ECHO, why, 0).astype(np.int8)
    nothing = np.full(len(rows), np.nan)
    single = np.stack([first + 1, np.zeros_like(first)], axis=1)
    return {
        "as_printed": _made(pose, ring, printed, nothing, sensors, why),
        "corrected": _made(pose, ring, distance, bearings + step * turned, sensors, why),
        "nearest": _made(pose, ring, np.where(silent, np.nan, d1), bearings, single, silent),
    }


def _second(
    readings: Floats, rows: NDArray[np.intp], first: NDArray[np.intp]
) -> tuple[NDArray[np.intp], Floats]:
    """Return the side of S2, (N,) (+1, −1 or 0 for none), and its reading, NaN for none."""
    count = readings.shape[1]
    if count < 2:
        return np.zeros(len(rows), dtype=np.intp), np.full(len(rows), np.nan)
    after, before = readings[rows, (first + 1) % count], readings[rows, first - 1]
    d2 = np.minimum(after, before)
    step = np.where(np.isinf(d2), 0, np.where(after <= before, 1, -1)).astype(np.intp)
    return step, np.where(np.isinf(d2), np.nan, d2)


def _triangulated(ring: Ring, d1: Floats, d2: Floats) -> tuple[Floats, Floats, Floats]:
    """Return ``as_printed``, ``corrected`` and its angle from S1 towards S2, each (N,); NaN for none."""
    r = ring.radius
    chord = 2.0 * r * math.sin(math.pi / ring.count)
    with np.errstate(invalid="ignore", divide="ignore"):
        above, below = d1 * d1 + chord * chord - d2 * d2, 2.0 * d1 * chord
        closes = (below != 0.0) & (np.abs(above) <= below)
        phi = np.arccos(np.where(closes, above / below, np.nan))  # (5)
        printed = np.sqrt(np.maximum(0.0, r * r + d1 * d1 - 2.0 * d1 * r * np.cos(phi))) - r  # (6)
        theta = phi + math.pi / 2.0 - math.pi / ring.count
        outward, sideways = r - d1 * np.cos(theta), d1 * np.sin(theta)
        distance = np.hypot(outward, sideways) - r
    outside = distance >= 0.0
    turned = np.where(outside, np.arctan2(sideways, outward), np.nan)
    if ring.count == 2:  # S1, centre and S2 are in line: either side of that line is as good
        turned = np.full_like(turned, np.nan)
    return printed, np.where(outside, distance, np.nan), turned


def _made(
    pose: Floats,
    ring: Ring,
    distances: Floats,
    bearings: Floats,
    sensors: NDArray[np.intp],
    reasons: NDArray[np.int8],
) -> ManyEstimates:
    """Return one estimator's results; what ended as NaN without another reason closed no triangle."""
    none = np.isnan(distances)
    bearings = np.where(none, np.nan, bearings)
    from_axis = ring.radius + distances
    x, y = from_axis * np.cos(bearings), from_axis * np.sin(bearings)
    wrapped = np.where(bearings > math.pi, bearings - 2.0 * math.pi, bearings)
    wrapped = np.where(wrapped <= -math.pi, wrapped + 2.0 * math.pi, wrapped)
    return ManyEstimates(
        distances=distances,
        bearings=wrapped,
        positions=x[:, np.newaxis] * pose[:3, 0] + y[:, np.newaxis] * pose[:3, 1] + pose[:3, 3],
        sensors=np.where(none[:, np.newaxis], 0, sensors),
        reasons=np.where(none & (reasons == 0), _NO_TRIANGLE, reasons).astype(np.int8),
    )


def _checked(ring: Ring, ranges: Floats, transform_ring_to_base: Floats) -> tuple[Floats, Floats]:
    readings = np.asarray(ranges, dtype=np.float64)
    if readings.ndim != 2 or readings.shape[1] != ring.count:
        allowed = f"{ring.count} readings of ring {ring.name} for each scan"
        raise InputError("wrong_length", "ranges", readings.shape, allowed)
    if np.isnan(readings).any():
        raise InputError("not_finite", "ranges", "NaN", "numbers, or inf for no echo")
    if (readings < 0.0).any():
        raise InputError("out_of_range", "ranges", float(readings.min()), "0 or more, or inf for no echo")
    pose = np.asarray(transform_ring_to_base, dtype=np.float64)
    if pose.shape != (4, 4):
        raise InputError("wrong_length", "transform_ring_to_base", pose.shape, "4 × 4")
    if not np.isfinite(pose).all():
        raise InputError("not_finite", "transform_ring_to_base", pose.tolist(), "finite numbers")
    return readings, pose

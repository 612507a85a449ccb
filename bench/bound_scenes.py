"""Random scenes within declared assumptions, of several ring designs, for ``bench.bound`` and its tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from ssm_service.config.schema import AssumptionsConfig
from ssm_service.model import Ring, Robot, SensorArray

from .brute import MeshTruth, predicted

LINK = "forearm_link"
FARTHEST_M = 0.5

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One configuration.

    Attributes:
        design: Name of the rings, a key of ``DESIGNS``.
        radius_min: [m].
        radius_max: [m].
        error: ε [m].
        balls: Greatest number of balls in a scene; more than one is ``many``.
        many: Whether the assumptions say ``many``.
    """

    design: str
    radius_min: float
    radius_max: float
    error: float
    balls: int = 1
    many: bool = False

    @property
    def assumptions(self) -> AssumptionsConfig:
        """The same, as the service takes it."""
        return AssumptionsConfig(
            radius_min_m=self.radius_min,
            radius_max_m=self.radius_max,
            reading_error_m=self.error,
            obstacles="many" if self.many else "one",
        )


# Each ring: place along the forearm [m], count, field of view [deg], tilt [deg], range_min, range_max [m].
DESIGNS: dict[str, tuple[tuple[float, int, float, float, float, float], ...]] = {
    "ur3": ((0.106625, 8, 20.0, 0.0, 0.0, 1.2),),
    "clamped": ((0.106625, 8, 27.0, 0.0, 0.2, 0.6),),
    "wide": ((0.06, 12, 45.0, -20.0, 0.05, 0.8), (0.16, 12, 45.0, 20.0, 0.05, 0.8)),
    "covered": (
        (-0.045, 16, 60.0, -60.0, 0.0, 1.2),
        (0.0, 16, 60.0, -40.0, 0.0, 1.2),
        (0.05, 16, 60.0, -20.0, 0.0, 1.2),
        (0.1, 16, 60.0, 0.0, 0.0, 1.2),
        (0.15, 16, 60.0, 20.0, 0.0, 1.2),
        (0.2, 16, 60.0, 40.0, 0.0, 1.2),
        (0.245, 16, 60.0, 60.0, 0.0, 1.2),
    ),
}
CASES = (
    Case(design="ur3", radius_min=0.05, radius_max=0.05, error=0.0),
    Case(design="ur3", radius_min=0.05, radius_max=0.15, error=0.06),
    Case(design="ur3", radius_min=0.04, radius_max=0.1, error=0.01),
    Case(design="clamped", radius_min=0.05, radius_max=0.08, error=0.02),
    Case(design="wide", radius_min=0.03, radius_max=0.2, error=0.005),
    Case(design="wide", radius_min=0.05, radius_max=0.1, error=0.01, balls=3, many=True),
    Case(design="covered", radius_min=0.05, radius_max=0.1, error=0.01, balls=3, many=True),
    Case(design="covered", radius_min=0.05, radius_max=0.05, error=0.0, balls=1, many=True),
)


def sensors(robot: Robot, design: str) -> SensorArray:
    """Return the array of a design, on the UR3's forearm."""
    pattern = robot.config.file.rings[0]
    rings, slices, first = [], [], 0
    for number, (place, count, view, tilt, nearest, farthest) in enumerate(DESIGNS[design]):
        config = msgspec.structs.replace(
            pattern,
            name=f"ring{number}",
            origin_m=(0.0, 0.0, place),
            count=count,
            field_of_view_deg=view,
            tilt_deg=tilt,
            range_min_m=nearest,
            range_max_m=farthest,
        )
        rings.append(Ring.from_config(config))
        slices.append(slice(first, first + count))
        first += count
    return SensorArray.of_rings(LINK, rings, slices, [np.eye(4)] * len(rings))


def draw(
    case: Case, array: SensorArray, truth: MeshTruth, count: int, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Draw scenes whose balls do not reach into the link.

    Bearings, places along the link and 10 cm beyond, and gaps from the bare cylinder up to 0.5 m are uniform,
    radii within the assumptions (one in three the least, one in three the greatest). Noise is uniform in ±ε,
    one error in four at its end.

    Returns:
        Readings (n, k) [m]; least distance of a ball from the link by Coal (n,) [m]; centres (n, b, 3) [m]
        and radii (n, b) [m], nan for balls that a scene has not. n may be less than ``count``.
    """
    balls = rng.integers(1, case.balls + 1, count)
    absent = np.arange(case.balls) >= balls[:, None]
    kind = rng.integers(0, 3, absent.shape)
    radii = rng.uniform(case.radius_min, case.radius_max, absent.shape)
    radii = np.choose(
        kind, [radii, np.full_like(radii, case.radius_min), np.full_like(radii, case.radius_max)]
    )
    off = 0.03 + radii + rng.uniform(0.0, FARTHEST_M, absent.shape)
    turn = rng.uniform(0.0, 2.0 * math.pi, absent.shape)
    along = rng.uniform(truth.lower[2] - 0.1, truth.upper[2] + 0.1, absent.shape)
    centres = np.stack([off * np.cos(turn), off * np.sin(turn), along], axis=-1)
    gaps = truth.exact(centres.reshape(-1, 3)).reshape(absent.shape) - radii
    gaps[absent] = np.inf
    clear = gaps.min(axis=1) >= 0.0
    ideal = predicted(array, centres.reshape(-1, 3), radii.ravel()).reshape(*absent.shape, -1)
    ideal[absent] = np.inf
    nearest = np.maximum(ideal.min(axis=1), array.ranges_min)
    nearest[nearest > array.ranges_max] = np.inf
    noise = rng.uniform(-1.0, 1.0, nearest.shape)
    noise = case.error * np.where(rng.random(nearest.shape) < 0.25, np.sign(noise), noise)
    readings = np.maximum(nearest + noise, 0.0)
    readings[readings > array.ranges_max] = np.inf
    centres[absent], radii[absent] = np.nan, np.nan
    return readings[clear], gaps.min(axis=1)[clear], centres[clear], radii[clear]

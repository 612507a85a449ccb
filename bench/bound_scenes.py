"""Random scenes within declared assumptions, of several ring designs, for ``bench.bound`` and its tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from ssm_service.config import AssumptionsConfig
from ssm_service.model import Ring, Robot, SensorArray

from .brute import MeshTruth, predicted

LINK = "forearm_link"
FARTHEST_M = 0.5
AIMED_M = (0.05, 1.0)
GRAZING_M = 2e-3

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One configuration.

    Attributes:
        design: Name of the rings, a key of ``DESIGNS``, or ``OWN`` for those of the robot file.
        radius_min: [m].
        radius_max: [m].
        error: ε [m].
        balls: Greatest number of balls in a scene; more than one is ``many``.
        many: Whether the assumptions say ``many``.
        robot: Name of the robot file.
        link: That carries the rings.
        part: Share of the sweep's scenes, among all configurations'.
    """

    design: str
    radius_min: float
    radius_max: float
    error: float
    balls: int = 1
    many: bool = False
    robot: str = "ur3"
    link: str = LINK
    part: float = 1.0

    @property
    def label(self) -> str:
        """Name in the tables."""
        rings = f"{self.robot} {self.link}" if self.design == OWN else self.design
        count = f"many ({self.balls})" if self.many else "one"
        return f"{rings} {self.radius_min:g}–{self.radius_max:g} ±{1e3 * self.error:g} mm {count}"

    @property
    def assumptions(self) -> AssumptionsConfig:
        """The same, as the service takes it."""
        return AssumptionsConfig(
            radius_min_m=self.radius_min,
            radius_max_m=self.radius_max,
            reading_error_m=self.error,
            obstacles="many" if self.many else "one",
        )


OWN = "own"


def _covered(
    radius_min: float, radius_max: float, error: float, *, balls: int = 0, link: str = LINK, part: float
) -> Case:
    """Return a configuration of the covered UR3; any number of balls is ``many``."""
    return Case(
        design=OWN,
        radius_min=radius_min,
        radius_max=radius_max,
        error=error,
        balls=max(1, balls),
        many=balls > 0,
        robot="ur3_covered",
        link=link,
        part=part,
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
# What is swept: mostly single echoes, which cost little, for the number; fewer of what takes milliseconds.
SWEEP = (
    Case(design="ur3", radius_min=0.05, radius_max=0.15, error=0.06, part=230),
    Case(design="ur3", radius_min=0.05, radius_max=0.05, error=0.06, part=150),
    Case(design="ur3", radius_min=0.04, radius_max=0.1, error=0.01, part=150),
    Case(design="ur3", radius_min=0.03, radius_max=0.03, error=0.02, part=120),
    Case(design="ur3", radius_min=0.05, radius_max=0.05, error=0.0, part=80),
    Case(design="ur3", radius_min=0.03, radius_max=0.3, error=0.0, part=10),
    Case(design="clamped", radius_min=0.05, radius_max=0.08, error=0.02, part=110),
    Case(design="wide", radius_min=0.05, radius_max=0.1, error=0.02, part=40),
    Case(design="wide", radius_min=0.03, radius_max=0.2, error=0.005, part=4),
    _covered(0.05, 0.15, 0.02, part=8),
    _covered(0.05, 0.15, 0.02, link="upper_arm_link", part=2),
    _covered(0.05, 0.15, 0.02, balls=3, part=36),
    _covered(0.05, 0.15, 0.02, balls=3, link="upper_arm_link", part=32),
    _covered(0.08, 0.1, 0.06, balls=2, part=20),
    _covered(0.05, 0.05, 0.0, balls=2, part=6),
)
# A few of them, and one that no robot file has, for whoever wants few.
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


def sensors(robot: Robot, design: str, link: str = LINK) -> SensorArray:
    """Return the array of a design, on the UR3's forearm, or that of the robot file on ``link``."""
    if design == OWN:
        return next(array for array in robot.sensor_arrays if array.link == link)
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
    case: Case,
    array: SensorArray,
    truth: MeshTruth,
    count: int,
    rng: np.random.Generator,
    aimed: float = 0.0,
) -> tuple[Array, Array, Array, Array]:
    """Draw scenes whose balls do not reach into the link.

    Bearings, places along the link and 10 cm beyond, and gaps from the bare cylinder up to 0.5 m are uniform,
    radii within the assumptions (one in three the least, one in three the greatest). Noise is uniform in ±ε,
    one error in four at its end. A share of the balls, ``aimed``, stands before a sensor: see ``_before``.

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
    if aimed > 0.0:
        before = rng.random(absent.shape) < aimed
        centres[before] = _before(array, radii[before], rng)
    gaps = truth.exact(centres.reshape(-1, 3)).reshape(absent.shape) - radii
    gaps[absent] = np.inf
    clear = gaps.min(axis=1) >= 0.0
    ideal = predicted(array, centres.reshape(-1, 3), radii.ravel()).reshape(*absent.shape, -1)
    ideal[absent] = np.inf
    readings = _read(ideal.min(axis=1), array, case.error, rng)
    centres[absent], radii[absent] = np.nan, np.nan
    return readings[clear], gaps.min(axis=1)[clear], centres[clear], radii[clear]


def _before(array: SensorArray, radii: Array, rng: np.random.Generator) -> Array:
    """Return centres (n, 3) of balls before one of the sensors each, 0.05 to 1 m from its face [m].

    Two of three somewhere in the cone, centre or rim; one of three grazes the edge, by 2 mm or less: such
    balls come nearest to the bound.
    """
    sensor = rng.integers(0, len(array.half_angles), len(radii))
    cos, sin = np.cos(array.half_angles[sensor]), np.sin(array.half_angles[sensor])
    far = np.minimum(AIMED_M[1], array.ranges_max[sensor] + 0.1)
    place, turn = rng.uniform(AIMED_M[0], far), rng.uniform(0.0, 2.0 * math.pi, len(radii))
    # In the plane through the axis: ``inner`` of the way to the edge, and what the ball lies beyond it.
    inner, beyond = np.sqrt(rng.random(len(radii))), rng.uniform(0.0, 1.0, len(radii)) * radii
    grazing = rng.random(len(radii)) < 1.0 / 3.0
    beyond[grazing] = radii[grazing] - rng.uniform(0.0, GRAZING_M, int(grazing.sum()))
    edge = grazing | (rng.random(len(radii)) < 0.5)
    x = np.where(edge, place * cos - beyond * sin, place + radii)
    off = np.where(edge, place * sin + beyond * cos, inner * (place + radii) * sin / cos)
    local = np.stack([x, off * np.cos(turn), off * np.sin(turn)], axis=-1)
    T = array.transforms_sensor_to_link[sensor]
    centres: Array = np.einsum("nij,nj->ni", T[:, :3, :3], local) + T[:, :3, 3]
    return centres


def _read(ideal: Array, array: SensorArray, error: float, rng: np.random.Generator) -> Array:
    """Return what devices say of ideal readings (n, k): clipped to their ranges, with noise."""
    nearest = np.maximum(ideal, array.ranges_min)
    nearest[nearest > array.ranges_max] = np.inf
    noise = rng.uniform(-1.0, 1.0, nearest.shape)
    noise = error * np.where(rng.random(nearest.shape) < 0.25, np.sign(noise), noise)
    readings = np.maximum(nearest + noise, 0.0)
    readings[readings > array.ranges_max] = np.inf
    return readings

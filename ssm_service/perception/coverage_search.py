"""The least ring that closes the gap: count × field of view × rings, over one family of designs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .coverage_cones import Cones
from .coverage_gap import clear_distance
from .coverage_link import SensedLink
from .coverage_maps import axes_about, long_axis

Array = NDArray[np.float64]

FIELDS_OF_VIEW_DEG: Final = (20.0, 27.0, 45.0, 60.0)
"""What usual time-of-flight devices have."""

_STAND_OFF_M: Final = 0.006  # of a sensor's face from the link
_COUNTS: Final = (3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 20, 24)
_RINGS: Final = (1, 2, 3, 4, 5, 6, 7, 8, 10)
_STEEPEST_DEG: Final = (0.0, 30.0, 45.0, 60.0, 70.0, 80.0)
_SPREADS: Final = (0.2, 0.4, 0.6, 0.8, 0.9, 1.0)
_STEP: Final = 50  # plans between two yields
_MOST_PROOFS: Final = 40  # per field of view; each takes about half a second


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedRing:
    """One ring of a plan, about the link's long axis.

    Attributes:
        place: Of its plane along that axis [m], link frame.
        radius: Of the sensors' faces about the middle of the link's box [m].
        count: Sensors.
        tilt: [rad].
        phase: Bearing of sensor 1 [rad].
    """

    place: float
    radius: float
    count: int
    tilt: float
    phase: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Rings of one device round one link.

    Attributes:
        field_of_view_deg: Full opening angle [deg].
        count: Sensors of a ring that is not tilted; tilted ones have fewer, by the cosine of the tilt.
        rings: The rings.
    """

    field_of_view_deg: float
    count: int
    rings: tuple[PlannedRing, ...]

    @property
    def sensors(self) -> int:
        """Number of sensors of all rings."""
        return sum(ring.count for ring in self.rings)


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchResult:
    """What the search over one field of view found.

    Attributes:
        field_of_view_deg: Full opening angle [deg].
        plans: How many plans were looked at.
        best: The plan with the fewest sensors that is proved to close the gap; None where none was.
        proved: Distance up to which it is proved to leave nothing unseen [m].
    """

    field_of_view_deg: float
    plans: int
    best: Plan | None
    proved: float | None


def search(
    link: SensedLink,
    radius: float,
    distance: float,
    reach: float,
    fields_of_view_deg: Sequence[float] = FIELDS_OF_VIEW_DEG,
) -> Iterator[SearchResult | int]:
    """Search for the least number of sensors that leaves no ball unseen.

    Plans have one to ten rings of 3 to 24 sensors about the link's long axis, evenly spread along it and
    fanned out from one end to the other (outwards, or crosswise), with every second ring turned by half a
    pitch. A plan whose sensors would look at the link itself is left out. Points decide what is not worth a
    proof; ``clear_distance`` proves the rest.

    Args:
        link: The link; its own sensors do not matter.
        radius: Of the balls [m].
        distance: Gap up to which nothing may be unseen [m].
        reach: Range less reading error of the device [m].
        fields_of_view_deg: What to try.

    Yields:
        Numbers of plans looked at since the last one, for a progress bar; a result for each field of view.
    """
    hard, easy = _points(link, radius, distance)
    for field in fields_of_view_deg:
        best: Plan | None = None
        proved: float | None = None
        looked = proofs = 0
        plans = sorted(_plans(link, field), key=lambda plan: (plan.sensors, len(plan.rings)))
        for number, plan in enumerate(plans):
            if number % _STEP == 0:
                yield _STEP
            looked += 1
            cones = plan_cones(link, plan, reach)
            if _looks_at(link, cones) or not _sees(cones, radius, hard, easy):
                continue
            proofs += 1
            found = clear_distance(link.with_cones(cones), radius, distance)
            if found.witness is None and found.lower >= distance:
                best, proved = plan, found.lower
                break
            if proofs >= _MOST_PROOFS:
                break
        yield SearchResult(field_of_view_deg=field, plans=looked, best=best, proved=proved)


def plan_count(link: SensedLink, fields: Iterable[float] = FIELDS_OF_VIEW_DEG) -> int:
    """Return how many plans ``search`` may look at."""
    return sum(sum(1 for _ in _plans(link, field)) for field in fields)


def plan_cones(link: SensedLink, plan: Plan, reach: float) -> Cones:
    """Return the sensors of a plan in the link's frame."""
    axis = long_axis(link)
    rotation, middle = axes_about(axis), 0.5 * (link.body.box[:3] + link.body.box[3:])
    apexes, axes = [], []
    for ring in plan.rings:
        angles = ring.phase + 2.0 * math.pi / ring.count * np.arange(ring.count)
        out = np.stack([np.cos(angles), np.sin(angles), np.zeros(ring.count)], axis=1)
        origin = middle.copy()
        origin[axis] = ring.place
        apexes.append(origin + ring.radius * out @ rotation.T)
        up = np.array([0.0, 0.0, math.sin(ring.tilt)])
        axes.append((math.cos(ring.tilt) * out + up) @ rotation.T)
    half = math.radians(plan.field_of_view_deg) / 2.0
    return Cones(
        apexes=np.concatenate(apexes),
        axes=np.concatenate(axes),
        half_angles=np.full(plan.sensors, half),
        reaches=np.full(plan.sensors, reach),
    )


def _plans(link: SensedLink, field_of_view_deg: float) -> Iterator[Plan]:
    """Yield the family, without those that differ in nothing."""
    axis = long_axis(link)
    low, high = float(link.body.box[axis]), float(link.body.box[3 + axis])
    for rings, count in itertools.product(_RINGS, _COUNTS):
        if rings == 1:
            yield _plan(link, field_of_view_deg, count, [0.5 * (low + high)], [0.0])
            continue
        for steepest, spread, sign in itertools.product(_STEEPEST_DEG, _SPREADS, (1.0, -1.0)):
            if steepest == 0.0 and sign < 0.0:
                continue
            half = 0.5 * spread * (high - low)
            middle = 0.5 * (low + high)
            places = np.linspace(middle - half, middle + half, rings).tolist()
            tilts = np.linspace(-1.0, 1.0, rings) * sign * math.radians(steepest)
            yield _plan(link, field_of_view_deg, count, places, tilts.tolist())


def _plan(
    link: SensedLink, field_of_view_deg: float, count: int, places: list[float], tilts: list[float]
) -> Plan:
    rings = []
    for number, (place, tilt) in enumerate(zip(places, tilts, strict=True)):
        sensors = max(2, math.ceil(count * math.cos(tilt) - 1e-9))
        rings.append(
            PlannedRing(
                place=place,
                radius=_radius(link, place),
                count=sensors,
                tilt=tilt,
                phase=math.pi / sensors * (number % 2),
            )
        )
    return Plan(field_of_view_deg=field_of_view_deg, count=count, rings=tuple(rings))


def _radius(link: SensedLink, place: float) -> float:
    """Return the radius at which sensors stand clear of the link at a place along its long axis [m]."""
    axis = long_axis(link)
    off = np.delete(link.points - 0.5 * (link.body.box[:3] + link.body.box[3:]), axis, axis=1)
    near = np.abs(link.points[:, axis] - place) <= 0.015
    widest = float(np.hypot(off[:, 0], off[:, 1])[near].max()) if near.any() else 0.0
    return round(max(widest, 0.5 * _tube(link)) + _STAND_OFF_M, 4)


def _tube(link: SensedLink) -> float:
    """Return the least width of the link's box across its long axis [m], where no points tell."""
    spans = link.body.box[3:] - link.body.box[:3]
    return float(np.delete(spans, long_axis(link)).min())


def _looks_at(link: SensedLink, cones: Cones) -> bool:
    """Tell whether a point of the link itself lies in a cone."""
    return bool((cones.counts(link.points, np.zeros(1)) > 0).any())


def _points(link: SensedLink, radius: float, distance: float) -> tuple[Array, Array]:
    """Return centres of balls that are hard to see, the outermost and the touching, and all the rest."""
    found = []
    for edge, low, high in ((0.03, distance - 0.012, distance), (0.012, 0.0, 0.006), (0.06, 0.0, distance)):
        margin = radius + high
        centres = link.cells(margin, edge).centres
        near, far = link.distances(centres)
        gaps = 0.5 * (near + far) - radius
        found.append(centres[(gaps >= low) & (gaps <= high)])
    return np.concatenate(found[:2]), found[2]


def _sees(cones: Cones, radius: float, hard: Array, easy: Array) -> bool:
    """Tell whether all points are seen; a few first, as most plans fail soon."""
    points = hard[::37], hard, easy
    return all((cones.least_distances(some) <= radius).all() for some in points)

"""What the sensor rings say of the nearest thing, worked out once for each scan."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..config import AssumptionsConfig
from ..model import Kinematics, LinkDistance, Robot, SensorArray
from ..perception import Bound, LowerBound, OwnLinks
from ..safety import ZoneProfile
from .decision import Nearest
from .reaction import standstill_distance

_STEPS = 1e-3 * np.vstack((np.eye(3), -np.eye(3)))


class RangeReading(Struct, frozen=True, kw_only=True, eq=False):
    """One scan as the profile takes it.

    Attributes:
        nearest: What the profile's estimator says; ``None`` where it says nothing.
        ranges: (m,), [m], the readings that count; ``inf`` for silence and for the arm's own links.
        others: (m,), [m], the same without the arm's own links in every case, also where nobody answers for
            what they hide: from an own link nobody can be kept away. For motion, never for a zone.
        nearest_other: What the estimator says of ``others``, likewise.
        least: The least of them by link [m].
        bounds: The bound of each link that the rings answer for; none unless the estimator is one.
        silent: How near something could be in spite of silence, of each link that the rings answer for [m].
        unseen: Whether ``nearest`` is a thing that no sensor sees but that could be there.
        uncovered: Whether something could be nearer than the yellow distance without an echo.
        contradicted: Whether no admissible obstacle explains the readings.
    """

    nearest: Nearest | None
    ranges: NDArray[np.float64]
    others: NDArray[np.float64]
    nearest_other: Nearest | None
    least: dict[str, float]
    bounds: tuple[tuple[SensorArray, Bound, LinkDistance], ...]
    silent: Mapping[str, float]
    unseen: bool
    uncovered: bool
    contradicted: bool


OWN_LINK_MARGIN_M = 0.01
"""What model and joint positions may be off by where an echo is taken for the arm's own link [m]."""


class _Scan(Struct, frozen=True, kw_only=True, eq=False):
    """What does not change while the arm moves on: ranges (m,) [m] that count, and the bounds of them."""

    ranges: NDArray[np.float64]
    least: dict[str, float]
    uncovered: bool
    bounds: tuple[tuple[SensorArray, Bound, LinkDistance], ...]


class PreparedScan(Struct, frozen=True, kw_only=True, eq=False):
    """A scan as it counts without the echoes of own links, and with all of them.

    Attributes:
        ranges: (m,), [m], as they came, by whose identity it is known again.
        masked: Without the echoes that own links explain.
        whole: With all.
    """

    ranges: NDArray[np.float64]
    masked: _Scan
    whole: _Scan


class RangeReader:
    """Turns scans into what the profile makes of them.

    A reading that the arm's own link explains is left out where somebody answers for what that sensor cannot
    see: a tracker, or the profile, by what it makes of uncovered sectors. Otherwise it counts as an obstacle
    for the zone. For motion it never does: whoever is within the sensor's accuracy of an own link is left to
    the zone, which is then that of the own link's distance.

    Attributes:
        link: The link that carries the first ring; empty without rings.

    Args:
        robot: The robot.
        profile: Names the estimator and says what an uncovered sector is worth.
        period_s: Time from tick to tick [s], a part of the reaction time.
    """

    def __init__(self, robot: Robot, profile: ZoneProfile, period_s: float = 0.002) -> None:
        self._robot = robot
        self._config = profile.config
        self.link = robot.sensor_arrays[0].link if robot.sensor_arrays else ""
        self._own = OwnLinks(robot) if robot.rings else None
        self._tolerances = OWN_LINK_MARGIN_M + np.array([ring.accuracy for ring in robot.ring_of_sensor])
        self._expected: NDArray[np.float64] | None = None
        self._bounds = self._lower_bounds(robot.config.file.assumptions)
        silent = min((bound.silent for _, bound, _ in self._bounds), default=math.inf)
        unseen = {array.link: bound.silent for array, bound, _ in self._bounds}
        self._silent = {
            array.link: min(float(array.ranges_max.min()), unseen.get(array.link, math.inf))
            for array in answering_arrays(robot)
        }
        # As far as the profile looks: its yellow distance, or where its separation begins to let go.
        self._watched = max(*profile.config.edges, standstill_distance(robot, profile, period_s), 0.0)
        self._always_uncovered = silent < self._watched
        errors = robot.config.file.assumptions
        self._reading_error = 0.0 if errors is None else errors.reading_error_m
        self._prepared: PreparedScan | None = None

    @property
    def slow(self) -> bool:
        """Whether ``prepare`` may take longer than a tick should wait.

        It takes up to some ms with ``lower_bound``, and where sensors see own links.
        """
        return bool(self._robot.rings)

    def prepare(self, ranges: NDArray[np.float64], position: NDArray[np.float64]) -> PreparedScan:
        """Work out what does not change while the arm moves on.

        It may be called from one other thread, scan by scan; ``take`` then hands the result to ``read``.

        Args:
            ranges: (m,), [m], ``inf`` for no echo.
            position: (n,), [rad], when it was measured.
        """
        own, blind = self._own_echoes(position, ranges)
        masked = self._new_scan(ranges, own, self._always_uncovered or blind)
        whole = masked
        if self._config.uncovered == "off" and own.any():
            whole = self._new_scan(ranges, np.zeros_like(own), self._always_uncovered)
        return PreparedScan(ranges=ranges, masked=masked, whole=whole)

    def take(self, prepared: PreparedScan) -> None:
        """Take what ``prepare`` returned: ``read`` will be asked for these ranges from now on."""
        self._prepared = prepared

    def read(
        self,
        ranges: NDArray[np.float64],
        position: NDArray[np.float64],
        kinematics: Kinematics,
        *,
        tracked: bool,
    ) -> RangeReading:
        """Return what a scan says.

        Args:
            ranges: (m,), [m], ``inf`` for no echo; compared by identity with the last one.
            position: (n,), [rad], now.
            kinematics: The frames at ``position``.
            tracked: Whether another source looks everywhere now.
        """
        prepared = self._prepared
        if prepared is None or prepared.ranges is not ranges:
            prepared = self._prepared = self.prepare(ranges, position)
        scan = prepared.masked if tracked or self._config.uncovered != "off" else prepared.whole
        nearest = other = self._nearest(scan, kinematics)
        if scan is not prepared.masked:
            other = self._nearest(prepared.masked, kinematics)
        unseen = contradicted = False
        if self._config.range_estimator != "nearest":
            contradicted = any(bound.distance is None for _, bound, _ in scan.bounds)
            unseen = nearest is not None and scan.least[nearest.link] > self._reading_error
        return RangeReading(
            nearest=nearest,
            ranges=scan.ranges,
            others=prepared.masked.ranges,
            nearest_other=other,
            least=scan.least,
            bounds=scan.bounds,
            silent=self._silent,
            unseen=unseen,
            uncovered=scan.uncovered,
            contradicted=contradicted,
        )

    def _lower_bounds(
        self, assumptions: AssumptionsConfig | None
    ) -> list[tuple[SensorArray, LowerBound, LinkDistance]]:
        needed = self._config.range_estimator == "lower_bound" or self._config.uncovered != "off"
        if assumptions is None or not needed:
            return []
        return [
            (array, LowerBound(array, surface, assumptions), surface)
            for array in answering_arrays(self._robot)
            for surface in [LinkDistance(self._robot, array.link)]
        ]

    def _new_scan(self, ranges: NDArray[np.float64], own: NDArray[np.bool_], uncovered: bool) -> _Scan:
        seen = np.where(own, math.inf, ranges)
        least = {
            array.link: float(seen[array.indices].min(initial=math.inf))
            for array in self._robot.sensor_arrays
        }
        bounds: list[tuple[SensorArray, Bound, LinkDistance]] = []
        if self._config.range_estimator == "lower_bound":
            bounds = [(array, of.of(seen[array.indices]), surface) for array, of, surface in self._bounds]
        return _Scan(ranges=seen, least=least, uncovered=uncovered, bounds=tuple(bounds))

    def _own_echoes(
        self, position: NDArray[np.float64], ranges: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], bool]:
        """Return which echoes own links explain, (m,), and whether they hide what would be near.

        The scan was taken at some time since the last one, while the arm moved: what the arm looked like then
        lies between what it looked like at that scan and what it looks like now.
        """
        if self._own is None:
            return np.zeros(len(ranges), dtype=np.bool_), False
        found = self._own.detect(position, ranges, self._tolerances)
        before = found.expected if self._expected is None else self._expected
        self._expected = found.expected
        low, high = np.minimum(before, found.expected), np.maximum(before, found.expected)
        high = np.where(np.isfinite(high), high, low)  # seen in one of the two only
        between = (ranges >= low - self._tolerances) & (ranges <= high + self._tolerances)
        own = np.isfinite(ranges) & (found.own | between)
        missing = found.missing & np.isfinite(before) & ~own
        near = np.minimum(found.clear, low) < self._watched
        return own, bool((near & (own | missing)).any())

    def _nearest(self, scan: _Scan, kinematics: Kinematics) -> Nearest | None:
        """Return what the profile's estimator says of a scan."""
        if self._config.range_estimator == "nearest":
            return nearest_by_rings(self._robot, kinematics, scan.ranges)
        return self._nearest_by_bound(scan, kinematics)

    def _nearest_by_bound(self, scan: _Scan, kinematics: Kinematics) -> Nearest | None:
        """Return the ball that attains the least bound of all links; ``None`` where nothing could be there.

        A link's bound that nothing explains is more severe than any, and no ball attains it. What own links
        hide is not part of the promise: it is ``uncovered``.
        """
        least = min(
            scan.bounds,
            key=lambda entry: -math.inf if entry[1].distance is None else entry[1].distance,
            default=None,
        )
        if least is None or least[1].distance is None or least[1].distance == math.inf:
            return None
        array, bound, surface = least
        return ball_as_nearest(array, bound, least[1].distance, surface, kinematics)


def answering_arrays(robot: Robot) -> list[SensorArray]:
    """Return the sensor arrays of the links that the rings answer for."""
    assumptions = robot.config.file.assumptions
    links = None if assumptions is None else assumptions.links
    return [array for array in robot.sensor_arrays if links is None or array.link in links]


def link_pose(array: SensorArray, kinematics: Kinematics) -> NDArray[np.float64]:
    """Return the pose of the link that carries ``array``, (4, 4), to the base frame [m]."""
    T_base_sensor = kinematics.transform_sensor_to_base(int(array.indices[0]))
    T_base_link: NDArray[np.float64] = T_base_sensor @ array.transform_link_to_first_sensor
    return T_base_link


def ball_as_nearest(
    array: SensorArray, bound: Bound, distance: float, surface: LinkDistance, kinematics: Kinematics
) -> Nearest:
    """Return the ball that attains a bound as the nearest thing, in the base frame.

    Where the search met no ball, its place is not known, but its distance is: it is put before the first
    sensor.

    Args:
        array: The sensors.
        bound: Their bound.
        distance: Its distance [m].
        surface: Of the link that carries them.
        kinematics: The frames now.
    """
    if bound.centre is None or bound.radius is None:
        T_link_sensor = array.transforms_sensor_to_link[0]
        normal, on_link = -T_link_sensor[:3, 0], T_link_sensor[:3, 3]
        on_ball = on_link - distance * normal
    else:
        normal = towards_link(surface, bound.centre)
        on_ball = bound.centre + bound.radius * normal
        on_link = on_ball + distance * normal
    T_base_link = link_pose(array, kinematics)
    return Nearest(
        source="ranges",
        link=array.link,
        obstacle=None,
        distance=distance,
        point_on_link=T_base_link[:3, :3] @ on_link + T_base_link[:3, 3],
        point_on_obstacle=T_base_link[:3, :3] @ on_ball + T_base_link[:3, 3],
        normal=T_base_link[:3, :3] @ normal,
    )


def towards_link(surface: LinkDistance, point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit vector from ``point`` (3,) towards the link's nearest point, link frame.

    It is the gradient of the distance, by central differences over 2 mm.
    """
    distances = surface.distance(point + _STEPS)
    gradient = distances[3:] - distances[:3]
    x, y, z = gradient.tolist()
    length = math.hypot(x, y, z)
    if length > 0.0:
        return gradient / length
    return np.array([0.0, 0.0, 1.0])  # in the very middle of something: any direction is as good


def nearest_by_rings(robot: Robot, kinematics: Kinematics, ranges: NDArray[np.float64]) -> Nearest | None:
    """Return the least reading of all rings as the nearest thing: the estimator ``nearest``.

    Args:
        robot: The robot.
        kinematics: Its frames now.
        ranges: (m,), [m], ``inf`` for no echo.

    Returns:
        ``None`` where no sensor has an echo.
    """
    if not len(ranges):
        return None
    index = int(ranges.argmin())
    distance = float(ranges[index])
    if math.isinf(distance):
        return None
    T_base_sensor = kinematics.transform_sensor_to_base(index)
    direction = T_base_sensor[:3, 0]
    return Nearest(
        source="ranges",
        link=robot.link_of_sensor[index],
        obstacle=None,
        distance=distance,
        point_on_link=T_base_sensor[:3, 3],
        point_on_obstacle=T_base_sensor[:3, 3] + distance * direction,
        normal=-direction,
    )

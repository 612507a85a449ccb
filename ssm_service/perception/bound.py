"""The least distance that any admissible obstacle could have, given all readings and silences."""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config import AssumptionsConfig
from ..errors import InputError
from ..model import store
from ..model.link_distance import LinkDistance
from ..model.rings import SensorArray

Array = NDArray[np.float64]

_MOST_SENSORS: Final = 16  # of a table of single echoes
_CHUNK: Final = 64  # bins between two questions whether to go on
_KEPT_EVERY: Final = 40  # chunks, some two seconds


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bound:
    """What all readings and silences of one array promise about its link.

    Attributes:
        distance: No admissible obstacle that explains the readings is nearer to the link [m]; None where
            there is none: the readings contradict the assumptions.
        centre: (3,) of the nearest ball that the search met, link frame [m]; it may be some mm to cm farther
            off, and graze cones to 1e-7 m. None with ``distance``, and where the search met none.
        radius: Its radius [m]; None with ``centre``.
    """

    distance: float | None
    centre: Array | None
    radius: float | None


class LowerBound:
    """The infimum of the distance of all balls that agree with the readings of one link's sensors.

    A ball (centre c, radius R in [R_min, R_max], not in the link) agrees with an echo d where its reading is
    within ε of d: where it meets the sector of the cone up to d + ε and not the one up to d − ε. It agrees
    with silence where it does not meet the sector up to range_max − ε. With D the distance from the link,
    and g and h the least distance of c from a sector to avoid and the greatest from one to meet, these are
    h(c) ≤ R ≤ min(g(c), D(c)), and D(c) − R is to be least. With ``many`` obstacles the echoes may be
    others': h falls away, as for echoes of the arm's own links, and R_min is as good as any (a ball in the
    ball); but each echo must be explained by some ball. Noise may turn an echo beyond range_max − ε into
    silence, and one beyond range_max into an echo.

    D is tabulated from below (see ``LinkDistance``) and single echoes are rounded to 0.25 mm to the safe
    side, so the bound is never above the infimum, and within 1 mm of it where the link has no deep hollows.

    Several threads may share one.
    """

    def __init__(
        self,
        array: SensorArray,
        link_distance: LinkDistance,
        assumptions: AssumptionsConfig,
        kept: bool = True,
    ) -> None:
        """Prepare the search, and compile it where that was not done before.

        Args:
            array: The sensors of one link.
            link_distance: Of the same link.
            assumptions: What is taken for granted.
            kept: Whether to load and keep what ``fill`` finds, in the user's cache.

        Raises:
            InputError: ``wrong_link``: array and distance are of different links.
        """
        if array.link != link_distance.link:
            raise InputError("wrong_link", "link_distance", link_distance.link, array.link)
        from . import bound_readings  # numba takes half a second to import

        self._compiled: Any = bound_readings
        T = array.transforms_sensor_to_link
        angles, limits = array.half_angles, (array.ranges_min, array.ranges_max)
        columns = [T[:, :3, 3], T[:, :3, 0], np.cos(angles), np.sin(angles), *limits]
        self._sensors: Array = np.ascontiguousarray(np.column_stack(columns))
        self._link = (*link_distance.table, link_distance.near_points)
        self._radii = np.array([assumptions.radius_min_m, assumptions.radius_max_m])
        self._many = assumptions.obstacles == "many"
        self._rules = np.array([assumptions.reading_error_m, float(self._many), math.nan])
        bins = int(array.ranges_max.max() / bound_readings.STEP) + 2
        self._memory: Array = np.full((len(self._sensors), bins, 6), np.nan)
        none = np.full(len(self._sensors), np.inf)
        self._leaves = bound_readings.prepare(self._link, self._sensors, self._radii, self._rules)
        self._silent = self._search(none, np.zeros(len(none), dtype=np.bool_))
        self._rules[2] = self.silent
        self._leaves = bound_readings.prepare(self._link, self._sensors, self._radii, self._rules)
        self._fill_some(0, 0)  # compiled here, like all that later calls need
        self.of_many(none[np.newaxis])
        self._name = f"bound-{self._digest()}" if kept and self._fits else ""
        content = store.load(self._name, self._memory.nbytes) if self._name else None
        if content is not None:
            self._memory = np.frombuffer(content).reshape(self._memory.shape).copy()

    @property
    def silent(self) -> float:
        """The bound when every sensor is silent [m]: how near a ball comes unseen."""
        return math.inf if self._silent.distance is None else self._silent.distance

    @property
    def _fits(self) -> bool:
        """Whether single echoes are worth a table: with many balls about they say little alone."""
        return not self._many and len(self._sensors) <= _MOST_SENSORS

    def fill(self, keep_on: Callable[[], bool] = lambda: True) -> bool:
        """Find the bounds of all single echoes beforehand, and keep them on disk for the next time.

        Without it each is found when it first occurs. Other threads may use this bound meanwhile. What is
        found is kept now and then, so that the next process goes on where this one was ended.

        Args:
            keep_on: Asked some ten times a second or more often; False ends it.

        Returns:
            Whether all are known now; False also where no table is made.
        """
        if not self._fits:
            return False
        unknown = np.isnan(self._memory[:, :, 0]).ravel()
        firsts = [first for first in range(0, len(unknown), _CHUNK) if unknown[first : first + _CHUNK].any()]
        for number, first in enumerate(firsts, start=1):
            if not keep_on():
                return False
            self._fill_some(first, first + _CHUNK)
            if self._name and (number % _KEPT_EVERY == 0 or number == len(firsts)):
                store.save(self._name, self._memory.tobytes())
        return True

    def _fill_some(self, first: int, last: int) -> None:
        k = len(self._sensors)
        scratch = np.empty(k), np.zeros(k, dtype=np.bool_), np.empty(5)
        fixed = self._link, self._leaves, self._sensors, self._radii, self._rules, self._memory
        self._compiled.fill_bins(*fixed, *scratch, first, last)

    def _digest(self) -> str:
        """Return a digest of all that the table depends on."""
        from ..model.compiled import sources

        digest = hashlib.sha256(f"{sources()} {self._memory.shape} {sys.byteorder}".encode())
        for array in (*self._link, self._sensors, self._radii, self._rules):
            digest.update(f"{array.shape} {array.dtype}".encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def of(self, readings: ArrayLike, own: ArrayLike | None = None) -> Bound:
        """Return the bound of one scan.

        Args:
            readings: (k,) of the array's sensors [m], inf for silence.
            own: (k,) which echoes are known to be of the arm's own links: such an echo says only that no
                ball is nearer in that cone.

        Raises:
            InputError: ``wrong_length``, ``not_finite`` (NaN) or ``out_of_range`` (negative) readings.
        """
        scan = _checked(readings, (len(self._sensors),))
        if (self._many and self.silent == 0.0) or scan.min(initial=math.inf) == math.inf:
            return self._silent  # echoes only leave more room for another ball
        if own is None:
            known = np.zeros(len(scan), dtype=np.bool_)
        else:
            known = np.array(own, dtype=np.bool_)
            if known.shape != scan.shape:
                raise InputError("wrong_length", "own", known.shape, f"{len(scan)} flags")
        return self._search(scan, known)

    def of_many(self, readings: ArrayLike) -> Array:
        """Return the bounds of many scans, (n,) [m]; nan where no ball is admissible.

        Args:
            readings: (n, k) [m], inf for silence.

        Raises:
            InputError: As for ``of``.
        """
        scans = _checked(readings, (None, len(self._sensors)))
        result = np.empty(len(scans))
        self._compiled.bounds_of(
            self._link, self._leaves, self._sensors, self._radii, self._rules, self._memory, scans, result
        )
        return result

    def _search(self, readings: Array, own: NDArray[np.bool_]) -> Bound:
        found = np.empty(5)
        distance = self._compiled.bound_of(
            self._link,
            self._leaves,
            self._sensors,
            self._radii,
            self._rules,
            self._memory,
            readings,
            own,
            found,
        )
        if distance == math.inf:
            return Bound(distance=None, centre=None, radius=None)
        if found[0] == math.inf:
            return Bound(distance=distance, centre=None, radius=None)
        found.flags.writeable = False
        return Bound(distance=distance, centre=found[1:4], radius=float(found[4]))


def _checked(readings: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    values = np.array(readings, dtype=np.float64, order="C")
    fits = values.ndim == len(shape) and values.shape[-1] == shape[-1]
    if not fits:
        raise InputError("wrong_length", "readings", values.shape, f"{shape[-1]} readings in each scan")
    if np.isnan(values).any():
        raise InputError("not_finite", "readings", "NaN", "numbers, or inf for no echo")
    if (values < 0.0).any():
        raise InputError("out_of_range", "readings", values.tolist(), "0 or more, or inf for no echo")
    return values

"""The ball that best explains all the readings and all the silences of one link's sensors: ``sphere_fit``.

An estimate is an estimate: nothing here is a bound on the true distance.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config import AssumptionsConfig
from ..errors import InputError
from ..model.link_distance import LinkDistance
from ..model.rings import SensorArray

Array = NDArray[np.float64]

_UNIFORM: Final = 1.0 / math.sqrt(3.0)  # deviation of what is uniform in ±1
_UP_SPREAD: Final = 0.5  # of the beam's half-width: how far balls that a beam sees deviate from its axis
_PARALLEL: Final = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class FitWeights:
    """How much each kind of disagreement counts. One unit of residual is one of these.

    The defaults were tuned once, for the distance, on balls, capsules, hands and persons, without noise and
    with ±6 cm, seen by three arrangements of sensors; the same set serves them all.

    With one ring, readings say next to nothing of where along the link's axis the obstacle is. A ball in
    the ring's plane would be the *farthest* that explains a reading, not the middle of those that do, so
    the ball is put off the plane by the share ``up_mean`` of the beam's half-width ``(m + R) sin α + R`` at
    the least reading m. Which side it is on, one ring cannot tell (the ring's axis points to the
    side taken); several rings can.

    Attributes:
        reading_m: A reading off its ball [m].
        farther: Greatest residual of an echo that comes from farther than the ball, other than the least: it
            may be another part's.
        silence_m: A ball that reaches this far into a silent cone [m].
        doubt: Greatest residual of a silence: an echo can be lost.
        miss_m: A ball that fails to reach an echoing cone by this much [m].
        missed: Greatest residual of that; of the least reading it is not bounded.
        up_mean: Mean distance from the beam's axis in the plane of beam and ring's axis, by half-widths.
        up_std: Deviation from that, likewise.
        side_std: Deviation square to that plane, likewise.
    """

    reading_m: float = 0.01
    farther: float = 0.8
    silence_m: float = 0.01
    doubt: float = 10.0
    miss_m: float = 0.003
    missed: float = 0.3
    up_mean: float = 0.26
    up_std: float = 0.05
    side_std: float = 1.0

    def __post_init__(self) -> None:
        for field, value in dataclasses.asdict(self).items():
            if not (0.0 < value < math.inf or (value == 0.0 and field == "up_mean")):
                raise InputError("out_of_range", field, value, "above 0 and finite")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """The ball that was fitted to one scan.

    Attributes:
        distance: Of the ball from the link's real surface, 0 where it touches [m].
        centre: (3,) link frame [m].
        position: (3,) the ball's point nearest to the link, link frame [m].
        bearing: Of that point about the first ring's axis from its sensor 1, in (−π, π] [rad].
        distance_std: Deviation of ``distance`` by the readings' declared error and the priors, for a
            ball of the assumed radius [m]. Other shapes and a second obstacle are not in it.
        sensors: The sensors with an echo, indices into the array from 0, the least reading first.
    """

    distance: float
    centre: Array
    position: Array
    bearing: float
    distance_std: float
    sensors: tuple[int, ...]


class SphereFit:
    """Fits a ball of the assumed radius to one link's readings and silences.

    Least squares over the centre: each echo against the closed form of the ball's reading, each silence
    against how far the ball reaches into the silent cone, and two priors (``FitWeights``); all
    with analytic derivatives, by a compiled Levenberg–Marquardt method from one to ten starts
    (``fit_solver`` says why no library's). The constructor compiles and makes the link's table, so that no
    call later has to.
    """

    def __init__(
        self,
        array: SensorArray,
        link_distance: LinkDistance,
        assumptions: AssumptionsConfig,
        weights: FitWeights | None = None,
    ) -> None:
        """Prepare the fit.

        Args:
            array: The sensors that one link carries.
            link_distance: Distance from that link.
            assumptions: ``assumed_radius_m`` (else ``radius_min_m``) and ``reading_error_m`` are used.
            weights: Other than the usual weights.

        Raises:
            InputError: ``wrong_link``: the distance is another link's.
        """
        from .fit_solver import RESULTS, fit_many  # numba takes half a second to import

        if link_distance.link != array.link:
            raise InputError("wrong_link", "link_distance", link_distance.link, f"that of {array.link}")
        self.array = array
        self.weights = weights if weights is not None else FitWeights()
        assumed = assumptions.assumed_radius_m
        self.radius = assumed if assumed is not None else assumptions.radius_min_m
        w = self.weights
        reading = _UNIFORM * assumptions.reading_error_m / w.reading_m
        ratios = np.array([reading**2, 1.0, (_UP_SPREAD / w.up_std) ** 2, (_UP_SPREAD / w.side_std) ** 2])
        mirrored = len(array.rings) == 1 and array.rings[0].tilt == 0.0
        self._arguments = (
            sensor_table(array),
            np.array(dataclasses.astuple(w)),
            ratios,
            mirrored,
            *link_distance.table,
        )
        self._transform_link_to_ring = _link_to_ring(array)
        self._columns, self._fit_many = RESULTS, fit_many
        warm = np.full((1, len(array.indices)), math.inf)
        warm[0, 0] = 0.1
        self._fitted(warm)

    def of(self, readings: ArrayLike) -> Fit | None:
        """Fit one scan; None where no sensor has an echo.

        Args:
            readings: (k,) of this array's sensors [m], inf for silence.

        Raises:
            InputError: ``wrong_length``, ``not_finite`` (NaN) or ``out_of_range`` (negative) readings.
        """
        values = self._checked(readings, 1)
        row = self._fitted(values[np.newaxis])[0]
        row.flags.writeable = False
        _, _, _, distance, x, y, z, deviation, _, _ = row.tolist()
        if math.isnan(distance):
            return None
        along, across = self._transform_link_to_ring
        bearing = math.atan2(
            across[0] * x + across[1] * y + across[2] * z + across[3],
            along[0] * x + along[1] * y + along[2] * z + along[3],
        )
        echoes = sorted((m, i) for i, m in enumerate(values.tolist()) if m < math.inf)
        return Fit(
            distance=distance,
            centre=row[:3],
            position=row[4:7],
            bearing=math.pi if bearing == -math.pi else bearing,
            distance_std=deviation,
            sensors=tuple([i for _, i in echoes]),
        )

    def of_many(self, readings: ArrayLike) -> tuple[Array, Array]:
        """Fit many scans: the very results of ``of``.

        Args:
            readings: (n, k) [m], inf for silence.

        Returns:
            Distances (n,) and positions (n, 3), link frame [m]; NaN where no sensor has an echo.

        Raises:
            InputError: As for ``of``.
        """
        rows = self._fitted(self._checked(readings, 2))
        return rows[:, 3].copy(), rows[:, 4:7].copy()

    def _fitted(self, readings: Array) -> Array:
        rows = np.empty((len(readings), self._columns))
        sensors, weights, ratios, mirrored, levels, values, box = self._arguments
        self._fit_many(sensors, readings, self.radius, weights, ratios, mirrored, levels, values, box, rows)
        return rows

    def _checked(self, readings: ArrayLike, dimensions: int) -> Array:
        values = np.array(readings, dtype=np.float64, order="C")  # writable, or numba would compile anew
        count = len(self.array.indices)
        if values.ndim != dimensions or values.shape[-1] != count:
            raise InputError(
                "wrong_length", "readings", values.shape, f"{count} readings of {self.array.link}"
            )
        if not (values >= 0.0).all():
            if np.isnan(values).any():
                raise InputError("not_finite", "readings", "NaN", "numbers, or inf for no echo")
            raise InputError("out_of_range", "readings", float(values.min()), "0 or more, or inf for no echo")
        return values


def sensor_table(array: SensorArray) -> Array:
    """Return the array's sensors as ``fit_cost`` takes them, (k, 16), read-only."""
    T_link_sensors = array.transforms_sensor_to_link
    axes = T_link_sensors[:, :3, 0]
    up = T_link_sensors[:, :3, 2]  # in the plane of beam and ring's axis, whatever the tilt
    table = np.hstack(
        [
            T_link_sensors[:, :3, 3],
            axes,
            up,
            np.cross(axes, up),
            np.cos(array.half_angles)[:, np.newaxis],
            np.sin(array.half_angles)[:, np.newaxis],
            array.ranges_min[:, np.newaxis],
            array.ranges_max[:, np.newaxis],
        ]
    )
    table.flags.writeable = False
    return table


def _link_to_ring(array: SensorArray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the first two rows of the transform from the link's to the first ring's frame."""
    T_link_sensor, T_ring_sensor = (
        array.transforms_sensor_to_link[0],
        array.rings[0].transform_sensors_to_ring[0],
    )
    T_ring_link = T_ring_sensor @ np.linalg.inv(T_link_sensor)
    return tuple(T_ring_link[0].tolist()), tuple(T_ring_link[1].tolist())

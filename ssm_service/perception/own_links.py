"""Self-occlusion: what the sensors see of the arm that carries them, and which echoes that explains."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..model import Robot
from .own_surface import OwnSurface
from .surface_kernels import read_surface

DEFAULT_MARGIN_RAD: Final = math.radians(1.0)

_HALVINGS: Final = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OwnEchoes:
    """What the arm's own links explain of one scan; all arrays are (m,), in the order of the readings.

    Attributes:
        expected: What each sensor should read of the arm alone [m], ``inf`` for no echo.
        own: Whether the reading is an echo at the place of an own link. It says that nothing is nearer in
            that cone, and nothing of what is behind.
        missing: Whether an own link should have been seen and the sensor is silent or reads clearly farther:
            sensor, joint positions or model are wrong, and the reading must not be taken as clear.
        clear: How far each sensor can see at all [m]: ``expected``, an own echo if that is nearer, else its
            greatest range.
    """

    expected: NDArray[np.float64]
    own: NDArray[np.bool_]
    missing: NDArray[np.bool_]
    clear: NDArray[np.float64]


class OwnLinks:
    """The readings of the arm's own links: all with collision geometry, monitored or not.

    A reading is exact for the collision geometry itself: closed forms for the triangles of meshes and
    boxes, a line search for capsules; a cylinder counts as a prism round it (too wide by 7.5e-5 of its
    radius). It is never above the truth by more than rounding. Two rules:

    - Whatever is rigidly joined to the sensor (the link that carries it, and links fixed to that one) shows
      only surfaces whose outer side faces the sensor. A face set a hair below its link's surface sees out
      of it; a bulge of the link that reaches into a tilted or wide cone is seen. That part never changes,
      and is worked out once.
    - Of links that move, both sides of the surface count. A sensor *inside* another link (an arm in collision
      with itself) reads the way out.

    Not for use by several threads at once: working memory is kept between calls.

    Args:
        robot: The robot.
        margin_rad: How well field of view and joint positions are known [rad], for ``detect``.

    Raises:
        InputError: ``out_of_range`` margin.
    """

    def __init__(self, robot: Robot, *, margin_rad: float = DEFAULT_MARGIN_RAD) -> None:
        if not 0.0 <= margin_rad < math.pi / 2.0:
            raise InputError("out_of_range", "margin_rad", margin_rad, "0 or more, below π/2 rad")
        self._robot = robot
        self._data = robot.model.createData()
        self._surface = surface = OwnSurface.of_robot(robot)
        self._T_base_bodies = np.tile(np.eye(4), (robot.model.njoints, 1, 1))
        count = robot.sensor_count
        bodies, T_body_sensors = np.zeros(count, dtype=np.intp), np.tile(np.eye(4), (count, 1, 1))
        half_angles, self._range_min, self._range_max = np.ones(count), np.zeros(count), np.zeros(count)
        for array in robot.sensor_arrays:
            frame = robot.model.frames[robot.model.getFrameId(array.link, pin.FrameType.BODY)]
            bodies[array.indices] = frame.parentJoint
            T_body_sensors[array.indices] = frame.placement.homogeneous @ array.transforms_sensor_to_link
            half_angles[array.indices] = array.half_angles
            self._range_min[array.indices] = array.ranges_min
            self._range_max[array.indices] = array.ranges_max
        self._used = sorted({*bodies.tolist(), *surface.bodies.tolist()})
        self._bodies, self._T_body_sensors = bodies, T_body_sensors
        self._angles = (  # narrow, as it is, wide
            np.maximum(half_angles - margin_rad, 0.1 * half_angles),
            half_angles,
            np.minimum(half_angles + margin_rad, 0.5 * (half_angles + 0.5 * math.pi)),
        )
        nowhere = np.full(count, math.inf)
        self._fixed = tuple(self._read(angles, nowhere, rigid=True) for angles in self._angles)

    def readings(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return what each sensor reads of the arm alone, (m,) [m], ``inf`` for no echo.

        Clamped as a device's readings are: no echo beyond the greatest range, and from nearer than the least
        range that one.

        Args:
            position: (n,) [rad or m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        distances = self.distances(position)
        seen = np.maximum(distances, self._range_min)
        seen[distances > self._range_max] = math.inf
        return seen

    def distances(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return the same without regard to the ranges of the device, (m,) [m]."""
        self._place(position)
        return self._read(self._angles[1], self._fixed[1])

    def detect(self, position: ArrayLike, ranges: ArrayLike, tolerance: ArrayLike) -> OwnEchoes:
        """Return which readings the arm's own links explain.

        An echo within ``tolerance`` of the own link's distance is own; one clearly nearer is an obstacle's;
        an own link that was to be seen and was not is ``missing``. A link at the edge of a cone may be seen
        or not: what could be its echo in a cone wider or narrower by the margin is own as well, and it is
        missing only where the narrower cone should show it. Where the link may lie beyond the device's
        range (by no more than ``tolerance``), silence is right, too.

        Args:
            position: (n,) joint positions at which the sensors measured [rad or m].
            ranges: (m,) readings [m], ``inf`` for no echo.
            tolerance: Greatest error of reading and prediction together, one or (m,) [m].

        Raises:
            InputError: ``wrong_length``, ``not_finite`` or ``out_of_range``.
        """
        readings, error = self._checked(ranges, tolerance)
        self._place(position)
        wide = self._seen(2)
        if bool((wide == math.inf).all()):  # nothing of the arm in any cone, the usual case
            none = np.zeros(len(wide), dtype=np.bool_)
            return OwnEchoes(expected=wide, own=none, missing=none.copy(), clear=self._range_max.copy())
        narrow, distances = self._seen(0), self._seen(1)
        # An infinite difference is far off; heard is never infinite where that would make it none.
        heard = np.where(readings < math.inf, readings, -math.inf)
        own = (np.abs(heard - distances) <= error) | (np.abs(heard - narrow) <= error)
        own |= (heard >= wide - error) & (heard <= self._farthest_at_edge(wide, narrow, error) + error)
        farthest = narrow + error
        missing = (readings > farthest) & (farthest <= self._range_max) & ~own
        expected = np.where(distances > self._range_max, math.inf, distances)
        clear = np.minimum(expected, np.where(own, readings, self._range_max))
        return OwnEchoes(expected=expected, own=own, missing=missing, clear=clear)

    def _farthest_at_edge(
        self, wide: NDArray[np.float64], narrow: NDArray[np.float64], error: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how far the link that the wide cone shows may read in any cone between, (m,) [m].

        That is ``narrow``, unless the reading jumps in between to another link, or to none: then halve the
        angles until the place of the jump is known.
        """
        jumps = (wide < math.inf) & (narrow > wide + 2.0 * error)
        if not bool(jumps.any()):
            return narrow
        level = np.where(narrow < math.inf, 0.5 * (narrow + wide), math.inf)
        low, _, high = self._angles
        farthest = wide
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            reading = np.maximum(self._read(middle, self._fixed[1]), self._range_min)
            near = reading < level
            farthest = np.where(near, reading, farthest)
            low, high = np.where(near, low, middle), np.where(near, middle, high)
        return np.where(jumps, farthest, narrow)

    def _seen(self, which: int) -> NDArray[np.float64]:
        """Return the readings in the narrow (0), usual (1) or wide (2) cones, not below the least range."""
        seen: NDArray[np.float64] = np.maximum(
            self._read(self._angles[which], self._fixed[which]), self._range_min
        )
        return seen

    def _place(self, position: ArrayLike) -> None:
        """Work out the poses of all joints that carry a sensor or geometry."""
        q = self._robot.pinocchio_configuration(position)
        pin.forwardKinematics(self._robot.model, self._data, q)
        for body in self._used:
            self._T_base_bodies[body] = self._data.oMi[body].homogeneous

    def _read(
        self, angles: NDArray[np.float64], start: NDArray[np.float64], *, rigid: bool = False
    ) -> NDArray[np.float64]:
        """Return ``start`` (m,), lowered to readings of what is not (``rigid``: is) fixed to the sensor."""
        surface, out = self._surface, start.copy()
        read_surface(
            self._T_base_bodies, self._bodies, self._T_body_sensors, angles, surface.bodies, surface.roots,
            surface.capsules, surface.balls, surface.nodes, surface.corners, rigid, out,
        )  # fmt: skip
        return out

    def _checked(
        self, ranges: ArrayLike, tolerance: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        readings = np.asarray(ranges, dtype=np.float64)
        error = np.asarray(tolerance, dtype=np.float64)
        if readings.shape != self._range_max.shape:
            raise InputError("wrong_length", "ranges", readings.shape, f"{len(self._range_max)} readings")
        if np.isnan(readings).any():
            raise InputError("not_finite", "ranges", readings.tolist(), "numbers, or inf for no echo")
        if error.shape not in ((), readings.shape):
            raise InputError("wrong_length", "tolerance", error.shape, "one for all or one for each sensor")
        if not ((error >= 0.0) & (error < math.inf)).all():
            raise InputError("out_of_range", "tolerance", error.tolist(), "0 or more, finite [m]")
        return readings, error

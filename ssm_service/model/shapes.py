"""Obstacles: four convex shapes with a pose and a velocity, checked when they are made."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, listed, suggestion

SIZE_NAMES: Final[dict[str, tuple[str, ...]]] = {
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
    "cylinder": ("radius", "length"),
    "box": ("x", "y", "z"),
}
"""What the numbers of ``Obstacle.size`` mean, by shape."""

MAX_SIZE_M: Final = 100.0
MAX_POSITION_M: Final = 1000.0
MAX_VELOCITY_M_S: Final = 1000.0
QUATERNION_TOLERANCE: Final = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstacle:
    """One obstacle in the robot's base frame.

    Attributes:
        id: Name under which results speak of it.
        shape: ``sphere``, ``capsule``, ``cylinder`` or ``box``.
        size: [m]. sphere ``(radius,)``; capsule ``(radius, length)`` with the length of the segment
            between the centres of the caps; cylinder ``(radius, length)``; box ``(x, y, z)``, full edges.
            Capsules and cylinders lie along their own z axis, centred.
        position: (3,) centre in the base frame [m].
        quaternion_xyzw: (4,) orientation in the base frame; normalised here.
        velocity: (3,) velocity of the centre, expressed in the base frame [m/s]; ``None`` where nobody knows.

    Raises:
        InputError: ``unknown_shape``, ``wrong_length``, ``wrong_type``, ``not_finite``, ``out_of_range``
            or ``bad_quaternion``; ``where`` names the field.
    """

    id: str
    shape: str
    size: tuple[float, ...]
    position: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    velocity: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        names = SIZE_NAMES.get(self.shape) if isinstance(self.shape, str) else None
        if names is None:
            allowed = f"{suggestion(str(self.shape), SIZE_NAMES)}one of {listed(SIZE_NAMES)}"
            raise InputError("unknown_shape", "shape", self.shape, allowed)
        size = _finite(self.size, len(names), "size")
        if not (min(size) > 0.0 and max(size) <= MAX_SIZE_M):
            allowed = f"{listed(names)} above 0 and at most {MAX_SIZE_M:g} m"
            raise InputError("out_of_range", "size", self.size, allowed)
        position = _finite(self.position, 3, "position")
        if math.hypot(*position) > MAX_POSITION_M:
            raise InputError(
                "out_of_range", "position", position, f"at most {MAX_POSITION_M:g} m from the base"
            )
        velocity = None if self.velocity is None else _finite(self.velocity, 3, "velocity")
        if velocity is not None and math.hypot(*velocity) > MAX_VELOCITY_M_S:
            raise InputError("out_of_range", "velocity", velocity, f"at most {MAX_VELOCITY_M_S:g} m/s")
        quaternion = _finite(self.quaternion_xyzw, 4, "quaternion_xyzw")
        norm = math.hypot(*quaternion)
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            allowed = f"a quaternion of norm 1 ± {QUATERNION_TOLERANCE:g}"
            raise InputError("bad_quaternion", "quaternion_xyzw", quaternion, allowed)
        if norm != 1.0:
            quaternion = tuple([value / norm for value in quaternion])
        for name, value in (
            ("size", size),
            ("position", position),
            ("quaternion_xyzw", quaternion),
            ("velocity", velocity),
        ):
            object.__setattr__(self, name, value)

    @property
    def rotated(self) -> bool:
        """Whether the orientation matters: no sphere, and not the identity."""
        return self.shape != "sphere" and self.quaternion_xyzw[3] != 1.0

    @property
    def radius(self) -> float:
        """Radius of a sphere, capsule or cylinder; of a box, that of the ball round it [m]."""
        return 0.5 * math.hypot(*self.size) if self.shape == "box" else self.size[0]

    @property
    def axis(self) -> tuple[float, float, float]:
        """(3,) own z axis, unit, in the base frame."""
        x, y, z, w = self.quaternion_xyzw
        return (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))

    def rotation(self) -> NDArray[np.float64]:
        """Return the orientation as a matrix, (3, 3), obstacle to base frame."""
        x, y, z, w = self.quaternion_xyzw
        return np.array(
            [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
                [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
                [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
            ]
        )


def _finite(values: Iterable[float], length: int, where: str) -> tuple[float, ...]:
    try:
        numbers = tuple(map(float, values))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError("wrong_type", where, values, f"{length} numbers") from error
    if len(numbers) != length:
        raise InputError("wrong_length", where, numbers, f"{length} numbers")
    if not all(map(math.isfinite, numbers)):
        raise InputError("not_finite", where, numbers, "finite numbers")
    return numbers

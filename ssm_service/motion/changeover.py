"""From one method or kind of target to another without a jump of the command."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray


class Changeover:
    """Bounds how fast the wanted velocity changes after a change of method, until the new one is reached.

    Slowing down is never delayed otherwise; here it is, by at most ``speed / acceleration``, since a joint
    that is stopped and sped up again by two methods in turn is a jolt. What it returns is what is *wanted*:
    limits of zones and joints come after it, so no ramp delays a stop.

    Args:
        acceleration: Greatest change of a joint's wanted velocity while changing over [rad/s²].
        dt: Time from tick to tick [s].
    """

    def __init__(self, acceleration: float, dt: float) -> None:
        self._greatest = acceleration * dt
        self._method: Hashable = None
        self._changing = False

    def step(
        self, method: Hashable, wanted: NDArray[np.float64], previous: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the velocity to want now, (n,).

        Args:
            method: What made ``wanted``; anything that differs from the last tick's begins a change-over.
                ``None`` is standing still without any target: nothing has to be reached then.
            wanted: (n,) [rad/s].
            previous: (n,) the last command [rad/s].
        """
        if method != self._method:
            self._changing = method is not None and self._method is not None
            self._method = method
        if not self._changing:
            return wanted
        change = np.clip(wanted - previous, -self._greatest, self._greatest)
        reached = previous + change
        self._changing = bool(np.any(reached != wanted))
        return reached

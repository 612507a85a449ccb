"""What is due when."""

from __future__ import annotations

import math


class Periodic:
    """A grid of due times; what was missed is left out, never made up for.

    Args:
        period_s: Time from one to the next [s].
        phase_s: Time of the first [s].
    """

    def __init__(self, period_s: float, *, phase_s: float = 0.0) -> None:
        self._period = period_s
        self._phase = phase_s
        self._done = -1

    def due(self, time_s: float) -> bool:
        """Tell, once for each due time, that it has been reached; of several that have passed, once.

        Args:
            time_s: Time since the start [s], rising from call to call.
        """
        # Times are sums of steps: a due time that is missed by rounding is reached.
        reached = math.floor((time_s - self._phase) / self._period + 1e-6)
        if reached <= self._done:
            return False
        self._done = reached
        return True

"""A loop on absolute deadlines: it skips after a hiccup, never bursts, and never drifts."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

SPIN_NS = 150_000
"""The last part of each wait [ns] is spent spinning: a sleep alone wakes about 0.1 ms late."""


@dataclass(frozen=True, slots=True)
class Beat:
    """One tick of the loop.

    Attributes:
        deadline_ns: When it was due, monotonic.
        now_ns: When it began, monotonic.
        overrun_ns: How far the loop was behind, beyond a whole period; 0 on time.
        skipped: Ticks left out just before this one.
    """

    deadline_ns: int
    now_ns: int
    overrun_ns: int
    skipped: int


class FixedRateLoop:
    """Calls ``tick`` at a fixed rate, and ``idle`` once between ticks.

    Deadlines lie on a fixed grid. A tick that ends after the next deadline, or a wake-up that comes a whole
    period late, is an overrun: the deadlines that have passed are skipped, and the next beat says so.

    Args:
        period_ns: Time from tick to tick [ns].
        spin_ns: How long before a deadline the sleep ends and the spinning begins [ns].
    """

    def __init__(self, period_ns: int, *, spin_ns: int = SPIN_NS) -> None:
        self.period_ns = period_ns
        self._spin_ns = min(spin_ns, period_ns // 2)

    def run(
        self,
        tick: Callable[[Beat], None],
        idle: Callable[[int], None],
        running: Callable[[], bool],
    ) -> None:
        """Run until ``running`` says no.

        Args:
            tick: Called at each deadline.
            idle: Called after each tick with the time [ns, monotonic] at which it should have returned.
            running: Asked before each tick.
        """
        period = self.period_ns
        deadline = time.monotonic_ns() + period
        while running():
            self._wait(deadline)
            now = time.monotonic_ns()
            behind = (now - deadline) // period
            overrun = now - deadline - period if behind > 0 else 0
            deadline += behind * period
            tick(Beat(deadline, now, max(overrun, 0), behind))
            deadline += period
            idle(deadline - self._spin_ns)

    def _wait(self, deadline: int) -> None:
        remaining = deadline - self._spin_ns - time.monotonic_ns()
        if remaining > 0:
            time.sleep(remaining * 1e-9)
        while time.monotonic_ns() < deadline:
            pass

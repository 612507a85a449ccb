"""What limited the speed lately goes on limiting it for as long as a zone does."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from msgspec import Struct

T = TypeVar("T")


class Least(Struct, Generic[T], frozen=True, kw_only=True, eq=False):
    """The least share of some ticks.

    Attributes:
        share: σ, 0 to 1.
        cause: What limited it; ``None`` where nothing did.
    """

    share: float
    cause: T | None


class LeastHeld(Generic[T]):
    """The least of the last ``recovery_ticks`` ticks: ``ZoneMachine`` for a number.

    A smaller share counts in its own tick, a greater one only when no tick of the window was below it. The
    zone of the least share is then the most severe zone of the same ticks. Before the first tick it is 0.
    """

    def __init__(self, recovery_ticks: int) -> None:
        self._window = recovery_ticks
        self._tick = 0
        # Of each tick that is still the least of all since: when it leaves the window, and what it said.
        self._rising: deque[tuple[int, Least[T]]] = deque([(recovery_ticks, Least(share=0.0, cause=None))])

    def step(self, now: Least[T]) -> Least[T]:
        """Take this tick's share; return the least one that holds."""
        self._tick += 1
        while self._rising and self._rising[-1][1].share >= now.share:
            self._rising.pop()
        self._rising.append((self._tick + self._window, now))
        while self._rising[0][0] <= self._tick:
            self._rising.popleft()
        return self._rising[0][1]

"""What one method did in one scene of ``bench.avoidance``."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any


@dataclass(slots=True, kw_only=True)
class Outcome:
    """What one method did in one scene.

    Attributes:
        number: Of the scene.
        kind: Of the scene.
        method: Its name.
        possible: Whether the planner knows a path past everything that stands.
        blocked: Whether the straight motion is blocked by what stands.
        arrived_s: When the goal was reached for good [s]; None where it was not.
        end: ``arrived``, ``contact``, ``stuck`` (makes no progress) or ``late``.
        contact: ``drove`` into something, or was ``yielding`` less than it could; empty for neither.
        where: Link, obstacle, time, closing speed and what was possible, of the contact.
        retreating: Contacts of an obstacle that came, with a link that retreated as fast as it might.
        helpless: Contacts of an obstacle that came, with a link that had nowhere to go.
        least_m: The least distance until the end [m].
        path: Length of the way in joint space [rad].
        planned: Length of the planner's path [rad]; None where there is none.
        instants: Ticks.
        over: Ticks with a joint faster than its zone allows, by more than 1 %.
        itself: Looks at which the arm touched itself, by the hulls of links that no joint joins.
        goal_m: Distance to the goal at the end [m].
        solve_us: How many ticks took about so long [µs].
        info: What the method has to say.
    """

    number: int
    kind: str
    method: str
    possible: bool
    blocked: bool
    planned: float | None
    arrived_s: float | None = None
    end: str = "late"
    contact: str = ""
    where: str = ""
    retreating: int = 0
    helpless: int = 0
    least_m: float = math.inf
    path: float = 0.0
    instants: int = 0
    over: int = 0
    itself: int = 0
    goal_m: float = math.inf
    solve_us: Counter[float] = field(default_factory=Counter)
    info: dict[str, Any] = field(default_factory=dict)

    @property
    def apart(self) -> int:
        """Contacts that are not the arm's fault."""
        return self.retreating + self.helpless

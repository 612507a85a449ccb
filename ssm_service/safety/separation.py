"""The protective separation distance, term by term, and the speed that a distance allows ([TS15066])."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from ..errors import InputError

WALKING_SPEED_M_S: Final = 1.6
"""Speed at which people are taken to come near, unless it is measured ([ISO13855])."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeparationTerms:
    """The terms of the protective separation distance [m], by their names in [TS15066] 5.5.4.2.3.

    Attributes:
        S_h: The person moves while the robot reacts and stops.
        S_r: The robot moves while it reacts.
        S_s: The robot moves while it stops.
        C: Intrusion distance: how far a part of the body reaches before it is noticed ([ISO13855]).
        Z_d: Uncertainty of the person's position.
        Z_r: Uncertainty of the robot's position.
    """

    S_h: float
    S_r: float
    S_s: float
    C: float
    Z_d: float
    Z_r: float

    @property
    def S_p(self) -> float:
        """The protective separation distance [m]: the sum of all terms."""
        return self.S_h + self.S_r + self.S_s + self.C + self.Z_d + self.Z_r


@dataclass(frozen=True, slots=True, kw_only=True)
class SeparationLaw:
    """What the protective separation distance depends on, the robot's speed aside.

    The robot's speed is *directed*: that of its nearest point towards the person. A robot that moves away
    adds nothing and takes nothing off.

    Attributes:
        human_speed: v_h [m/s].
        reaction_time: T_r [s], from the event to the beginning of the stop.
        stopping_time: T_s [s].
        stopping_gain: Stopping distance for each unit of speed [s]; None: T_s/2, constant deceleration.
            (A maker's stopping distance divided by the speed that it was measured from.)
        intrusion: C [m].
        human_uncertainty: Z_d [m].
        robot_uncertainty: Z_r [m].
    """

    human_speed: float = WALKING_SPEED_M_S
    reaction_time: float
    stopping_time: float
    stopping_gain: float | None = None
    intrusion: float = 0.0
    human_uncertainty: float = 0.0
    robot_uncertainty: float = 0.0

    def __post_init__(self) -> None:
        for name in ("human_speed", "reaction_time", "stopping_time"):
            _require(name, getattr(self, name))
        for name in ("intrusion", "human_uncertainty", "robot_uncertainty"):
            _require(name, getattr(self, name))
        if self.stopping_gain is not None:
            _require("stopping_gain", self.stopping_gain)
        if not self.reaction_time + self.stopping_time > 0.0:
            raise InputError(
                "out_of_range", "reaction_time", self.reaction_time, "above 0 with stopping_time"
            )

    @property
    def gain(self) -> float:
        """Stopping distance for each unit of speed [s]."""
        return 0.5 * self.stopping_time if self.stopping_gain is None else self.stopping_gain

    def terms(self, robot_speed: float) -> SeparationTerms:
        """Return the terms at a directed speed of the robot, S_p = S_h + S_r + S_s + C + Z_d + Z_r.

        Args:
            robot_speed: v_r [m/s], positive towards the person.

        Raises:
            InputError: ``not_finite``.
        """
        if not math.isfinite(robot_speed):
            raise InputError("not_finite", "robot_speed", robot_speed, "a finite number")
        towards = max(robot_speed, 0.0)
        return SeparationTerms(
            S_h=self.human_speed * (self.reaction_time + self.stopping_time),
            S_r=towards * self.reaction_time,
            S_s=towards * self.gain,
            C=self.intrusion,
            Z_d=self.human_uncertainty,
            Z_r=self.robot_uncertainty,
        )

    def greatest_speed(self, distance: float) -> float:
        """Return the greatest closing speed [m/s] at which S_p is not above the distance.

        Args:
            distance: [m]; a distance that is not a number allows nothing.

        Returns:
            0 where no speed does: a protective stop. Infinite only for an infinite distance.
        """
        spare = distance - self.terms(0.0).S_p
        if not spare > 0.0:
            return 0.0
        each = self.reaction_time + self.gain
        return spare / each if each > 0.0 else math.inf


def _require(name: str, value: float) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError("out_of_range", name, value, "a finite number, 0 or more")

"""The reaction time, term by term: from an event to the beginning of the stop."""

from __future__ import annotations

from msgspec import Struct

from ..config import ReactionConfig


class ReactionTime(Struct, frozen=True, kw_only=True):
    """T_r of what one source sees [s] ([TS15066] 5.5.4.2.3): how old the world is when the robot reacts.

    Attributes:
        sensor_period: Between two measurements an event waits to be seen.
        input_age: Upper bound of the age of the oldest input used.
        tick: The decision waits for its tick, and is made.
        transport: From the service to the robot.
        robot: From the arrival of a command to the beginning of the stop.
    """

    sensor_period: float
    input_age: float
    tick: float
    transport: float
    robot: float

    @property
    def total(self) -> float:
        """T_r [s], the sum of all terms."""
        return self.sensor_period + self.input_age + self.tick + self.transport + self.robot

    def terms(self) -> dict[str, float]:
        """Return all terms and their ``total`` by name [s]."""
        return {
            "sensor_period": self.sensor_period,
            "input_age": self.input_age,
            "tick": self.tick,
            "transport": self.transport,
            "robot": self.robot,
            "total": self.total,
        }

    @classmethod
    def of(
        cls,
        config: ReactionConfig,
        *,
        sensor_period_s: float,
        input_age_s: float,
        tick_s: float,
        transport_s: float,
    ) -> ReactionTime:
        """Return the terms from what is configured and what was measured.

        Args:
            config: The robot's own time; the transport, which a measured one may only lengthen.
            sensor_period_s: See ``sensor_period``.
            input_age_s: See ``input_age``.
            tick_s: See ``tick``.
            transport_s: The longest that was measured; 0 where nothing was.
        """
        return cls(
            sensor_period=sensor_period_s,
            input_age=input_age_s,
            tick=tick_s,
            transport=max(config.transport_s, transport_s),
            robot=config.robot_s,
        )

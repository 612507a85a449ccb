"""The in-memory twin: world and monitor tick by tick, without a clock or a network."""

from __future__ import annotations

from dataclasses import dataclass

from ..model import Robot
from ..monitor import Decision, Inputs, Monitor, Received
from .plant import DEFAULT_TIME_CONSTANT_S
from .scenario import Scenario
from .world import Emitted, World


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryTick:
    """One tick.

    Attributes:
        time_s: Time of the world [s].
        inputs: What the monitor was given.
        decision: What it decided; the plant obeys it from here to the next tick.
    """

    time_s: float
    inputs: Inputs
    decision: Decision


class MemoryRun:
    """Simulation and monitor in one process: messages arrive at once, commands are obeyed at once.

    The same arguments give the same run, bit for bit.

    Args:
        robot: The robot.
        scenario: The scenario.
        seed: Seed of the sensors' errors.
        profile: Name of the zone profile; the robot's default where left out.
        period_s: Time from tick to tick [s].
        track_obstacles: Whether the monitor is sent the obstacles beside the readings.
        time_constant_s: The plant's lag [s].
    """

    def __init__(
        self,
        robot: Robot,
        scenario: Scenario,
        *,
        seed: int = 0,
        profile: str | None = None,
        period_s: float = 0.002,
        track_obstacles: bool = True,
        time_constant_s: float = DEFAULT_TIME_CONSTANT_S,
    ) -> None:
        self.world = World(
            robot, scenario, seed=seed, track_obstacles=track_obstacles, time_constant_s=time_constant_s
        )
        self.monitor = Monitor(robot, profile=profile, period_s=period_s)
        self._sources: dict[str, _Held] = {}

    def tick(self) -> MemoryTick:
        """Emit, decide, and let the plant obey until the next tick."""
        world = self.world
        now = world.time_s
        self._take(world.emit(), now)
        inputs = Inputs(
            **{
                name: Received(value=held.value, age_s=now - held.time_s)
                for name, held in self._sources.items()
            }
        )
        decision = self.monitor.step(inputs)
        world.step(decision.velocity, self.monitor.period_s)
        return MemoryTick(time_s=now, inputs=inputs, decision=decision)

    def _take(self, emitted: Emitted, now: float) -> None:
        for name in ("joints", "ranges", "obstacles", "target"):
            value = getattr(emitted, name)
            if value is not None:
                self._sources[name] = _Held(value=value, time_s=now)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Held:
    """The newest value of a source and when it came [s]."""

    value: object
    time_s: float

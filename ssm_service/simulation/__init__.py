"""A robot to talk to: scenarios, a kinematic plant, simulated sensors, in memory or over the network."""

from .memory import MemoryRun, MemoryTick
from .paths import Path3
from .plant import Plant
from .process import Simulation, SimulationOptions, Summary, run_simulation
from .scenario import Scenario, list_scenarios, load_scenario
from .sensors import RangeSensors
from .world import Emitted, World

__all__ = [
    "Emitted",
    "MemoryRun",
    "MemoryTick",
    "Path3",
    "Plant",
    "RangeSensors",
    "Scenario",
    "Simulation",
    "SimulationOptions",
    "Summary",
    "World",
    "list_scenarios",
    "load_scenario",
    "run_simulation",
]

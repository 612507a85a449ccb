"""A robot to talk to: scenarios, a kinematic plant, simulated sensors, in memory or over the network."""

from .load import list_scenarios, load_scenario, scenarios_directory
from .memory import MemoryRun, MemoryTick
from .paths import Path3
from .plant import Plant
from .process import Simulation, SimulationOptions, Summary, run_simulation
from .scenario import Scenario
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
    "scenarios_directory",
]

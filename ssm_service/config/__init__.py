"""Robot files and profiles, read strictly into frozen, validated values."""

from .load import load_robot_config, load_toml, robot_names, robots_directory
from .motion import ClikConfig, ControllerName, FilterConfig, MotionConfig
from .profiles import LatchConfig, ProfileConfig, SeparationConfig, ZoneConfig
from .rings import AssumptionsConfig, RingConfig, SimulatedSensorConfig
from .schema import RobotConfig, RobotFile
from .sources import PlausibilityConfig, SourceConfig, SourcesConfig
from .stopping import ReactionConfig, StoppingConfig, StoppingPoint

__all__ = [
    "AssumptionsConfig",
    "ClikConfig",
    "ControllerName",
    "FilterConfig",
    "LatchConfig",
    "MotionConfig",
    "PlausibilityConfig",
    "ProfileConfig",
    "ReactionConfig",
    "RingConfig",
    "RobotConfig",
    "RobotFile",
    "SeparationConfig",
    "SimulatedSensorConfig",
    "SourceConfig",
    "SourcesConfig",
    "StoppingConfig",
    "StoppingPoint",
    "ZoneConfig",
    "load_robot_config",
    "load_toml",
    "robot_names",
    "robots_directory",
]

"""Robot files and profiles, read strictly into frozen, validated values."""

from .load import load_robot_config, load_toml, robot_names, robots_directory
from .schema import (
    AssumptionsConfig,
    LatchConfig,
    MotionConfig,
    ProfileConfig,
    ReactionConfig,
    RingConfig,
    RobotConfig,
    RobotFile,
    SeparationConfig,
    SimulatedSensorConfig,
    SourceConfig,
    SourcesConfig,
    StoppingConfig,
    StoppingPoint,
    ZoneConfig,
)

__all__ = [
    "AssumptionsConfig",
    "LatchConfig",
    "MotionConfig",
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

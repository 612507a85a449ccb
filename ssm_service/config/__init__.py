"""Robot files and profiles, read strictly into frozen, validated values."""

from .load import load_robot_config, load_toml, robot_names, robots_directory
from .schema import (
    AssumptionsConfig,
    MotionConfig,
    ProfileConfig,
    RingConfig,
    RobotConfig,
    RobotFile,
    SimulatedSensorConfig,
    SourceConfig,
    SourcesConfig,
    ZoneConfig,
)

__all__ = [
    "AssumptionsConfig",
    "MotionConfig",
    "ProfileConfig",
    "RingConfig",
    "RobotConfig",
    "RobotFile",
    "SimulatedSensorConfig",
    "SourceConfig",
    "SourcesConfig",
    "ZoneConfig",
    "load_robot_config",
    "load_toml",
    "robot_names",
    "robots_directory",
]

"""From a target to joint velocities: potential fields, damped inverse, limits. Arrays in, arrays out."""

from .differential import damped_pseudo_inverse
from .field3d import field3d, field3d_as_printed, sensor_steps
from .fields import ObstaclePoint, attractive_force, conventional_field, repulsive_force
from .limiting import limit_velocity
from .targets import position_to_joints, twist_to_joints

__all__ = [
    "ObstaclePoint",
    "attractive_force",
    "conventional_field",
    "damped_pseudo_inverse",
    "field3d",
    "field3d_as_printed",
    "limit_velocity",
    "position_to_joints",
    "repulsive_force",
    "sensor_steps",
    "twist_to_joints",
]

"""From a target to joint velocities: fields, inverse kinematics, limits. Arrays in, arrays out."""

from .barrier import Box, approach_speeds, barrier_bounds, contact_bounds, softness, velocity_box
from .changeover import Changeover
from .circulation import Circulation
from .clik import Critical, activation, avoidance_velocity, clik_velocity, influence_radius, pose_error
from .differential import damped_pseudo_inverse
from .field3d import field3d, field3d_as_printed, sensor_steps
from .fields import ObstaclePoint, attractive_force, conventional_field, repulsive_force
from .filter import Filtered, VelocityFilter, task_metric
from .limiting import limit_velocity
from .lspb import LineSegmentParabolicBlend, lspb_speed
from .segments import (
    Closest,
    CriticalSegment,
    LinkSegments,
    closest_on_segments,
    link_segments,
    most_critical,
)
from .targets import field_velocity, linear_to_joints, twist_to_joints
from .tracking import angular_approach, linear_approach, rotation_of

__all__ = [
    "Box",
    "Changeover",
    "Circulation",
    "Closest",
    "Critical",
    "CriticalSegment",
    "Filtered",
    "LineSegmentParabolicBlend",
    "LinkSegments",
    "ObstaclePoint",
    "VelocityFilter",
    "activation",
    "angular_approach",
    "approach_speeds",
    "attractive_force",
    "avoidance_velocity",
    "barrier_bounds",
    "clik_velocity",
    "closest_on_segments",
    "contact_bounds",
    "conventional_field",
    "damped_pseudo_inverse",
    "field3d",
    "field3d_as_printed",
    "field_velocity",
    "influence_radius",
    "limit_velocity",
    "linear_approach",
    "linear_to_joints",
    "link_segments",
    "lspb_speed",
    "most_critical",
    "pose_error",
    "repulsive_force",
    "rotation_of",
    "sensor_steps",
    "softness",
    "task_metric",
    "twist_to_joints",
    "velocity_box",
]

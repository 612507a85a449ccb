"""What there is: the robot, its sensor rings, obstacles, and the exact distances between them."""

from .closing import closing_gradients, moved_by, outermost_points, point_jacobians
from .distance import ClosestPair, DistanceModel
from .kinematics import Kinematics
from .link_distance import LinkDistance
from .pairs import Pairs
from .person import person
from .rings import Ring, SensorArray
from .robot import Robot
from .shapes import Obstacle

__all__ = [
    "ClosestPair",
    "DistanceModel",
    "Kinematics",
    "LinkDistance",
    "Obstacle",
    "Pairs",
    "Ring",
    "Robot",
    "SensorArray",
    "closing_gradients",
    "moved_by",
    "outermost_points",
    "person",
    "point_jacobians",
]

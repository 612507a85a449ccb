"""What there is: the robot, its sensor rings, obstacles, and the exact distances between them."""

from .distance import ClosestPair, DistanceModel
from .kinematics import Kinematics
from .link_distance import LinkDistance
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
    "Ring",
    "Robot",
    "SensorArray",
    "person",
]

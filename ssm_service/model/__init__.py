"""What there is: the robot, its sensor rings, obstacles, and the exact distances between them."""

from .distance import ClosestPair, DistanceModel
from .kinematics import Kinematics
from .rings import Ring, SensorArray
from .robot import Robot
from .shapes import Obstacle

__all__ = [
    "ClosestPair",
    "DistanceModel",
    "Kinematics",
    "Obstacle",
    "Ring",
    "Robot",
    "SensorArray",
]

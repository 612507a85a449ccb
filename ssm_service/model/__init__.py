"""What there is: the robot, its sensor rings, obstacles, and the exact distances between them."""

from .distance import ClosestPair, DistanceModel
from .rings import Ring
from .robot import Kinematics, Robot
from .shapes import Obstacle

__all__ = ["ClosestPair", "DistanceModel", "Kinematics", "Obstacle", "Ring", "Robot"]

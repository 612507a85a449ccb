"""What there is: the robot, its sensor rings, obstacles, and the exact distances between them."""

from .rings import Ring
from .robot import Kinematics, Robot
from .shapes import Obstacle

__all__ = ["Kinematics", "Obstacle", "Ring", "Robot"]

"""How fast any point of the arm can be, in whatever configuration."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..model import Robot


def lever_arms(robot: Robot) -> NDArray[np.float64]:
    """Return how much speed each joint can give any monitored point at most, (n,) [m/s per unit of speed].

    For a turning joint it is the greatest distance from its origin, with the chain laid out straight: the
    lengths from each free joint's origin to the next one's, and from the last one's to the far side of a ball
    round the link's geometry. What stands between two free joints is rigid. A sliding joint moves everything
    beyond it at its own speed, 1, and lengthens the chain by its travel. A locked joint gives none, 0.
    """
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, robot.pinocchio_configuration(robot.rest_position))
    arms = np.zeros(len(robot.joint_names))
    for link in robot.monitored_links:
        for index in robot.geometry_of_link[link]:
            item = robot.collision.geometryObjects[index]
            item.geometry.computeLocalAABB()
            pose = data.oMi[item.parentJoint] * item.placement
            end, length = pose.act(np.array(item.geometry.aabb_center)), float(item.geometry.aabb_radius)
            for joint in reversed(list(model.supports[item.parentJoint])[1:]):
                if joint - 1 not in robot.free:
                    continue
                origin = data.oMi[joint].translation
                length += float(np.linalg.norm(end - origin))
                end = origin
                slides = "P" in model.joints[joint].shortname()
                arms[joint - 1] = max(arms[joint - 1], 1.0 if slides else length)
                if slides:
                    length += float(robot.position_upper[joint - 1] - robot.position_lower[joint - 1])
    return arms


def greatest_speed(robot: Robot, joint_speed: float) -> float:
    """Return the greatest speed that any monitored point can have [m/s], all free joints at once.

    Args:
        robot: The robot.
        joint_speed: Limit for every joint [rad/s or m/s], below which a joint's own may lie.
    """
    return float(lever_arms(robot) @ np.minimum(robot.velocity_limit, joint_speed))

"""With `filter` a ball in the straight way is gone round; with `field` the arm stays in front of it."""

from __future__ import annotations

import numpy as np
import pytest

from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.monitor import Inputs, JointSample, Monitor, Received, checked_target

DT = 0.02
MARGIN = 0.03
START = np.array([0.0, -1.0, 1.5, 0.0, 0.0, 0.0])
TURNED = np.array([1.2, -1.0, 1.5, 0.0, 0.0, 0.0])


def go(robot: Robot, method: str, seconds: float, height: float):
    """Return what is left of the way [m], and how much nearer than the margin it came [m].

    The ball is in the middle of the way.
    """
    start = robot.kinematics(START).transform_end_effector_to_base[:3, 3]
    goal = robot.kinematics(TURNED).transform_end_effector_to_base[:3, 3]
    centre = 0.5 * (start + goal) + [0.0, 0.0, height]
    ball = Obstacle(id="ball", shape="sphere", size=(0.05,), position=tuple(centre), velocity=(0.0, 0.0, 0.0))
    monitor, position = Monitor(robot, period_s=DT), START.copy()
    distances = DistanceModel(robot)
    distances.set_obstacles((ball,))
    target = checked_target(robot, "position", goal.tolist(), method)
    begin = least = distances.nearest(position).distance
    obstacles = (ball,)
    for _ in range(round(seconds / DT)):
        decision = monitor.step(
            Inputs(
                joints=Received(value=JointSample(position=position.copy(), velocity=np.zeros(6)), age_s=0.0),
                ranges=Received(value=np.full(8, np.inf), age_s=0.0),
                obstacles=Received(value=obstacles, age_s=0.0),
                target=Received(value=target, age_s=0.0),
            )
        )
        position = position + decision.velocity * DT
        least = min(least, distances.nearest(position).distance)
    end = robot.kinematics(position).transform_end_effector_to_base[:3, 3]
    return float(np.linalg.norm(end - goal)), least - min(begin, MARGIN)


@pytest.mark.parametrize("height", [0.0, -0.02])
def test_it_goes_round_what_the_field_stops_at(robot, height):
    left, nearer = go(robot, "filter", 16.0, height)
    assert left < 0.005
    assert nearer > -1e-3
    assert go(robot, "field", 8.0, height)[0] > 0.05

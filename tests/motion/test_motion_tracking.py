"""A frame under the approach velocities arrives, straight and the shorter way, and never too fast."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssm_service.config import MotionConfig
from ssm_service.errors import InputError
from ssm_service.motion import angular_approach, linear_approach, rotation_of

CONFIG = MotionConfig(speed_m_s=0.2, rotation_speed_rad_s=0.4, approach_gain=3.0)
DT = 0.01


def turned(rotation, velocity, dt=DT):
    """Turn a frame by an angular velocity in the base frame."""
    return Rotation.from_rotvec(velocity * dt).as_matrix() @ rotation


def test_a_point_arrives_on_a_straight_line_and_no_faster_than_configured():
    start, goal = np.array([0.1, -0.3, 0.2]), np.array([0.4, 0.2, 0.5])
    line = (goal - start) / np.linalg.norm(goal - start)
    point, seconds = start, 0.0
    while np.linalg.norm(goal - point) > CONFIG.arrival_tolerance_m:
        velocity = linear_approach(point, goal, CONFIG)
        assert np.linalg.norm(velocity) <= CONFIG.speed_m_s * (1 + 1e-12)
        point, seconds = point + velocity * DT, seconds + DT
        off = (point - start) - line * ((point - start) @ line)
        np.testing.assert_allclose(off, 0.0, atol=1e-12)
        assert seconds < 10.0
    assert not linear_approach(goal, goal, CONFIG).any()


@pytest.mark.parametrize("angle", [1e-3, 0.5, 2.0, math.pi - 1e-9, math.pi])
def test_a_frame_turns_the_shorter_way_in_the_time_that_its_speed_gives(angle):
    axis = np.array([0.6, 0.0, 0.8])
    goal = Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix()
    rotation = Rotation.from_rotvec(axis * angle).as_matrix() @ goal
    left, seconds = angle, 0.0
    while left > 1e-5:
        velocity = angular_approach(rotation, goal, CONFIG)
        assert np.linalg.norm(velocity) <= CONFIG.rotation_speed_rad_s * (1 + 1e-12)
        rotation, seconds = turned(rotation, velocity), seconds + DT
        now = Rotation.from_matrix(goal @ rotation.T).magnitude()
        assert now < left
        left = now
    near = CONFIG.rotation_speed_rad_s / CONFIG.approach_gain
    closed_form = max(angle - near, 0.0) / CONFIG.rotation_speed_rad_s
    closed_form += math.log(min(angle, near) / 1e-5) / -math.log1p(-CONFIG.approach_gain * DT) * DT
    assert seconds == pytest.approx(closed_form, abs=3 * DT)


def test_a_frame_that_is_there_stands_still():
    goal = Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix()
    assert not angular_approach(goal, goal, CONFIG).any()


def test_the_same_turn_seen_from_another_base_is_the_same_turn():
    rng = np.random.default_rng(3)
    for _ in range(20):
        here, goal, base = (Rotation.random(rng=rng).as_matrix() for _ in range(3))
        expected = base @ angular_approach(here, goal, CONFIG)
        np.testing.assert_allclose(angular_approach(base @ here, base @ goal, CONFIG), expected, atol=1e-9)


def test_a_quaternion_is_read_x_y_z_w():
    half = math.sqrt(0.5)
    np.testing.assert_allclose(
        rotation_of(np.array([0, 0, half, half])), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15
    )


def test_a_goal_that_is_no_number_is_refused():
    with pytest.raises(InputError, match="finite numbers"):
        linear_approach(np.zeros(3), np.array([0.0, math.nan, 0.0]), CONFIG)

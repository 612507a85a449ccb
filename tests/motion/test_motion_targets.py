import math

import numpy as np
import pytest

from ssm_service.config import MotionConfig
from ssm_service.errors import InputError
from ssm_service.motion import (
    ObstaclePoint,
    conventional_field,
    damped_pseudo_inverse,
    field3d,
    field_velocity,
    linear_to_joints,
    sensor_steps,
    twist_to_joints,
)

CONFIG = MotionConfig()
FIELD3D = MotionConfig(controller="field3d")
THREE, SIX = np.array([0, 2, 3]), np.array([0, 1, 2, 4, 5, 6])


def position_to_joints(position, goal, jacobian, free, config, n, **seen):
    """The joint velocities of the configured field, as the service puts its two steps together."""
    velocity = field_velocity(position, goal, config, controller=config.controller, **seen)
    return linear_to_joints(jacobian, free, velocity, config, n)


def jacobian(n, seed=0):
    return np.random.default_rng(seed).normal(size=(6, n))


def arm(q):
    """End effector of a 3-joint arm like the UR3's and its Jacobian, by [Kang2022] (7)–(10)."""
    l1, l2, l3 = 0.1519, 0.24365, 0.21325
    t1, t2, t3 = q[0], -q[1], q[2]
    reach = l3 * math.cos(t2 - t3) + l2 * math.cos(t2)
    down2 = -l3 * math.sin(t2 - t3) - l2 * math.sin(t2)
    c1, s1 = math.cos(t1), math.sin(t1)
    place = np.array([c1 * reach, s1 * reach, l1 + l2 * math.sin(t2) + l3 * math.sin(t2 - t3)])
    d2 = np.array([c1 * down2, s1 * down2, reach])
    d3 = l3 * np.array([c1 * math.sin(t2 - t3), s1 * math.sin(t2 - t3), -math.cos(t2 - t3)])
    return place, np.stack([[-s1 * reach, c1 * reach, 0.0], -d2, d3], axis=1)


def test_six_free_joints_track_the_whole_twist_and_the_others_stay():
    rng = np.random.default_rng(1)
    for seed in range(20):
        full, twist = jacobian(7, seed), rng.normal(size=6)
        joints = twist_to_joints(full, SIX, twist, CONFIG, 7)
        assert joints[3] == 0.0
        if np.linalg.svd(full[:, SIX])[1][-1] > CONFIG.singular_value_threshold:
            np.testing.assert_allclose(full @ joints, twist, atol=1e-9)


def test_fewer_free_joints_track_the_linear_part_and_the_others_stay():
    full, twist = jacobian(5), np.array([0.1, -0.2, 0.05, 0.0, 0.0, 0.0])
    joints = twist_to_joints(full, THREE, twist, CONFIG, 5)
    np.testing.assert_allclose((full @ joints)[:3], twist[:3], atol=1e-12)
    assert not joints[[1, 4]].any()
    two = twist_to_joints(full, THREE[:2], twist, CONFIG, 5)
    best = np.linalg.lstsq(full[:3, THREE[:2]], twist[:3], rcond=None)[0]
    np.testing.assert_allclose(two[THREE[:2]], best, atol=1e-12)


@pytest.mark.parametrize("row", [3, 4, 5])
def test_a_rotation_that_cannot_be_tracked_is_refused(row):
    twist = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    twist[row] = 1e-9
    with pytest.raises(InputError) as caught:
        twist_to_joints(jacobian(5), THREE, twist, CONFIG, 5)
    assert caught.value.cause == "unsupported_twist"


@pytest.mark.parametrize(
    ("twist", "cause"),
    [
        (np.array([0.0, math.nan, 0, 0, 0, 0]), "not_finite"),
        (np.array([0.0, 0, 0, 0, 0, math.inf]), "not_finite"),
        (np.zeros(5), "wrong_length"),
    ],
)
def test_refuses_a_twist_without_meaning(twist, cause):
    for free in (THREE, SIX):
        with pytest.raises(InputError) as caught:
            twist_to_joints(jacobian(7), free, twist, CONFIG, 7)
        assert caught.value.cause == cause


def test_position_is_the_chosen_field_through_the_damped_inverse():
    rng = np.random.default_rng(2)
    position, goal = rng.uniform(-0.4, 0.4, (2, 3))
    rows = jacobian(5)[:3, THREE]
    obstacle = ObstaclePoint(distance=0.1, direction=np.array([0.0, 0.6, 0.8]))
    inverse = damped_pseudo_inverse(
        rows, threshold=CONFIG.singular_value_threshold, max_damping=CONFIG.max_damping
    )
    joints = position_to_joints(position, goal, rows, THREE, CONFIG, 5, obstacle=obstacle)
    expected = inverse @ conventional_field(position, goal, obstacle, CONFIG)
    np.testing.assert_allclose(joints[THREE], expected, atol=1e-14)
    assert not joints[[1, 4]].any()

    transforms, ranges = np.stack([np.eye(4)] * 4), np.array([0.1, math.inf, 0.2, math.inf])
    for steps in (None, sensor_steps([1, 3])):
        joints = position_to_joints(
            position,
            goal,
            rows,
            THREE,
            FIELD3D,
            5,
            transforms_sensor_to_base=transforms,
            ranges=ranges,
            steps=steps,
        )
        expected = inverse @ field3d(position, goal, transforms, ranges, FIELD3D, steps)
        np.testing.assert_allclose(joints[THREE], expected, atol=1e-14)


def test_the_3d_field_without_readings_does_not_move():
    rows = jacobian(5)[:3, THREE]
    joints = position_to_joints(np.zeros(3), np.ones(3), rows, THREE, FIELD3D, 5)
    assert joints.shape == (5,)
    assert not joints.any()


@pytest.mark.parametrize("where", ["position", "goal"])
def test_refuses_a_place_without_meaning(where):
    for bad, cause in ((np.array([0.0, math.nan, 0.0]), "not_finite"), (np.zeros(2), "wrong_length")):
        places = {"position": np.zeros(3), "goal": np.ones(3), where: bad}
        with pytest.raises(InputError) as caught:
            position_to_joints(**places, jacobian=jacobian(3)[:3], free=np.arange(3), config=CONFIG, n=3)
        assert (caught.value.cause, caught.value.where) == (cause, where)


@pytest.mark.parametrize("dt", [0.002, 0.02])
def test_an_arm_reaches_its_goals_and_rests(dt):
    rng = np.random.default_rng(3)
    for _ in range(4):
        q = np.array([0.0, -0.8, 1.6]) + rng.uniform(-0.4, 0.4, 3)
        goal = arm(np.array([0.3, -1.0, 1.5]) + rng.uniform(-0.3, 0.3, 3))[0]
        for _ in range(int(9.0 / dt)):
            place, rows = arm(q)
            velocity = position_to_joints(place, goal, rows, np.arange(3), CONFIG, 3)
            q = q + dt * velocity
        assert np.linalg.norm(arm(q)[0] - goal) <= CONFIG.arrival_tolerance_m + 1e-6
        assert not velocity.any()


def test_closed_form_of_this_test_is_consistent():
    rng = np.random.default_rng(4)
    for q in rng.uniform(-3, 3, (20, 3)):
        numeric = np.stack([(arm(q + e)[0] - arm(q - e)[0]) / 2e-6 for e in 1e-6 * np.eye(3)], axis=1)
        np.testing.assert_allclose(arm(q)[1], numeric, atol=1e-8)


def test_commands_do_not_jump_while_the_elbow_passes_its_singularity():
    """Twice as fine a sweep halves the greatest change between neighbours, and the speed stays bounded."""
    changes = []
    for count in (2001, 4001, 8001):
        commands = []
        for elbow in np.linspace(-0.3, 0.3, count):
            place, rows = arm(np.array([0.2, -0.9, elbow]))
            goal = place + np.array([0.2, 0.1, -0.3])
            commands.append(position_to_joints(place, goal, rows, np.arange(3), CONFIG, 3))
        changes.append(np.linalg.norm(np.diff(commands, axis=0), axis=1).max())
        bound = CONFIG.speed_m_s / CONFIG.singular_value_threshold
        assert np.linalg.norm(commands, axis=1).max() <= bound * (1 + 1e-9)
    assert changes[1] < 0.6 * changes[0]
    assert changes[2] < 0.6 * changes[1]

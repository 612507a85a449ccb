"""The UR5e hung upside down: its URDF against the maker's Denavit-Hartenberg table."""

from __future__ import annotations

import itertools
import math

import coal
import numpy as np
import pytest

from ssm_service.model import DistanceModel, Obstacle, Robot

A = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
D = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
TOOL_DOWN = np.array([0.9, -1.2, 1.6, -1.97, math.pi / 2, 0.0])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.load("ur5e")


def published(q: np.ndarray) -> np.ndarray:
    """The pose of the tool's end in the world: mounting, the maker's table, tool."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.diag(
        [-1.0, -1.0, 1.0, 1.0]
    )  # upside down; REP-103's half turn
    pose[2, 3] = 1.90
    for theta, a, d, alpha in zip(q, A, D, ALPHA, strict=True):
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        pose = pose @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0.0, sa, ca, d], [0.0, 0.0, 0.0, 1.0]]
        )
    tool = np.eye(4)
    tool[2, 3] = 0.205
    return pose @ tool


def test_the_pose_is_that_of_the_published_table(robot: Robot) -> None:
    rng = np.random.default_rng(1)
    for q in rng.uniform(-2.0 * math.pi, 2.0 * math.pi, (100, 6)):
        found = robot.kinematics(q).transform_end_effector_to_base
        np.testing.assert_allclose(found, published(q), atol=1e-12)


def test_the_jacobian_is_the_derivative_of_the_published_table(robot: Robot) -> None:
    rng = np.random.default_rng(2)
    for q in rng.uniform(-3.0, 3.0, (20, 6)):
        jacobian = robot.kinematics(q).jacobian_full
        for joint in range(6):
            step = 1e-6 * np.eye(6)[joint]
            rate = (published(q + step) - published(q - step)) / 2e-6
            spin = rate[:3, :3] @ published(q)[:3, :3].T
            angular = [spin[2, 1], spin[0, 2], spin[1, 0]]
            np.testing.assert_allclose(jacobian[:, joint], [*rate[:3, 3], *angular], atol=1e-8)


def test_all_six_joints_are_free_within_the_data_sheets_limits(robot: Robot) -> None:
    assert robot.free.tolist() == list(range(6))
    np.testing.assert_allclose(robot.velocity_limit, math.pi)
    np.testing.assert_allclose(robot.position_lower, -2.0 * math.pi)
    np.testing.assert_allclose(robot.position_upper, 2.0 * math.pi)
    assert robot.sensor_count == 0
    sources = robot.config.file.sources
    assert (sources.obstacles.required, sources.ranges.required) == (True, False)


def test_every_moving_part_has_a_shape_and_capsules_are_capsules(robot: Robot) -> None:
    assert robot.monitored_links == (
        "base_link",
        "shoulder_link",
        "upper_arm_link",
        "forearm_link",
        "wrist_1_link",
        "wrist_2_link",
        "wrist_3_link",
        "tool",
    )
    kinds = {item.name: type(item.geometry) for item in robot.collision.geometryObjects}
    flat = {"base_link_0", "wrist_3_link_0", "tool_0"}
    assert {name for name, kind in kinds.items() if kind is coal.Cylinder} == flat
    assert {kind for name, kind in kinds.items() if name not in flat} == {coal.Capsule}


def test_the_arm_is_one_piece(robot: Robot) -> None:
    """Each joint's axis lies inside the shapes on both of its sides: no gap that an obstacle could enter."""
    links = list(robot.monitored_links)
    for q in np.random.default_rng(3).uniform(-3.0, 3.0, (5, 6)):
        poses, model = robot.link_transforms(q), DistanceModel(robot)
        for before, after in itertools.pairwise(links):
            model.set_obstacles(
                [Obstacle(id="o", shape="sphere", size=(0.045,), position=tuple(poses[after][:3, 3]))]
            )
            for link in (before, after):
                found = model.nearest(q, link)
                assert found is not None
                assert found.distance < 0.02, (link, after)


def test_distance_below_a_tool_that_points_down(robot: Robot) -> None:
    pose = robot.kinematics(TOOL_DOWN).transform_end_effector_to_base
    np.testing.assert_allclose(pose[:3, 2], [0.0, 0.0, -1.0], atol=1e-2)
    below = pose[:3, 3] + 0.2 * pose[:3, 2]
    model = DistanceModel(robot)
    model.set_obstacles([Obstacle(id="ball", shape="sphere", size=(0.05,), position=tuple(below))])
    nearest = model.nearest(TOOL_DOWN)
    assert nearest is not None
    assert nearest.link == "tool"
    assert nearest.distance == pytest.approx(0.15, abs=1e-6)

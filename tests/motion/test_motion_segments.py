"""Closest points on links' segments: the paper's three cases, Coal, and finite differences."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from ssm_service.errors import InputError
from ssm_service.model import Robot
from ssm_service.motion import closest_on_segments, link_segments, most_critical

URDF = """<robot name="arm">
<link name="base"/><link name="upper">{upper}</link><link name="fore">{fore}</link><link name="tip"/>
<joint name="one" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<origin xyz="0 0 0.1" rpy="0 0.3 0"/><limit lower="-3" upper="3" velocity="2" effort="1"/></joint>
<joint name="two" type="revolute"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
<origin xyz="0 0 0.4" rpy="0.2 0 0"/><limit lower="-3" upper="3" velocity="2" effort="1"/></joint>
<joint name="three" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="0 0 0.3"/></joint>
</robot>"""
CYLINDER = """<collision><origin xyz="0.02 0 0.2" rpy="0 0.1 0"/>
<geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>"""
BALL = """<collision><origin xyz="0 0.01 0.3"/><geometry><sphere radius="0.06"/></geometry></collision>"""
BOX = """<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>"""
FILE = """urdf = "arm.urdf"
end_effector_frame = "tip"
default_profile = "one"
[sources]
ranges = { required = false, timeout_s = 0.4 }
obstacles = { required = true, timeout_s = 0.25 }
[profiles.one]
red = { distance_m = 0.2, joint_speed_rad_s = 0.1, speed_scaling = 0.1 }
yellow = { distance_m = 0.4, joint_speed_rad_s = 0.3, speed_scaling = 0.4 }
"""


def arm(folder: Path, upper: str = CYLINDER, fore: str = CYLINDER + BALL) -> Robot:
    (folder / "arm.urdf").write_text(URDF.format(upper=upper, fore=fore), encoding="utf-8")
    (folder / "arm.toml").write_text(FILE, encoding="utf-8")
    return Robot.load(folder / "arm.toml")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return arm(tmp_path_factory.mktemp("arm"))


def paper(p: np.ndarray, d: np.ndarray, o: np.ndarray) -> tuple[str, float, float]:
    """Equations (4) to (6), literally: the case, d_o and x."""
    d_l, d_p, d_d = d - p, o - p, o - d
    length, first, second = (float(np.linalg.norm(v)) for v in (d_l, d_p, d_d))
    cos_alpha, cos_beta = d_l @ d_p / (length * first), -d_l @ d_d / (length * second)
    if cos_beta < 0.0:
        return "distal", second, 1.0
    if cos_alpha < 0.0:
        return "proximal", first, 0.0
    return "between", float(np.linalg.norm(np.cross(d_l, d_p))) / length, first * cos_alpha / length


def test_the_three_cases_are_those_of_the_paper() -> None:
    rng = np.random.default_rng(1)
    proximal, distal, centres = rng.normal(size=(3, 400, 3))
    found = closest_on_segments(proximal, distal, centres)
    seen = {"distal": 0, "proximal": 0, "between": 0}
    for i, ends in enumerate(zip(proximal, distal, centres, strict=True)):
        case, distance, fraction = paper(*ends)
        seen[case] += 1
        assert found.distance[i] == pytest.approx(distance, abs=1e-12)
        assert found.fraction[i] == pytest.approx(fraction, abs=1e-12)
        along = ends[0] + fraction * (ends[1] - ends[0])
        np.testing.assert_allclose(found.point[i], along, atol=1e-12)
    assert min(seen.values()) > 50


def test_no_point_of_the_segment_is_nearer_and_coal_agrees() -> None:
    rng = np.random.default_rng(2)
    proximal, distal, centres = rng.normal(size=(3, 100, 3))
    found = closest_on_segments(proximal, distal, centres)
    shares = np.linspace(0.0, 1.0, 201)[:, np.newaxis, np.newaxis]
    sampled = np.linalg.norm(proximal + shares * (distal - proximal) - centres, axis=-1).min(axis=0)
    assert (found.distance <= sampled + 1e-12).all()
    assert (sampled - found.distance).max() < 0.01
    for p, d, o, distance in zip(proximal, distal, centres, found.distance, strict=True):
        along = d - p
        placed = pin.SE3(
            pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix(), (p + d) / 2
        )
        capsule, ball = coal.Capsule(0.01, float(np.linalg.norm(along))), coal.Sphere(0.02)
        result = coal.DistanceResult()
        coal.distance(
            capsule,
            coal.Transform3s(placed.rotation, placed.translation),
            ball,
            coal.Transform3s(np.eye(3), o),
            coal.DistanceRequest(),
            result,
        )
        if result.min_distance > 1e-3:
            assert distance - 0.03 == pytest.approx(result.min_distance, abs=1e-5)


def test_moving_and_swapping_changes_nothing_else() -> None:
    rng = np.random.default_rng(3)
    p, d, o = rng.normal(size=(3, 50, 3))
    here = closest_on_segments(p, d, o)
    motion = pin.SE3.Random()
    turned = [points @ motion.rotation.T + motion.translation for points in (p, d, o)]
    there = closest_on_segments(*turned)
    np.testing.assert_allclose(there.distance, here.distance, atol=1e-12)
    np.testing.assert_allclose(there.fraction, here.fraction, atol=1e-10)
    back = closest_on_segments(d, p, o)
    np.testing.assert_allclose(back.fraction, 1.0 - here.fraction, atol=1e-10)
    np.testing.assert_allclose(back.point, here.point, atol=1e-10)


def test_every_segment_with_every_centre_in_one_call() -> None:
    rng = np.random.default_rng(4)
    p, d, o = rng.normal(size=(4, 3)), rng.normal(size=(4, 3)), rng.normal(size=(5, 3))
    found = closest_on_segments(p[:, np.newaxis], d[:, np.newaxis], o)
    assert found.point.shape == (4, 5, 3)
    for i in range(4):
        for j in range(5):
            assert found.distance[i, j] == pytest.approx(closest_on_segments(p[i], d[i], o[j]).distance)


def test_a_segment_without_length_is_a_point() -> None:
    found = closest_on_segments(np.ones(3), np.ones(3), np.array([1.0, 1.0, 3.0]))
    assert (found.distance, found.fraction) == (2.0, 0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(bad: float) -> None:
    for index in range(3):
        points = [np.zeros(3), np.ones(3), np.array([1.0, 2.0, 3.0])]
        points[index] = np.array([bad, 0.0, 0.0])
        with pytest.raises(InputError) as caught:
            closest_on_segments(*points)
        assert caught.value.cause == "not_finite"


def test_the_segments_are_the_axes_of_the_shapes(robot: Robot) -> None:
    segments = link_segments(robot)
    assert segments.links == ("upper", "fore", "fore")
    np.testing.assert_allclose(segments.radius, [0.05, 0.05, 0.06])
    np.testing.assert_allclose(np.linalg.norm(segments.distal - segments.proximal, axis=1), [0.4, 0.4, 0.0])
    np.testing.assert_array_equal(segments.moved, [[True, False], [True, True], [True, True]])
    tilt = 0.2 * np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    np.testing.assert_allclose(segments.proximal[0], np.array([0.02, 0.0, 0.2]) - tilt, atol=1e-12)
    np.testing.assert_allclose(segments.distal[0], np.array([0.02, 0.0, 0.2]) + tilt, atol=1e-12)
    np.testing.assert_allclose(segments.distal[2], [0.0, 0.01, 0.3], atol=1e-12)


def test_a_link_without_an_axis_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="capsules, cylinders") as caught:
        link_segments(arm(tmp_path, fore=BOX))
    assert caught.value.cause == "unsupported_shape"
    with pytest.raises(InputError, match="link base_link"):
        link_segments(Robot.load("ur3"))


def pair(robot: Robot, q: np.ndarray, centres: np.ndarray, radii: np.ndarray, free: list[int] | None = None):
    return most_critical(
        link_segments(robot),
        robot.link_transforms(q),
        robot.kinematics(q).spatial_jacobian,
        robot.free if free is None else np.array(free, dtype=np.intp),
        centres,
        radii,
    )


def test_the_pair_is_the_nearest_of_all_and_its_point_moves_as_the_jacobian_says(robot: Robot) -> None:
    rng = np.random.default_rng(5)
    links, segments = set(), link_segments(robot)
    for _ in range(40):
        q, centres = rng.uniform(-2.0, 2.0, 2), rng.uniform(-0.6, 0.8, (4, 3))
        found = pair(robot, q, centres, np.full(4, 0.15))
        assert found is not None
        poses = robot.link_transforms(q)
        ends = [
            [(poses[link] @ [*end, 1.0])[:3] for end in both]
            for link, *both in zip(segments.links, segments.proximal, segments.distal, strict=True)
        ]
        brute = [
            paper(p, d, o)[1] if np.linalg.norm(d - p) > 0 else np.linalg.norm(o - p)
            for p, d in ends
            for o in centres
        ]
        assert found.critical.distance == pytest.approx(min(brute), abs=1e-12)
        away = found.point - centres[found.obstacle]
        np.testing.assert_allclose(found.critical.direction * found.critical.distance, away, atol=1e-12)
        for joint in range(2):
            velocity = np.eye(2)[joint]
            moved = robot.point_velocity(q, velocity, found.link, found.point)
            np.testing.assert_allclose(found.critical.jacobian[:, joint], moved, atol=1e-12)
        links.add(found.link)
    assert links == {"upper", "fore"}


def test_the_rate_of_the_distance_is_the_jacobian_along_the_direction(robot: Robot) -> None:
    """The envelope theorem, by finite differences: P_r slides along the link at no cost."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        q, centre = rng.uniform(-2.0, 2.0, 2), rng.uniform(-0.5, 0.8, (1, 3))
        found = pair(robot, q, centre, np.array([0.15]))
        for joint in range(2):
            step = 1e-6 * np.eye(2)[joint]
            ahead, behind = (pair(robot, q + s * step, centre, np.array([0.15])) for s in (1, -1))
            rate = (ahead.critical.distance - behind.critical.distance) / 2e-6
            if ahead.link == found.link == behind.link:
                expected = found.critical.direction @ found.critical.jacobian[:, joint]
                assert rate == pytest.approx(expected, abs=1e-5)


def test_an_obstacle_with_a_greater_radius_comes_first(robot: Robot) -> None:
    q, centres = np.zeros(2), np.array([[0.5, 0.0, 0.3], [-0.5, 0.1, 0.3]])
    near = pair(robot, q, centres, np.array([0.15, 0.15]))
    other = 1 - near.obstacle
    radii = np.full(2, 0.05)
    radii[other] = 5.0
    assert pair(robot, q, centres, radii).obstacle == other
    assert pair(robot, q, centres, radii).radius == 5.0


def test_what_no_free_joint_moves_does_not_count(robot: Robot) -> None:
    q, centre = np.zeros(2), np.array([[0.1, 0.0, 0.2]])
    assert pair(robot, q, centre, np.array([0.15])).link == "upper"
    found = pair(robot, q, centre, np.array([0.15]), free=[1])
    assert found.link == "fore"
    assert found.critical.jacobian.shape == (3, 1)


def test_without_obstacles_there_is_no_pair(robot: Robot) -> None:
    assert pair(robot, np.zeros(2), np.empty((0, 3)), np.empty(0)) is None


def test_a_centre_on_the_axis_is_left_across_it(robot: Robot) -> None:
    segments, q = link_segments(robot), np.zeros(2)
    ends = np.array([segments.proximal[0], segments.distal[0]])
    middle = robot.link_transforms(q)["upper"] @ [*ends.mean(axis=0), 1.0]
    found = pair(robot, q, middle[np.newaxis, :3], np.array([0.15]))
    along = robot.link_transforms(q)["upper"][:3, :3] @ (ends[1] - ends[0])
    assert found.critical.distance == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(found.critical.direction) == pytest.approx(1.0)
    assert found.critical.direction @ along == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("centres", "radii"),
    [
        (np.zeros(3), np.ones(1)),
        (np.zeros((2, 2)), np.ones(2)),
        (np.zeros((2, 3)), np.ones(3)),
        (np.zeros((1, 3)), np.zeros(1)),
        (np.zeros((1, 3)), np.array([np.nan])),
        (np.array([[np.nan, 0.0, 0.0]]), np.ones(1)),
    ],
)
def test_what_does_not_fit_is_refused(robot: Robot, centres: np.ndarray, radii: np.ndarray) -> None:
    with pytest.raises(InputError):
        pair(robot, np.zeros(2), centres, radii)

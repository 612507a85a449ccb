import re

import numpy as np
import pinocchio as pin
import pytest
from model_oracle import UR3_URDF, random_positions, share, write_robot

from ssm_service.errors import InputError
from ssm_service.model import DistanceModel, Obstacle, Robot

L1, L2, L3, E = 0.1519, 0.24365, 0.21325, 0.0273


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


def paper_position(q):
    """[Kang2022] (1)–(4) with the URDF's lengths and the lateral offset that the paper leaves out."""
    t1, t2, t3 = q[0], -q[1], q[2]
    rho = L3 * np.cos(t2 - t3) + L2 * np.cos(t2)
    return np.array(
        [
            np.cos(t1) * rho - E * np.sin(t1),
            np.sin(t1) * rho + E * np.cos(t1),
            L1 + L2 * np.sin(t2) + L3 * np.sin(t2 - t3),
        ]
    )


def paper_jacobian(q):
    """[Kang2022] (7)–(10), turned from the paper's angles to the URDF's: θ2 = −q2."""
    t1, t2, t3 = q[0], -q[1], q[2]
    c1, s1 = np.cos(t1), np.sin(t1)
    rho = L3 * np.cos(t2 - t3) + L2 * np.cos(t2)
    rho_2 = -L3 * np.sin(t2 - t3) - L2 * np.sin(t2)
    rho_3 = L3 * np.sin(t2 - t3)
    by_theta = np.array(
        [
            [-s1 * rho - E * c1, c1 * rho_2, c1 * rho_3],
            [c1 * rho - E * s1, s1 * rho_2, s1 * rho_3],
            [0.0, rho, -L3 * np.cos(t2 - t3)],
        ]
    )
    return by_theta * [1.0, -1.0, 1.0]


def test_end_effector_and_reduced_jacobian_are_the_papers_closed_form(robot):
    rng = np.random.default_rng(0)
    for position in random_positions(robot, rng, 600):
        kinematics = robot.kinematics(position)
        assert kinematics.transform_end_effector_to_base[:3, 3] == pytest.approx(
            paper_position(position), abs=1e-9
        )
        assert kinematics.jacobian == pytest.approx(paper_jacobian(position), abs=1e-9)


def logarithm(rotation):
    """Rotation vector of a small rotation."""
    return (
        np.array(
            [
                rotation[2, 1] - rotation[1, 2],
                rotation[0, 2] - rotation[2, 0],
                rotation[1, 0] - rotation[0, 1],
            ]
        )
        / 2
    )


@pytest.mark.parametrize("frame", ["wrist_1_joint", "tool0", "ee_link", "forearm_link"])
def test_full_jacobian_is_the_finite_difference(tmp_path, frame):
    robot = Robot.load(write_robot(tmp_path, frame=frame))
    rng, step = np.random.default_rng(1), 1e-6
    for position in random_positions(robot, rng, 20):
        expected = np.empty((6, 6))
        for j in range(6):
            shift = step * np.eye(6)[j]
            a = robot.kinematics(position - shift).transform_end_effector_to_base
            b = robot.kinematics(position + shift).transform_end_effector_to_base
            expected[:3, j] = (b[:3, 3] - a[:3, 3]) / (2 * step)
            expected[3:, j] = logarithm(b[:3, :3] @ a[:3, :3].T) / (2 * step)
        assert robot.kinematics(position).jacobian_full == pytest.approx(expected, abs=1e-8)


def test_point_velocity_is_the_finite_difference(robot):
    rng, step = np.random.default_rng(2), 1e-6
    model, data = robot.model, robot.model.createData()
    for position in random_positions(robot, rng, 20):
        velocity, point = rng.uniform(-2, 2, size=6), rng.uniform(-0.5, 0.5, size=3)
        for link in ("base_link", "upper_arm_link", "forearm_link", "ee_link", "tool0"):
            frame = model.getFrameId(link, pin.FrameType.BODY)

            def pose(q, frame=frame):
                pin.framesForwardKinematics(model, data, q)
                return data.oMf[frame].copy()

            in_link = pose(position).actInv(point)
            ahead, behind = pose(position + step * velocity), pose(position - step * velocity)
            expected = (ahead.act(in_link) - behind.act(in_link)) / (2 * step)
            assert robot.point_velocity(position, velocity, link, point) == pytest.approx(expected, abs=1e-8)


def test_sensors_sit_round_the_middle_of_the_forearm(robot):
    """[Kang2022] (3)–(4): translate(0, 0, L3/2)·rotz(π/4·(i−1))·translate(r, 0, 0) in forearm_link."""
    rng = np.random.default_rng(3)
    data = robot.model.createData()
    frame = robot.model.getFrameId("forearm_link", pin.FrameType.BODY)
    for position in random_positions(robot, rng, 20):
        pin.framesForwardKinematics(robot.model, data, position)
        T_base_forearm = data.oMf[frame].homogeneous
        kinematics = robot.kinematics(position)
        assert kinematics.transform_sensors_to_base.shape == (8, 4, 4)
        for i in range(1, 9):
            angle = np.pi / 4 * (i - 1)
            T = np.eye(4)
            T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            T[:3, 3] = [0.0323 * np.cos(angle), 0.0323 * np.sin(angle), L3 / 2]
            assert kinematics.transform_sensors_to_base[i - 1] == pytest.approx(T_base_forearm @ T, abs=1e-12)
        T_base_ring = kinematics.transform_rings_to_base[0]
        assert T_base_ring[:3, 3] == pytest.approx(
            kinematics.transform_sensors_to_base[:, :3, 3].mean(axis=0)
        )


def test_two_rings_follow_each_other(tmp_path):
    ring = """
[[rings]]
name = "{name}"
parent_frame = "{frame}"
origin_m = [0.0, 0.1, 0.2]
axis = [0.0, 3.0, 0.0]
first_direction = [0.0, 0.0, 2.0]
count = {count}
radius_m = 0.05
field_of_view_deg = 17.0
range_max_m = 2.0
period_s = 0.1
"""
    rings = ring.format(name="a", frame="forearm_link", count=3) + ring.format(
        name="b", frame="tool0", count=5
    )
    robot = Robot.load(write_robot(tmp_path, rest=rings))
    assert (robot.sensor_count, robot.ring_slices) == (8, (slice(0, 3), slice(3, 8)))
    assert robot.rings[0].half_angle == pytest.approx(np.radians(8.5))
    assert robot.rings[1].transform_ring_to_parent[:3, :3] == pytest.approx(
        np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]), abs=1e-15
    )
    kinematics = robot.kinematics(robot.rest_position)
    for ring, part, T_base_ring in zip(
        robot.rings, robot.ring_slices, kinematics.transform_rings_to_base, strict=True
    ):
        T_base_sensors = kinematics.transform_sensors_to_base[part]
        assert len(T_base_sensors) == ring.count
        for T_base_sensor in T_base_sensors:
            outwards = T_base_sensor[:3, 3] - T_base_ring[:3, 3]
            assert outwards == pytest.approx(0.05 * T_base_sensor[:3, 0], abs=1e-12)
            assert T_base_sensor[:3, 2] == pytest.approx(T_base_ring[:3, 2], abs=1e-12)
            assert np.linalg.det(T_base_sensor[:3, :3]) == pytest.approx(1.0)


RING = """
[[rings]]
name = "{name}"
parent_frame = "{frame}"
origin_m = [0.0, 0.0, {z}]
count = 4
radius_m = 0.05
tilt_deg = {tilt}
field_of_view_deg = 30.0
range_max_m = {range}
period_s = 0.1
"""


def test_tilt_raises_the_sensing_directions_towards_the_axis(tmp_path):
    robot = Robot.load(
        write_robot(tmp_path, rest=RING.format(name="a", frame="forearm_link", z=0.1, tilt=35.0, range=1.0))
    )
    for i, T_ring_sensor in enumerate(robot.rings[0].transform_sensors_to_ring):
        bearing, tilt = i * np.pi / 2, np.radians(35.0)
        radial = np.array([np.cos(bearing), np.sin(bearing), 0.0])
        assert T_ring_sensor[:3, 3] == pytest.approx(0.05 * radial)
        assert T_ring_sensor[:3, 0] == pytest.approx(np.cos(tilt) * radial + [0.0, 0.0, np.sin(tilt)])
        assert T_ring_sensor[:3, :3] @ T_ring_sensor[:3, :3].T == pytest.approx(np.eye(3))
        assert np.linalg.det(T_ring_sensor[:3, :3]) == pytest.approx(1.0)


def test_rings_are_gathered_by_the_link_that_carries_them(tmp_path):
    """Rings on one link need not follow each other, nor hang on the link's own frame."""
    places = [("forearm_link", 0.1), ("upper_arm_link", 0.1), ("elbow_joint", 0.2), ("tool0", 0.0)]
    text = "".join(
        RING.format(name=str(i), frame=frame, z=z, tilt=10.0 * i, range=1.0 + i)
        for i, (frame, z) in enumerate(places)
    )
    robot = Robot.load(write_robot(tmp_path, rest=text))
    forearm, upper, tool = robot.sensor_arrays
    assert [array.link for array in robot.sensor_arrays] == ["forearm_link", "upper_arm_link", "tool0"]
    assert forearm.indices.tolist() == [0, 1, 2, 3, 8, 9, 10, 11]
    assert upper.indices.tolist() == [4, 5, 6, 7]
    assert forearm.ranges_max.tolist() == [1.0] * 4 + [3.0] * 4
    assert robot.link_of_sensor[8:] == ("forearm_link",) * 4 + ("tool0",) * 4
    rng = np.random.default_rng(21)
    for position in random_positions(robot, rng, 5):
        links, kinematics = robot.link_transforms(position), robot.kinematics(position)
        for array in (forearm, upper, tool):
            T_base_sensors = links[array.link] @ array.transforms_sensor_to_link
            assert T_base_sensors == pytest.approx(
                kinematics.transform_sensors_to_base[array.indices], abs=1e-12
            )


def test_reduced_jacobian_is_that_of_the_reduced_model(robot):
    rng = np.random.default_rng(4)
    for position in random_positions(robot, rng, 20):
        locked = [robot.model.getJointId(f"wrist_{i}_joint") for i in (1, 2, 3)]
        model = pin.buildReducedModel(robot.model, locked, position)
        data, frame = model.createData(), model.getFrameId("wrist_1_joint")
        full = pin.computeFrameJacobian(model, data, position[:3], frame, pin.LOCAL_WORLD_ALIGNED)
        assert robot.kinematics(position).jacobian == pytest.approx(full[:3], abs=1e-12)


def test_fixed_joints_leave_the_messages_and_change_nothing_else(tmp_path, robot):
    fixed = Robot.load(write_robot(tmp_path, frame="tool0", rest="[joints.fixed]\nwrist_2_joint = 0.4"))
    whole = Robot.load(write_robot(tmp_path, frame="tool0"))
    assert fixed.joint_names == tuple(n for n in whole.joint_names if n != "wrist_2_joint")
    assert fixed.monitored_links == whole.monitored_links
    position = np.array([0.1, -0.5, 0.9, 0.2, 0.4, -1.0])
    a, b = fixed.kinematics(np.delete(position, 4)), whole.kinematics(position)
    assert a.transform_end_effector_to_base == pytest.approx(b.transform_end_effector_to_base, abs=1e-12)
    assert a.jacobian_full == pytest.approx(np.delete(b.jacobian_full, 4, axis=1), abs=1e-12)


def test_a_moved_base_moves_everything_rigidly(tmp_path, robot):
    text = (share() / UR3_URDF.replace(":", "/")).read_text()
    pattern = r'(<joint name="world_joint".*?<origin rpy=")[^"]*(" xyz=")[^"]*(")'
    moved, count = re.subn(pattern, r"\g<1>0.3 -0.4 0.5\g<2>1 2 3\g<3>", text, flags=re.DOTALL)
    assert count == 1
    (tmp_path / "moved.urdf").write_text(moved)
    other = Robot.load(write_robot(tmp_path, urdf="moved.urdf"))
    plain = Robot.load(write_robot(tmp_path))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(0.3, -0.4, 0.5), [1, 2, 3]
    for position in random_positions(robot, np.random.default_rng(5), 10):
        a, b = plain.kinematics(position), other.kinematics(position)
        assert b.transform_end_effector_to_base == pytest.approx(
            T @ a.transform_end_effector_to_base, abs=1e-12
        )
        assert b.jacobian_full[:3] == pytest.approx(T[:3, :3] @ a.jacobian_full[:3], abs=1e-12)
        assert b.jacobian_full[3:] == pytest.approx(T[:3, :3] @ a.jacobian_full[3:], abs=1e-12)


def test_limits_and_rest_position(robot, tmp_path):
    assert robot.velocity_limit == pytest.approx([2.16, 2.16, 3.15, 3.2, 3.2, 3.2])
    assert robot.position_upper[:3] == pytest.approx([2 * np.pi, 2 * np.pi, np.pi], abs=1e-9)
    assert robot.free.tolist() == [0, 1, 2]
    assert not robot.velocity_limit.flags.writeable
    rest = "[joints.locked]\nwrist_2_joint = 0.7\n"
    rest += "[limits.velocity_rad_s]\nelbow_joint = 1.0\nwrist_1_joint = 9.0"
    other = Robot.load(write_robot(tmp_path, rest=rest))
    assert other.velocity_limit == pytest.approx([2.16, 2.16, 1.0, 3.2, 3.2, 3.2])
    assert other.rest_position.tolist() == [0, 0, 0, 0, 0.7, 0]
    assert other.free.tolist() == [0, 1, 2, 3, 5]
    assert other.kinematics(other.rest_position).jacobian.shape == (3, 5)


def test_results_are_the_callers_own(robot):
    first = robot.kinematics(robot.rest_position)
    kept = [
        first.jacobian_full.copy(),
        first.transform_sensors_to_base.copy(),
        first.transform_end_effector_to_base.copy(),
    ]
    robot.kinematics(robot.rest_position + 0.5)
    assert (first.jacobian_full == kept[0]).all()
    assert (first.transform_sensors_to_base == kept[1]).all()
    assert (first.transform_end_effector_to_base == kept[2]).all()


@pytest.mark.parametrize(
    ("position", "cause"),
    [
        ([0.0] * 5, "wrong_length"),
        ([[0.0] * 6], "wrong_length"),
        ([0.0] * 5 + [float("nan")], "not_finite"),
        ([0.0] * 5 + [float("-inf")], "not_finite"),
        (["a"] * 6, "wrong_type"),
        (None, "wrong_length"),
    ],
)
def test_bad_positions_are_refused(robot, position, cause):
    for ask in (
        robot.kinematics,
        robot.pinocchio_configuration,
        lambda p: robot.point_velocity(p, [0.0] * 6, "forearm_link", [0, 0, 0]),
        lambda p: robot.point_velocity([0.0] * 6, p, "forearm_link", [0, 0, 0]),
    ):
        with pytest.raises(InputError) as caught:
            ask(position)
        assert caught.value.cause == cause


def test_unknown_link_and_bad_point_are_refused(robot):
    with pytest.raises(InputError, match="forearm_link"):
        robot.point_velocity([0.0] * 6, [0.0] * 6, "fourarm_link", [0, 0, 0])
    with pytest.raises(InputError, match="point"):
        robot.point_velocity([0.0] * 6, [0.0] * 6, "forearm_link", [0, np.nan, 0])


@pytest.mark.parametrize(("name", "L"), [("ur5", (0.425, 0.39225)), ("ur10", (0.612, 0.5723))])
def test_the_other_arms_load_with_their_rings_on_the_forearm(name, L):
    """A ring half-way to wrist_1, its sensors on the mesh's surface there."""
    robot = Robot.load(name)
    kinematics = robot.kinematics(robot.rest_position)
    end = kinematics.transform_end_effector_to_base[:3, 3]
    elbow = end - kinematics.transform_rings_to_base[0, :3, 3]
    assert np.linalg.norm(2 * elbow) == pytest.approx(L[1], abs=1e-6)
    assert np.hypot(end[0], 0.0) == pytest.approx(sum(L), abs=1e-6)
    assert robot.sensor_count == 8
    model = DistanceModel(robot)
    sensors = kinematics.transform_sensors_to_base[:, :3, 3]
    model.set_obstacles(
        [Obstacle(id=str(i), shape="sphere", size=(1e-6,), position=tuple(p)) for i, p in enumerate(sensors)]
    )
    gaps = [p.distance for p in model.all_pairs(robot.rest_position) if p.link == "forearm_link"]
    assert min(gaps) > -1e-4
    assert max(gaps) < 3e-3


def test_one_sensor_is_the_same_as_all_of_them():
    robot = Robot.load("ur3")
    kinematics = robot.kinematics(np.linspace(-1.0, 1.0, 6))
    for index, T in enumerate(kinematics.transform_sensors_to_base):
        assert kinematics.transform_sensor_to_base(index) == pytest.approx(T, abs=1e-15)
    with pytest.raises(IndexError):
        kinematics.transform_sensor_to_base(8)


def test_links_are_where_pinocchio_says():
    robot = Robot.load("ur3")
    position = np.linspace(-1.0, 1.0, 6)
    transforms = robot.link_transforms(position)
    assert set(robot.monitored_links) <= set(transforms)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, position)
    for link, T in transforms.items():
        frame = robot.model.getFrameId(link, pin.FrameType.BODY)
        assert pytest.approx(data.oMf[frame].homogeneous, abs=1e-12) == T
    elbow, wrist = transforms["forearm_link"], transforms["wrist_1_link"]
    assert np.linalg.norm(wrist[:3, 3] - elbow[:3, 3]) == pytest.approx(0.21325, abs=1e-9)

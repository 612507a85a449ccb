"""What a person may get wrong in a robot file, and arms that are no UR3."""

import re

import numpy as np
import pytest
from model_oracle import (
    UR3_URDF,
    World,
    brute_force,
    random_obstacle,
    random_positions,
    share,
    write_robot,
)

from ssm_service.errors import ConfigError
from ssm_service.model import DistanceModel, Robot

RING = """
[[rings]]
name = "r"
parent_frame = "forearm_lnk"
origin_m = [0.0, 0.0, 0.1]
count = 8
radius_m = 0.03
field_of_view_deg = 20.0
range_max_m = 1.2
period_s = 0.16
"""


@pytest.mark.parametrize(
    ("file", "key", "allowed"),
    [
        ({"frame": "wrist_9_joint"}, "end_effector_frame", r"did you mean 'wrist_\d_joint'.*tool0"),
        (
            {"top": 'links = ["forearm_link", "fourarm_link"]'},
            "links[1]",
            "did you mean 'forearm_link'.*base_link",
        ),
        ({"top": 'links = ["tool0"]'}, "links[0]", "with collision geometry.*ee_link"),
        ({"top": "links = []"}, "links", "at least one"),
        ({"top": 'links = ["base_link", "base_link"]'}, "links", "each once"),
        (
            {"top": "hull_pieces = { forarm_link = 2 }"},
            "hull_pieces.forarm_link",
            "did you mean 'forearm_link'",
        ),
        ({"rest": "[joints.locked]\nelbow = 0.0"}, "joints.locked.elbow", "'elbow_joint'.*wrist_3_joint"),
        ({"rest": "[joints.fixed]\nelbow = 0.0"}, "joints.fixed.elbow", "'elbow_joint'.*wrist_3_joint"),
        ({"rest": "[joints.locked]\nelbow_joint = 3.5"}, "joints.locked.elbow_joint", "-3.14159 to 3.14159"),
        ({"rest": "[joints.fixed]\nelbow_joint = 3.5"}, "joints.fixed.elbow_joint", "-3.14159 to 3.14159"),
        ({"rest": "[limits.velocity_rad_s]\nelbow = 1.0"}, "limits.velocity_rad_s.elbow", "elbow_joint"),
        (
            {"rest": "[limits.velocity_rad_s]\nelbow_joint = 0.0"},
            "limits.velocity_rad_s.elbow_joint",
            "> 0",
        ),
        ({"rest": RING}, "rings[0].parent_frame", "did you mean 'forearm_link'.*tool0"),
        ({"urdf": "nowhere.urdf"}, "urdf", "existing file"),
        ({"urdf": "example-robot-data:robots/none.urdf"}, "urdf", "existing file"),
        ({"urdf": "arm.toml"}, "urdf", "valid URDF"),
        ({"top": 'package_dirs = ["nowhere"]'}, "package_dirs[0]", "existing folder"),
    ],
)
def test_a_wrong_file_is_refused_with_its_key_and_what_is_allowed(tmp_path, file, key, allowed):
    with pytest.raises(ConfigError) as caught:
        Robot.load(write_robot(tmp_path, **file))
    assert caught.value.key == key
    assert caught.value.file.endswith("arm.toml")
    assert re.search(allowed, caught.value.allowed)


def test_all_joints_locked_or_fixed_is_refused(tmp_path):
    names = Robot.load("ur3").joint_names
    for table in ("locked", "fixed"):
        rest = f"[joints.{table}]\n" + "\n".join(f"{name} = 0.0" for name in names)
        with pytest.raises(ConfigError):
            Robot.load(write_robot(tmp_path, rest=rest))


def test_without_example_robot_data_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("ssm_service.model.description._share", lambda: None)
    with pytest.raises(ConfigError, match="pip install example-robot-data") as caught:
        Robot.load(write_robot(tmp_path))
    assert caught.value.key == "urdf"


JOINT = (
    '<joint name="j1" type="{kind}"><parent link="l0"/><child link="l1"/><axis xyz="0 0 1"/>{limit}</joint>'
)
LIMIT = '<limit lower="{lower}" upper="1" velocity="{velocity}" effort="1"/>'
COLLISION = '<link name="l1"><collision><geometry>{}</geometry></collision></link>'


def small_arm(folder, kind="revolute", limit=None, geometry='<sphere radius="0.1"/>'):
    limit = LIMIT.format(lower=-1, velocity=1) if limit is None else limit
    joint = JOINT.format(kind=kind, limit=limit)
    urdf = f'<robot name="small"><link name="l0"/>{COLLISION.format(geometry)}{joint}</robot>'
    (folder / "small.urdf").write_text(urdf)
    return write_robot(folder, urdf="small.urdf", frame="l1")


@pytest.mark.parametrize(
    ("content", "file"),
    [
        (None, "package://nowhere/a.stl"),
        (None, "a.stl"),
        ("", "a.stl"),
        ("solid nothing", "a.stl"),
        ("v 0 0 0\n", "a.obj"),
    ],
)
def test_missing_and_unreadable_meshes_are_refused(tmp_path, content, file):
    if content is not None:
        (tmp_path / file).write_text(content)
    path = small_arm(tmp_path, geometry=f'<mesh filename="package://{tmp_path.name}/{file}"/>')
    path.write_text('package_dirs = [".."]\n' + path.read_text())
    with pytest.raises(ConfigError) as caught:
        DistanceModel(Robot.load(path))
    assert caught.value.key in ("package_dirs", "urdf")


def test_joints_that_are_not_supported_are_refused(tmp_path):
    for kind in ("floating", "planar"):
        with pytest.raises(ConfigError, match="revolute, continuous and prismatic"):
            Robot.load(small_arm(tmp_path, kind=kind))


def test_a_joint_without_a_speed_limit_names_the_key_to_add(tmp_path):
    for kind, limit in (("continuous", ""), ("revolute", LIMIT.format(lower=-1, velocity=0))):
        path = small_arm(tmp_path, kind=kind, limit=limit)
        with pytest.raises(ConfigError, match="add this key") as caught:
            Robot.load(path)
        assert caught.value.key == "limits.velocity_rad_s.j1"
        path.write_text(path.read_text() + "[limits.velocity_rad_s]\nj1 = 0.5\n")
        assert Robot.load(path).velocity_limit.tolist() == [0.5]


def test_position_limits_the_wrong_way_round_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="lower limits"):
        Robot.load(small_arm(tmp_path, limit=LIMIT.format(lower=2, velocity=1)))


def test_a_link_without_collision_geometry_cannot_be_monitored(tmp_path):
    path = small_arm(tmp_path)
    path.write_text('links = ["l0"]\n' + path.read_text())
    with pytest.raises(ConfigError, match="with collision geometry: l1"):
        Robot.load(path)


PANDA = "example-robot-data:robots/panda_description/urdf/panda.urdf"
FINGERS = "[joints.fixed]\npanda_finger_joint1 = 0.02\npanda_finger_joint2 = 0.02\n"


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    folder = tmp_path_factory.mktemp("panda")
    top = "hull_pieces = { panda_link5 = 3 }"
    return Robot.load(write_robot(folder, urdf=PANDA, frame="panda_hand", top=top, rest=FINGERS))


def test_a_seven_joint_arm_of_a_users_own(panda):
    assert panda.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert panda.position_upper[3] < 0.0
    assert panda.rest_position[3] == panda.position_upper[3]
    kinematics = panda.kinematics(panda.rest_position)
    assert kinematics.jacobian_full.shape == (6, 7)
    assert kinematics.transform_sensors_to_base.shape == (0, 4, 4)
    assert len(panda.monitored_links) == 11


def test_distances_of_links_with_several_geometries(panda):
    """The fingers are four boxes each: the nearest of a link's parts counts, and contends with the meshes."""
    model, world, rng = DistanceModel(panda), World(panda), np.random.default_rng(0)
    links = set()
    for position in random_positions(panda, rng, 60):
        tip = panda.kinematics(position).transform_end_effector_to_base
        shapes = [random_obstacle(rng, s, s) for s in ("sphere", "capsule", "box")]
        near = tip[:3, 3] + tip[:3, 2] * 0.2 + rng.uniform(-0.1, 0.1, size=3)
        shapes[0] = type(shapes[0])(id="near", shape="sphere", size=(0.03,), position=tuple(near))
        model.set_obstacles(shapes)
        pairs = model.all_pairs(position)
        assert len(pairs) == 11 * 3
        nearest = model.nearest(position)
        assert nearest.distance == pytest.approx(min(p.distance for p in pairs), abs=2e-6)
        links.add(nearest.link)
    assert {"panda_leftfinger", "panda_rightfinger"} & links
    for pair in pairs:
        if pair.link in ("panda_link5", "panda_hand") and pair.distance > 0.01:
            obstacle = next(o for o in shapes if o.id == pair.obstacle)
            expected = brute_force(world.triangles(position, pair.link), obstacle)
            assert pair.distance == pytest.approx(expected, abs=1e-5)


def test_an_arm_with_continuous_joints(tmp_path):
    """Kinova's: angles in messages, (cos, sin) inside; a full turn changes nothing."""
    urdf = "example-robot-data:robots/kinova_description/robots/kinova.urdf"
    robot = Robot.load(write_robot(tmp_path, urdf=urdf, frame="j2s6s200_end_effector"))
    continuous = np.isinf(robot.position_upper)
    assert continuous.tolist() == [True, False, False, True, False, True]
    assert robot.position_lower[0] == -np.inf
    assert robot.rest_position[1] == pytest.approx(0.8203, abs=1e-4)
    model = DistanceModel(robot)
    rng, step = np.random.default_rng(1), 1e-6
    model.set_obstacles([random_obstacle(rng, "sphere")])
    for position in random_positions(robot, rng, 5):
        assert len(robot.pinocchio_configuration(position)) == 9
        turned = position + 2 * np.pi * continuous
        a, b = robot.kinematics(position), robot.kinematics(turned)
        assert b.transform_end_effector_to_base == pytest.approx(a.transform_end_effector_to_base, abs=1e-12)
        assert model.nearest(turned).distance == pytest.approx(model.nearest(position).distance, abs=1e-9)
        for j in range(6):
            shift = step * np.eye(6)[j]
            ahead = robot.kinematics(position + shift).transform_end_effector_to_base[:3, 3]
            behind = robot.kinematics(position - shift).transform_end_effector_to_base[:3, 3]
            assert a.jacobian_full[:3, j] == pytest.approx((ahead - behind) / (2 * step), abs=1e-8)


def test_a_urdf_beside_the_robot_file(tmp_path):
    text = (share() / UR3_URDF.replace(":", "/")).read_text()
    (tmp_path / "own.urdf").write_text(text)
    robot = Robot.load(write_robot(tmp_path, urdf="own.urdf"))
    assert robot.name == "arm"
    assert robot.monitored_links == Robot.load("ur3").monitored_links

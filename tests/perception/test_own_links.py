"""What the sensors see of the arm, against rays cast at its meshes, and which echoes that explains."""

import dataclasses
import math

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pytest
from raycast import raycast_mesh

from ssm_service.config import RobotConfig, load_robot_config
from ssm_service.errors import InputError
from ssm_service.model import Robot
from ssm_service.model.hulls import triangles
from ssm_service.perception import own_surface
from ssm_service.perception.own_links import OwnLinks
from ssm_service.perception.own_surface import OwnSurface

FOLDED = np.array([1.18, -0.7, -2.29, 1.39, 0.16, -1.19])
STRETCHED = np.array([0.3, -1.1, 1.3, 0.0, 0.0, 0.0])


def robot_with(*rings):
    """The UR3 with other rings in place of its own, each its ring with changes."""
    config = load_robot_config("ur3")
    made = [
        msgspec.structs.replace(config.file.rings[0], **{"name": f"ring{i}", **changes})
        for i, changes in enumerate(rings)
    ]
    file = msgspec.structs.replace(config.file, rings=made, assumptions=None)
    return Robot(RobotConfig(name="ur3", path=config.path, file=file))


@pytest.fixture(scope="module")
def ur3():
    return Robot.load("ur3")


@pytest.fixture(scope="module")
def own(ur3):
    return OwnLinks(ur3)


_READ = {}


def _mesh(path, shape):
    if path not in _READ:
        _READ[path] = triangles(shape)
    return _READ[path]


def arm_triangles(robot, position):
    """All links' triangles by the joint that moves them, (t, 3, 3), base frame; the ee_link's box by hand."""
    data, geometry = robot.model.createData(), pin.GeometryData(robot.collision)
    q = robot.pinocchio_configuration(position)
    pin.updateGeometryPlacements(robot.model, data, robot.collision, geometry, q)
    found = {}
    for index, source in enumerate(robot.collision.geometryObjects):
        shape, T = source.geometry, geometry.oMg[index].homogeneous
        if isinstance(shape, coal.BVHModelBase):
            vertices, faces = _mesh(source.meshPath, shape)
        else:
            h = np.array(shape.halfSide)
            vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * h
            sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
            faces = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
        corners = (vertices @ T[:3, :3].T + T[:3, 3])[faces]
        found[source.parentJoint] = np.concatenate((found.get(source.parentJoint, corners[:0]), corners))
    return found


def random_position(robot, rng):
    return rng.uniform(np.maximum(robot.position_lower, -np.pi), np.minimum(robot.position_upper, np.pi))


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"field_of_view_deg": 60.0, "count": 5},
        {"field_of_view_deg": 120.0, "count": 4, "origin_m": (0.0, 0.0, 0.19)},
        {"tilt_deg": 35.0, "field_of_view_deg": 27.0, "radius_m": 0.045},
        {"tilt_deg": -40.0, "field_of_view_deg": 10.0, "parent_frame": "upper_arm_link", "radius_m": 0.07},
    ],
)
def test_readings_equal_ray_casting_at_the_meshes(change):
    robot = robot_with(change)
    own, rng = OwnLinks(robot), np.random.default_rng(1)
    array = robot.sensor_arrays[0]
    carrier = robot.model.frames[robot.model.getFrameId(array.link)].parentJoint
    compared = silent = 0
    for _ in range(200):
        if compared >= 5:
            break
        position = random_position(robot, rng)
        distances = own.distances(position)
        moving = [t for joint, t in arm_triangles(robot, position).items() if joint != carrier]
        poses = robot.kinematics(position).transform_sensors_to_base
        for sensor in rng.permutation(robot.sensor_count)[:2]:
            if silent >= 4 and distances[sensor] == math.inf:
                continue  # echoes are rarer
            half_angle = float(array.half_angles[sensor])
            cast = raycast_mesh(np.concatenate(moving), poses[sensor], half_angle)
            if np.isfinite(own._fixed[1][sensor]):
                cast = min(cast, own._fixed[1][sensor])
            assert distances[sensor] <= cast + 1e-9, (
                "a point of the arm in the cone is nearer than the reading"
            )
            if cast < math.inf:
                compared += 1
                assert distances[sensor] == pytest.approx(cast, abs=1e-5)
            else:
                silent += distances[sensor] == math.inf
    assert compared >= 5
    assert silent >= 1 or change.get("field_of_view_deg", 0) > 100


def test_the_carriers_own_bulge_is_seen_and_its_own_spot_is_not(ur3):
    """A ring at the forearm's middle looks along it at its ends, as rays cast at the bare link say."""
    flat = OwnLinks(ur3)
    assert np.isinf(flat._fixed).all()
    for tilt, radius in ((70.0, 0.036), (-75.0, 0.034)):
        robot = robot_with({"tilt_deg": tilt, "radius_m": radius, "field_of_view_deg": 40.0})
        own = OwnLinks(robot)
        array = robot.sensor_arrays[0]
        link = arm_triangles(robot, np.zeros(6))[robot.model.getJointId("elbow_joint")]
        T_base_link = robot.link_transforms(np.zeros(6))[array.link]
        seen = 0
        for sensor, T in enumerate(array.transforms_sensor_to_link):
            pose = T_base_link @ T
            a, b, c = np.swapaxes(link - pose[:3, 3], 0, 1)
            front = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0
            cast = raycast_mesh(link[front], pose, float(array.half_angles[sensor]))
            assert own._fixed[1][sensor] <= cast + 1e-9
            assert own._fixed[1][sensor] == cast or own._fixed[1][sensor] == pytest.approx(cast, abs=1e-5)
            seen += cast < math.inf
        assert seen >= 2
        assert (own.distances(STRETCHED) <= own._fixed[1]).all()


def test_a_sensor_sunk_into_its_own_link_sees_out_of_it(ur3):
    sunk = OwnLinks(robot_with({"radius_m": 0.02}))
    assert np.isinf(sunk._fixed).all()
    assert np.isinf(sunk.readings(STRETCHED)).all()
    with_moving = sunk.readings(FOLDED)
    assert np.isfinite(with_moving).any()


def test_every_link_counts_whether_monitored_or_not():
    config = load_robot_config("ur3")
    file = msgspec.structs.replace(config.file, links=["forearm_link"], hull_pieces={})
    few = Robot(RobotConfig(name="ur3", path=config.path, file=file))
    assert few.monitored_links == ("forearm_link",)
    every = OwnLinks(Robot.load("ur3")).readings(FOLDED)
    assert np.isfinite(every).any()
    np.testing.assert_array_equal(OwnLinks(few).readings(FOLDED), every)


def test_turning_the_whole_arm_changes_nothing(own):
    turned = FOLDED + np.array([1.234, 0, 0, 0, 0, 0])
    arm, base = own.distances(FOLDED), own.distances(turned)
    # Only the base link stays: here nobody sees it.
    np.testing.assert_allclose(base, arm, atol=1e-9)


def test_readings_are_clamped_as_the_devices_are():
    plain = OwnLinks(robot_with({})).readings(FOLDED)
    seen = np.isfinite(plain)
    assert seen.sum() >= 3
    near, far = np.sort(plain[seen])[[0, -1]]
    between = 0.5 * (near + far)
    short = OwnLinks(robot_with({"range_max_m": between})).readings(FOLDED)
    np.testing.assert_array_equal(short, np.where(plain <= between, plain, math.inf))
    blind = OwnLinks(robot_with({"range_min_m": between})).readings(FOLDED)
    np.testing.assert_array_equal(blind, np.where(seen, np.maximum(plain, between), math.inf))


def test_rings_on_several_links_read_as_each_alone():
    rings = ({}, {"parent_frame": "upper_arm_link", "count": 5, "radius_m": 0.06, "field_of_view_deg": 50.0})
    both = OwnLinks(robot_with(rings[0], rings[1], rings[0])).readings(FOLDED)
    one, other = (OwnLinks(robot_with(ring)).readings(FOLDED) for ring in rings)
    np.testing.assert_array_equal(both, np.concatenate((one, other, one)))


def test_echoes_that_own_links_explain(ur3, own):
    expected = own.readings(FOLDED)
    seen = np.isfinite(expected)
    tolerance = 0.01
    exact = own.detect(FOLDED, expected, tolerance)
    np.testing.assert_array_equal(exact.own, seen)
    assert not exact.missing.any()
    np.testing.assert_array_equal(exact.expected, expected)
    np.testing.assert_array_equal(exact.clear, np.where(seen, expected, ur3.rings[0].range_max))
    own = OwnLinks(ur3, margin_rad=0.0)  # no link is at the edge of a cone
    for shift in (-0.9, -0.3, 0.3, 0.9):
        assert own.detect(FOLDED, expected + shift * tolerance, tolerance).own[seen].all()
    nearer = own.detect(FOLDED, np.maximum(expected - 1.1 * tolerance, 0.0), tolerance)
    clearly = seen & (expected > 1.1 * tolerance)
    assert clearly.any()
    assert not nearer.own[clearly].any()
    assert not nearer.missing.any()
    farther = own.detect(FOLDED, expected + 1.1 * tolerance, tolerance)
    assert not farther.own.any()
    np.testing.assert_array_equal(farther.missing, seen)
    silent = own.detect(FOLDED, np.full(8, math.inf), tolerance)
    assert not silent.own.any()
    np.testing.assert_array_equal(silent.missing, seen)
    obstacle = own.detect(FOLDED, np.full(8, 0.4), tolerance)
    np.testing.assert_array_equal(obstacle.missing, seen & (expected < 0.39))
    each = own.detect(FOLDED, expected + 0.02, np.where(np.arange(8) % 2, 0.03, 0.01))
    np.testing.assert_array_equal(each.own, seen & (np.arange(8) % 2 == 1))


def test_an_own_link_at_the_end_of_the_range_may_be_seen_or_not():
    plain = OwnLinks(robot_with({})).readings(FOLDED)
    far = int(np.argmax(np.where(np.isfinite(plain), plain, -1.0)))
    for past in (-0.005, 0.005):  # the range ends a little before or behind the link
        own = OwnLinks(robot_with({"range_max_m": float(plain[far]) + past}))
        quiet = own.detect(FOLDED, np.full(8, math.inf), 0.01)
        assert not quiet.missing[far]
        echo = np.full(8, math.inf)
        echo[far] = plain[far] - 0.006
        assert own.detect(FOLDED, echo, 0.01).own[far]
    own = OwnLinks(robot_with({"range_max_m": float(plain[far]) + 0.011}), margin_rad=0.0)
    assert own.detect(FOLDED, np.full(8, math.inf), 0.01).missing[far]


def test_at_the_edge_of_a_cone_an_own_link_may_be_seen_or_not(ur3):
    """Along a motion that brings the upper arm into a cone: just before and after, either answer is right."""
    sharp, own, margin = OwnLinks(ur3, margin_rad=0.0), OwnLinks(ur3), math.radians(1.0)
    crossings = 0
    for angle in np.linspace(1.0, 2.2, 1201):
        before, after = (np.array([0.0, -1.2, a, 0.0, 0.0, 0.0]) for a in (angle, angle + 1e-3))
        one, other = sharp.readings(before), sharp.readings(after)
        for sensor in np.flatnonzero(np.isfinite(one) != np.isfinite(other)):
            crossings += 1
            seen = min(one[sensor], other[sensor])
            echo = np.where(np.arange(8) == sensor, seen, one)
            silent = np.where(np.arange(8) == sensor, math.inf, one)
            for position in (before, after):
                assert own.detect(position, echo, 0.01).own[sensor]
                assert not own.detect(position, silent, 0.01).missing[sensor]
                assert not own.detect(position, silent, 0.01).own[sensor]
            unseen = before if one[sensor] == math.inf else after
            assert not sharp.detect(unseen, echo, 0.01).own[sensor]
            assert sharp.detect(after if unseen is before else before, silent, 0.01).missing[sensor]
            clear = own.detect(unseen, echo, 0.01).clear
            assert clear[sensor] == seen
            nearer = np.where(np.arange(8) == sensor, seen - 0.05, one)
            assert not own.detect(unseen, nearer, 0.01).own[sensor]
    assert crossings >= 1
    with pytest.raises(InputError):
        OwnLinks(ur3, margin_rad=-margin)


def test_stretched_arm_sees_nothing_of_itself(ur3, own):
    assert np.isinf(own.readings(STRETCHED)).all()
    found = own.detect(STRETCHED, np.array([0.3, *[math.inf] * 7]), 0.06)
    assert not found.own.any()
    assert not found.missing.any()
    assert found.clear.tolist() == [ur3.rings[0].range_max] * 8


URDF = """<robot name="r">
  <link name="base"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
  <link name="arm"/>
  <joint name="j2" type="continuous"><parent link="arm"/><child link="tool"/><origin xyz="0.5 0.1 0"/>
    <axis xyz="0 0 1"/><limit velocity="1" effort="1"/></joint>
  <link name="tool"><collision><origin xyz="0 0 0.01" rpy="0.3 0.2 0.1"/>
    <geometry>{shape}</geometry></collision></link>
</robot>"""
ARM = """urdf = "r.urdf"
end_effector_frame = "tool"
default_profile = "p"
[limits]
velocity_rad_s = {{ j2 = 1.0 }}
[[rings]]
name = "one"
parent_frame = "arm"
origin_m = [0.0, 0.0, 0.0]
count = 1
radius_m = 0.05
field_of_view_deg = {fov}
range_max_m = 2.0
period_s = 0.1
[sources]
ranges = {{ required = true, timeout_s = 0.4 }}
[profiles.p]
red = {{ distance_m = 0.1, joint_speed_rad_s = 0.1, speed_scaling = 0.25 }}
yellow = {{ distance_m = 0.2, joint_speed_rad_s = 0.2, speed_scaling = 0.5 }}
"""


@pytest.mark.parametrize(
    ("shape", "name", "size", "tolerance"),
    [
        ('<sphere radius="0.08"/>', "sphere", (0.08,), 1e-9),
        ('<cylinder radius="0.05" length="0.3"/>', "cylinder", (0.05, 0.3), 8e-6),
        ('<box size="0.1 0.2 0.3"/>', "box", (0.1, 0.2, 0.3), 1e-6),
    ],
)
@pytest.mark.parametrize("fov", [20.0, 120.0])
def test_primitive_links_read_as_obstacles_of_their_shape(tmp_path, shape, name, size, tolerance, fov):
    from scipy.spatial.transform import Rotation

    from ssm_service.model import Obstacle
    from ssm_service.perception import cone_reading

    (tmp_path / "r.urdf").write_text(URDF.format(shape=shape))
    path = tmp_path / "arm.toml"
    path.write_text(ARM.format(fov=fov))
    robot = Robot.load(path)
    own = OwnLinks(robot)
    echoes = 0
    for angle in np.linspace(-3.0, 3.0, 25):
        position = np.array([0.4, angle])
        T = robot.link_transforms(position)["tool"]
        turn = T[:3, :3] @ Rotation.from_euler("xyz", [0.3, 0.2, 0.1]).as_matrix()
        place = T[:3, :3] @ [0, 0, 0.01] + T[:3, 3]
        link = Obstacle(
            id="tool", shape=name, size=size, position=tuple(place),
            quaternion_xyzw=tuple(Rotation.from_matrix(turn).as_quat()),
        )  # fmt: skip
        pose = robot.kinematics(position).transform_sensors_to_base[0]
        expected = cone_reading(link, pose, math.radians(fov / 2), 2.0)
        (reading,) = own.readings(position)
        echoes += expected < math.inf
        assert reading == expected or expected - tolerance <= reading <= expected + 1e-6
    assert echoes >= 5


def test_a_mesh_turned_inside_out_is_turned_back(ur3, monkeypatch):
    right = OwnSurface.of_robot(ur3)
    monkeypatch.setattr(
        own_surface, "triangles", lambda mesh: (triangles(mesh)[0], triangles(mesh)[1][:, ::-1])
    )
    wrong = OwnSurface.of_robot(Robot.load("ur3"))
    assert wrong is not right
    for surface in (right, wrong):
        a, b, c = np.swapaxes(surface.corners.reshape(-1, 3, 3), 0, 1)
        assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0
    assert {tuple(t) for t in np.sort(right.corners.round(9)).tolist()} == {
        tuple(t) for t in np.sort(wrong.corners.round(9)).tolist()
    }


def test_the_tree_holds_every_triangle_once_and_its_balls_hold_theirs(ur3):
    surface = OwnSurface.of_robot(ur3)
    total = sum(
        g.geometry.num_tris if isinstance(g.geometry, coal.BVHModelBase) else 12
        for g in ur3.collision.geometryObjects
    )
    assert len(surface.corners) == total
    visited = np.zeros(total, dtype=int)

    def inside(node, above):
        balls = [*above, surface.balls[node]]
        left, right = surface.nodes[node]
        if left >= 0:
            inside(left, balls)
            inside(right, balls)
            return
        visited[-1 - left : right] += 1
        points = surface.corners[-1 - left : right].reshape(-1, 3)
        for ball in balls:
            assert (np.linalg.norm(points - ball[:3], axis=1) <= ball[3]).all()

    for root in surface.roots:
        inside(root, [])
    assert (visited == 1).all()


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"ranges": np.ones(7)}, "wrong_length"),
        ({"ranges": np.full(8, math.nan)}, "not_finite"),
        ({"tolerance": -0.1}, "out_of_range"),
        ({"tolerance": math.nan}, "out_of_range"),
        ({"tolerance": math.inf}, "out_of_range"),
        ({"tolerance": np.ones(3)}, "wrong_length"),
        ({"position": np.zeros(5)}, "wrong_length"),
        ({"position": np.full(6, math.nan)}, "not_finite"),
    ],
)
def test_bad_arguments_are_refused(own, change, cause):
    arguments = {"position": FOLDED, "ranges": np.full(8, math.inf), "tolerance": 0.01, **change}
    with pytest.raises(InputError) as caught:
        own.detect(**arguments)
    assert caught.value.cause == cause


def test_what_is_returned_is_the_callers_own(own):
    first = own.readings(FOLDED)
    kept = first.copy()
    own.readings(STRETCHED)
    np.testing.assert_array_equal(first, kept)
    first[:] = 0.0
    np.testing.assert_array_equal(own.readings(FOLDED), kept)
    assert all(field.name for field in dataclasses.fields(own.detect(FOLDED, kept, 0.01)))

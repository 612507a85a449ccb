"""Each trap of Coal that we know: shown to be there, and shown to be cured."""

import math

import coal
import numpy as np
import pytest
from model_oracle import World, brute_force, inside, random_obstacle, random_positions, write_robot

from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.model.hulls import convex_hull, slab_points


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


@pytest.fixture(scope="module")
def world(robot):
    return World(robot)


@pytest.fixture
def model(robot):
    return DistanceModel(robot)


def raw(robot, world, position, link, shape, centre):
    """Coal's own word on a link's mesh against a shape."""
    index = robot.geometry_of_link[link][0]
    pose = world.placement(position, index)
    result = coal.DistanceResult()
    mesh = robot.collision.geometryObjects[index].geometry
    place = coal.Transform3s(np.eye(3), np.array(centre))
    return coal.distance(mesh, coal.Transform3s(pose), shape, place, coal.DistanceRequest(), result)


SMALL = {"sphere": (0.002,), "capsule": (0.002, 0.004), "cylinder": (0.002, 0.004), "box": (0.003,) * 3}


@pytest.mark.parametrize("shape", SMALL)
def test_trap_1_an_obstacle_inside_a_mesh(robot, world, model, shape):
    position = robot.rest_position
    corners = world.triangles(position, "forearm_link")
    rng = np.random.default_rng(1)
    points = rng.uniform(corners.min(axis=(0, 1)), corners.max(axis=(0, 1)), size=(100, 3))
    within = [p for p in points if inside(corners, p)]
    centre = max(within, key=lambda p: raw(robot, world, position, "forearm_link", coal.Sphere(0.0), p))
    assert raw(robot, world, position, "forearm_link", coal.Sphere(0.002), centre) > 0.005  # 'far'
    model.set_obstacles([Obstacle(id="o", shape=shape, size=SMALL[shape], position=tuple(centre))])
    nearest = model.nearest(position)
    assert nearest.link == "forearm_link"
    assert nearest.distance < -0.01


@pytest.mark.parametrize("gap", [1e-4, 1e-6, 1e-8, 0.0, -1e-6, -1e-4])
@pytest.mark.parametrize(("shape", "size"), [("box", (0.6, 0.6, 0.1)), ("cylinder", (0.3, 0.1))])
def test_normal_of_a_grazing_floor(tmp_path, world, gap, shape, size):
    """Nearer than GJK can tell, two witness points are one: their difference is no direction.

    Nor is what an earlier question left behind: all_pairs and nearest agree, whichever comes first.
    """
    robot = Robot.load(write_robot(tmp_path, top='links = ["forearm_link"]'))
    position = np.array([0.0, -1.0, 1.3, 0.2, 0.5, 0.1])
    corners = world.triangles(position, "forearm_link")
    lowest, middle = corners[..., 2].min(), corners.reshape(-1, 3).mean(axis=0)
    place = (middle[0], middle[1], lowest - gap - 0.05)
    aside = Obstacle(id="o", shape=shape, size=size, position=(middle[0] + 1.0, 0.0, 0.3))
    model = DistanceModel(robot)
    for earlier in (model.nearest, model.all_pairs):
        model.set_obstacles([aside])
        earlier(position)
        model.set_obstacles([Obstacle(id="o", shape=shape, size=size, position=place)])
        for pair in (model.nearest(position), *model.all_pairs(position)):
            assert pair.distance == pytest.approx(gap, abs=5e-6)
            assert pair.normal == pytest.approx([0.0, 0.0, 1.0], abs=0.02)


@pytest.mark.parametrize("shape", ["sphere", "capsule", "cylinder", "box"])
def test_trap_2_a_pose_that_is_not_finite(robot, world, model, shape):
    """No such pose can be set; if one came about all the same, it would be contact and not far."""
    position = robot.rest_position
    far = raw(robot, world, position, "forearm_link", coal.Sphere(0.05), (math.nan, 0, 0))
    assert far > 1e300
    model.set_obstacles([random_obstacle(np.random.default_rng(0), shape)])
    slot = model._scene.slot(0)
    bad = np.array([math.nan, 0.0, 0.0])
    slot.placement.translation = bad
    slot.transform_core.setTranslation(bad)
    for pair in [model.nearest(position), *model.all_pairs(position)]:
        assert pair.distance <= 0.0
    assert (model.bounds(position) <= 0.0).all()


def test_trap_2_a_solver_that_fails(robot, model, monkeypatch):
    """Results of NaN and of 1.8e308 become contact, also beside sound ones."""
    model.set_obstacles([Obstacle(id="o", shape="sphere", size=(0.05,), position=(0.5, 0.3, 0.6))])
    true = model.nearest(robot.rest_position)
    assert true.distance > 0.05
    for value in (math.nan, math.inf, 1.7976931348623157e308):
        with monkeypatch.context() as patch:
            patch.setattr(coal, "distance", lambda *_, value=value: value)
            pairs = model.all_pairs(robot.rest_position)
            assert model.nearest(robot.rest_position).distance <= 0.0
        assert all(pair.distance <= true.distance for pair in pairs[:-1])
    failed = [math.nan] * model._scene.piece_count

    class Failed:
        min_distance = math.nan

    model._scene.results = [Failed() for _ in failed]
    assert (model.bounds(robot.rest_position) == -math.inf).all()
    nearest = model.nearest(robot.rest_position)
    assert math.isfinite(nearest.distance)


def test_trap_3_a_box_overwrites_the_carried_bound(robot, world, model):
    box = robot.collision.geometryObjects[robot.geometry_of_link["ee_link"][0]].geometry
    result, identity = coal.DistanceResult(), coal.Transform3s()
    result.min_distance = 0.1
    far = coal.Transform3s(np.eye(3), np.array([3.0, 0.0, 0.0]))
    coal.distance(box, identity, coal.Sphere(0.05), far, coal.DistanceRequest(), result)
    assert result.min_distance > 1.0  # the bound of 0.1 is gone
    rng = np.random.default_rng(3)
    for position in random_positions(robot, rng, 150):
        obstacles = [random_obstacle(rng, "sphere", str(i)) for i in range(2)]
        model.set_obstacles(obstacles)
        pairs = model.all_pairs(position)
        assert model.nearest(position).distance == min(p.distance for p in pairs)


def test_trap_4_a_bound_that_is_not_beaten(robot, model):
    """Coal then leaves NaN points; the exact tier says 'not below' instead."""
    rng = np.random.default_rng(4)
    refused = 0
    for position in random_positions(robot, rng, 20):
        for shape in ("sphere", "capsule", "cylinder", "box"):
            model.set_obstacles([random_obstacle(rng, shape)])
            pairs = {p.link: p for p in model.all_pairs(position)}
            hulls = model._scene.compute(robot.pinocchio_configuration(position))
            for part in model._parts:
                exact = pairs[part.link].distance
                assert model._exact.measure(part, 0, hulls[part.first : part.last], exact - 1e-4) is None
                below = model._exact.measure(part, 0, hulls[part.first : part.last], exact + 1e-3)
                assert below.distance == pytest.approx(exact, abs=5e-6)
                assert np.isfinite([*below.link_point, *below.obstacle_point]).all()
                refused += 1
    assert refused == 20 * 4 * 8


@pytest.mark.parametrize("shape", ["sphere", "capsule", "cylinder", "box"])
def test_trap_5_exactly_on_a_surface(robot, world, model, shape):
    """Centres on vertices and on faces: the raw normal is zero there, ours is of unit length."""
    position = robot.rest_position
    sizes = {"sphere": (0.03,), "capsule": (0.03, 0.1), "cylinder": (0.03, 0.1), "box": (0.05, 0.05, 0.05)}
    for link in ("forearm_link", "wrist_2_link", "upper_arm_link"):
        corners = world.triangles(position, link)
        for centre in (*corners[::997, 0], *corners[::997].mean(axis=1)):
            model.set_obstacles([Obstacle(id="o", shape=shape, size=sizes[shape], position=tuple(centre))])
            for pair in model.all_pairs(position):
                assert np.linalg.norm(pair.normal) == pytest.approx(1.0, abs=1e-6)
            own = next(p for p in model.all_pairs(position) if p.link == link)
            assert own.distance < 1e-6
            if shape == "sphere":
                assert own.distance < -0.03 + 5e-6


def test_centre_of_a_box_on_the_centre_of_a_box(robot, world, model):
    """Fully symmetric: any direction will do, but it must be one."""
    pose = world.placement(robot.rest_position, robot.geometry_of_link["ee_link"][0])
    for shape, size in (("sphere", (0.02,)), ("box", (0.01, 0.01, 0.01)), ("capsule", (0.02, 0.02))):
        model.set_obstacles([Obstacle(id="o", shape=shape, size=size, position=tuple(pose.translation))])
        pair = model.all_pairs(robot.rest_position)[-1]
        assert pair.distance < 0.0
        assert np.linalg.norm(pair.normal) == pytest.approx(1.0, abs=1e-6)


def test_thick_and_thin_spheres_are_equally_exact(robot, world, model):
    """Distance to the centre less the radius equals Coal's distance to the thick ball."""
    rng = np.random.default_rng(6)
    position = random_positions(robot, rng, 1)[0]
    for radius in (1e-6, 0.05, 0.3):
        centre = (0.6, 0.5, 0.7)
        model.set_obstacles([Obstacle(id="o", shape="sphere", size=(radius,), position=centre)])
        for pair in model.all_pairs(position)[:-1]:
            thick = raw(robot, world, position, pair.link, coal.Sphere(radius), centre)
            assert pair.distance == pytest.approx(thick, abs=1e-6)


def test_slabs_hold_every_triangle():
    """Also triangles that span several slabs, and slabs without any vertex."""
    rng = np.random.default_rng(7)
    vertices = np.vstack([rng.uniform(-1, 1, size=(20, 3)) * [3, 1, 1], [[-9, 0, 0], [9, 1, 0], [9, 0, 1]]])
    faces = rng.integers(0, 20, size=(30, 3))
    faces = np.vstack([faces, [[20, 21, 22]]])
    hulls = [convex_hull(points) for points in slab_points(vertices, faces, 7)]
    assert len(hulls) == 7
    weights = rng.dirichlet([1, 1, 1], size=400)
    samples = np.einsum("sk,ski->si", weights, vertices[faces[rng.integers(0, 31, size=400)]])
    normals = [(np.array(h.normals()), np.array(h.offsets())) for h in hulls]
    for point in samples:
        assert min((n @ point + o).max() for n, o in normals) < 1e-9


@pytest.mark.parametrize(
    "points", [[[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 0, 0], [1, 2, 3]], [[1, 1, 1]] * 4]
)
def test_flat_meshes_have_hulls(points):
    """Qhull inside Coal crashes the process on points in one plane."""
    points = np.array(points, dtype=float)
    hull = convex_hull(points)
    result = coal.DistanceResult()
    place = coal.Transform3s(np.eye(3), points.mean(axis=0) + 2.0 * np.eye(3)[2])
    distance = coal.distance(
        hull, coal.Transform3s(), coal.Sphere(0.1), place, coal.DistanceRequest(), result
    )
    obstacle = Obstacle(id="o", shape="sphere", size=(0.1,), position=tuple(place.getTranslation()))
    triangle = points[[0, 1, min(2, len(points) - 1)]][None]
    triangles = np.concatenate([triangle, points[[-1, 1, min(2, len(points) - 1)]][None]])
    assert distance == pytest.approx(brute_force(triangles, obstacle), abs=5e-5)

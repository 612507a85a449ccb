"""Meshes against boxes and cylinders: against closed forms, against Coal's own traversal, and in contact."""

import math
from types import SimpleNamespace

import coal
import numpy as np
import pytest
from model_oracle import (
    World,
    brute_force,
    quaternion_matrix,
    random_obstacle,
    random_positions,
    to_solid,
    write_robot,
)

from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.model import surface as surface_module
from ssm_service.model.surface import Solid, Surface, SurfaceDistance

SOLIDS = ("box", "cylinder")
UPRIGHT = np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0])
LYING = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # own z along the base's -y
ALONG_X = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))  # own z along the base's x
WORST = [
    ("box", (1.5, 1.0, 0.05), (0.0, 0.0, -0.1), None),  # a table under the arm
    ("box", (1.5, 0.05, 1.5), (0.0, 0.45, 0.4), None),  # a wall along it
    ("box", (2.0, 2.0, 2.0), (1.4, 0.3, 0.5), (0.1, 0.2, 0.3, 0.9)),
    ("box", (2.0, 2.0, 2.0), (1.2, 0.0, 0.5), None),
    ("box", (0.01, 0.01, 0.01), (0.15, 0.25, 0.35), (0.3, 0.1, 0.2, 0.8)),
    ("box", (0.001, 0.8, 0.8), (0.3, 0.0, 0.5), (0.0, 0.1, 0.0, 1.0)),
    ("cylinder", (0.1, 0.6), (0.3, 0.1, 0.4), None),  # along an upright arm
    ("cylinder", (0.1, 0.6), (0.35, 0.1, 0.4), ALONG_X),  # an end cap that faces it
    ("cylinder", (0.2, 0.1), (0.1, 0.5, 0.3), LYING),
    ("cylinder", (0.005, 2.0), (0.2, 0.2, 0.3), (0.2, 0.5, 0.1, 0.8)),  # a rope
    ("cylinder", (0.002, 2.0), (0.12, 0.15, 0.0), None),
    ("cylinder", (1.0, 0.01), (0.0, 0.0, 1.1), (0.1, 0.0, 0.0, 1.0)),  # a disc
    ("cylinder", (50.0, 0.2), (0.0, 0.0, -0.4), None),  # a floor
]
FILES = {
    "ur3": None,
    "ur10": None,
    "panda": (
        "example-robot-data:robots/panda_description/urdf/panda.urdf",
        "panda_link8",
        "[joints]\nfixed = {panda_finger_joint1 = 0.0, panda_finger_joint2 = 0.0}\n",
    ),
}


@pytest.fixture(scope="module", params=FILES)
def robot(request, tmp_path_factory):
    if FILES[request.param] is None:
        return Robot.load(request.param)
    urdf, frame, rest = FILES[request.param]
    return Robot.load(write_robot(tmp_path_factory.mktemp("arm"), urdf, frame, rest=rest))


@pytest.fixture(scope="module")
def world(robot):
    return World(robot)


@pytest.fixture(scope="module")
def model(robot):
    return DistanceModel(robot)


def solid_of(shape, size, position=(0.0, 0.0, 0.0), quaternion=None):
    quaternion = np.array((0.0, 0.0, 0.0, 1.0) if quaternion is None else quaternion)
    return Obstacle(
        id="o",
        shape=shape,
        size=size,
        position=position,
        quaternion_xyzw=tuple(quaternion / np.linalg.norm(quaternion)),
    )


def slot_of(obstacle):
    """What the scene keeps of an obstacle, as far as it is looked at here."""
    shape = coal.Box if obstacle.shape == "box" else coal.Cylinder
    return SimpleNamespace(
        shape=obstacle.shape,
        size=obstacle.size,
        solid=shape(*obstacle.size),
        transform_core=coal.Transform3s(
            quaternion_matrix(obstacle.quaternion_xyzw), np.array(obstacle.position)
        ),
    )


def mesh_of(corners):
    """A mesh of separate triangles, (m, 3, 3), as far as Coal's is looked at here."""
    return SimpleNamespace(
        num_tris=len(corners),
        vertices=lambda: np.reshape(corners, (-1, 3)),
        tri_indices=lambda i: (3 * i, 3 * i + 1, 3 * i + 2),
    )


def measure(corners, obstacle, limit=math.inf, distance=None):
    identity = coal.Transform3s()
    return (distance or SurfaceDistance()).measure(
        Surface(mesh_of(corners)), identity, slot_of(obstacle), limit
    )


def scenes(robot, rng, count):
    """Positions with an obstacle each: the worst cases, upright and not, then random ones of many sizes."""
    upright = np.resize(UPRIGHT, len(robot.joint_names)).clip(robot.position_lower, robot.position_upper)
    positions = [upright, *random_positions(robot, rng, count - 1)]
    for worst in WORST:
        yield upright, solid_of(*worst)
        yield positions[-1], solid_of(*worst)
    for position in positions:
        for shape in SOLIDS:
            yield position, random_obstacle(rng, shape)


def test_distance_is_that_of_the_triangles(robot, world, model):
    rng, free = np.random.default_rng(30), 0
    for position, obstacle in scenes(robot, rng, 3):
        model.set_obstacles([obstacle])
        pairs = sorted(model.all_pairs(position), key=lambda p: p.distance)
        for pair in [p for p in pairs if p.link in world.meshes][:4]:
            expected = brute_force(world.triangles(position, pair.link), obstacle)
            assert pair.distance <= expected + 2e-6
            if pair.distance > 0.0:
                free += 1
                assert pair.distance == pytest.approx(expected, abs=1e-5)
        nearest = model.nearest(position)
        assert nearest.distance == pytest.approx(pairs[0].distance, abs=2e-6)
    assert free > 50


def test_agrees_with_coal_s_own_traversal(robot, world):
    """And with itself under a limit: not below it, or the same."""
    surfaces = {
        i: Surface(robot.collision.geometryObjects[i].geometry) for m in world.meshes.values() for i, *_ in m
    }
    ours, request, result = SurfaceDistance(), coal.DistanceRequest(), coal.DistanceResult()
    rng, free, touching = np.random.default_rng(31), 0, 0
    for position, obstacle in scenes(robot, rng, 12):
        slot = slot_of(obstacle)
        for index in rng.choice(list(surfaces), size=3, replace=False).tolist():
            mesh = robot.collision.geometryObjects[index].geometry
            pose = coal.Transform3s(world.placement(position, index))
            result.clear()
            theirs = coal.distance(mesh, pose, slot.solid, slot.transform_core, request, result)
            found = ours.measure(surfaces[index], pose, slot)
            assert found.distance == pytest.approx(max(theirs, 0.0), abs=2e-6)
            if found.distance > 1e-5:
                free += 1
                assert ours.measure(surfaces[index], pose, slot, found.distance - 1e-5) is None
                below = ours.measure(surfaces[index], pose, slot, found.distance + 1e-5)
                assert below.distance == pytest.approx(found.distance, abs=1e-6)
            else:
                touching += 1
                assert ours.measure(surfaces[index], pose, slot, 1e-9).distance == 0.0
    assert free > 60
    assert touching > 3


def test_points_lie_on_both_surfaces(robot, world, model):
    rng, free = np.random.default_rng(32), 0
    for position, obstacle in scenes(robot, rng, 3):
        model.set_obstacles([obstacle])
        for pair in model.all_pairs(position):
            if pair.link not in world.meshes or pair.distance < 1e-4:
                continue
            free += 1
            on_link, on_solid = pair.point_on_link, pair.point_on_obstacle
            assert np.linalg.norm(on_link - on_solid) == pytest.approx(pair.distance, abs=2e-6)
            assert pair.normal == pytest.approx((on_link - on_solid) / pair.distance, abs=2e-2)
            assert to_solid(on_solid, obstacle) < 2e-6
            assert to_solid(on_solid + 1e-4 * pair.normal, obstacle) == pytest.approx(1e-4, abs=4e-6)
            ball = Obstacle(id="p", shape="sphere", size=(1e-9,), position=tuple(on_link))
            if free % 7 == 0:
                assert brute_force(world.triangles(position, pair.link), ball) < 2e-6
    assert free > 100


@pytest.mark.parametrize("shape", SOLIDS)
def test_bounds_are_below_the_distance(shape):
    """The two inequalities that everything rests upon, at random points, and tight where they touch."""
    rng = np.random.default_rng(33)
    for _ in range(200):
        size = tuple(10.0 ** rng.uniform(-3, 1, size=3 if shape == "box" else 2))
        solid, obstacle = Solid(shape, size), solid_of(shape, size)
        points = rng.normal(size=(3, 40)) * max(size)
        distances, slopes = solid.slope(points)
        assert distances == pytest.approx(to_solid(points.T, obstacle), abs=1e-12)
        assert to_solid(solid.nearest(points).T, obstacle) == pytest.approx(0.0, abs=1e-12)
        outside = distances > 0.0
        assert np.linalg.norm(slopes, axis=0) == pytest.approx(outside.astype(float), abs=1e-9)
        tangents = distances[:, None] + slopes.T @ points - (slopes * points).sum(axis=0)[:, None]
        assert (tangents <= distances + 1e-12 * max(size)).all()
        for k in np.flatnonzero(outside)[:5]:
            planes = slopes[:, k] @ points - solid.support(slopes[:, k])
            assert (planes <= distances + 1e-12 * max(size)).all()
            assert planes[k] == pytest.approx(distances[k], abs=1e-9)


@pytest.mark.parametrize("shape", SOLIDS)
def test_triangles_of_every_size_and_none(shape):
    """Needles, points, and triangles far greater or smaller than the solid; seen from near and afar."""
    rng, ours, free = np.random.default_rng(34), SurfaceDistance(), 0
    for round_ in range(80):
        scale, count = 10.0 ** rng.uniform(-3, 0), int(rng.integers(1, 60))
        middles = rng.normal(size=(count, 1, 3)) * scale
        corners = middles + rng.normal(size=(count, 3, 3)) * scale * 10.0 ** rng.uniform(-3, 0)
        if round_ % 3 == 0:  # three points of one line, and of no line
            corners[:, 2] = corners[:, 0] + (corners[:, 1] - corners[:, 0]) * rng.uniform(size=(count, 1))
        if round_ % 7 == 0:
            corners[:, 1] = corners[:, 0]
        direction = rng.normal(size=3)
        size = 10.0 ** rng.uniform(-3, 1, size=3 if shape == "box" else 2)
        away = direction / np.linalg.norm(direction) * (size.max() + scale * rng.uniform(0.5, 5.0))
        obstacle = solid_of(shape, tuple(size), tuple(away), rng.normal(size=4))
        expected = brute_force(corners, obstacle)
        found = measure(corners, obstacle, distance=ours)
        assert found.distance == pytest.approx(expected, abs=1e-5)
        if found.distance > 0.0:
            free += 1
            apart = np.linalg.norm(found.mesh_point - found.solid_point)
            assert apart == pytest.approx(found.distance, abs=1e-12)
            assert to_solid(found.mesh_point, obstacle) == pytest.approx(found.distance, abs=1e-12)
    assert free > 50


def test_a_hollow_link_is_measured_in_its_hollow():
    """A gutter: the hull says contact, the triangles do not; its rims are seen, and its bottom."""
    angles = np.linspace(0.0, np.pi, 60)
    rim = np.stack([0.2 * np.cos(angles), -0.2 * np.sin(angles), np.zeros(60)], axis=1)
    far = rim + np.array([0.0, 0.0, 1.0])
    corners = np.concatenate(
        [np.stack([rim[:-1], rim[1:], far[:-1]], axis=1), np.stack([rim[1:], far[1:], far[:-1]], axis=1)]
    )
    for radius, height in ((0.05, 0.0), (0.05, -0.1), (0.12, 0.15), (0.01, -0.18), (0.15, 0.0)):
        obstacle = solid_of("cylinder", (radius, 0.4), (0.03, height, 0.5))
        found = measure(corners, obstacle)
        assert found.distance > 0.005
        assert found.distance == pytest.approx(brute_force(corners, obstacle), abs=1e-5)


TRIANGLE = np.array([[[-5.0, -4.0, 0.0], [5.0, -4.0, 0.0], [0.0, 6.0, 0.0]]])


@pytest.mark.parametrize(
    "obstacle",
    [
        solid_of("cylinder", (0.01, 1.0), (0.3, 0.2, 0.1), (0.1, 0.2, 0.0, 1.0)),  # a needle through it
        solid_of("box", (0.01, 0.01, 1.0), (0.3, 0.2, 0.1), (0.1, 0.2, 0.0, 1.0)),
        solid_of("box", (50.0, 50.0, 50.0), (1.0, 2.0, 3.0)),  # holds it all
        solid_of("cylinder", (50.0, 50.0), (1.0, 2.0, 3.0)),
        solid_of("box", (0.2, 0.2, 0.2), (0.0, -4.05, 0.0)),  # an edge
        solid_of("box", (1.0, 1.0, 1.0), (0.3, 0.2, 0.5)),  # face on face
        solid_of("cylinder", (1.0, 1.0), (0.3, 0.2, 0.5)),
    ],
)
def test_touching_is_no_distance(obstacle):
    assert measure(TRIANGLE, obstacle).distance == 0.0
    aside = np.array([0.0, 0.0, 1e3])
    beside = np.concatenate([TRIANGLE + aside, TRIANGLE, TRIANGLE - aside])
    for limit in (1e-9, 1e-6, 1.0):
        assert measure(beside, obstacle, limit).distance == 0.0


@pytest.mark.parametrize("shape", SOLIDS)
def test_what_touches_is_the_hull_s_business(model, robot, shape):
    """Contact counts also beside a triangle that is nearly as near; then the hull pieces decide, signed."""
    rng, contacts = np.random.default_rng(35), 0
    for position in random_positions(robot, rng, 25):
        model.set_obstacles([random_obstacle(rng, shape, reach=0.5)])
        hulls = model._scene.compute(robot.pinocchio_configuration(position))
        slot = model._scene.slot(0)
        for part in [part for part in model._parts if part.is_mesh]:
            transform = coal.Transform3s(model._scene.placement_of(part))
            found = SurfaceDistance().measure(model._exact._surfaces[part.first], transform, slot)
            if found.distance == 0.0:
                contacts += 1
                measured = model._exact.measure(part, 0, hulls[part.first : part.last])
                assert not measured.by_mesh
                assert measured.distance <= 2e-6
    assert contacts > 8


@pytest.mark.parametrize("gap", [2e-7, 1e-6, 1e-3])
def test_a_touch_is_found_behind_a_near_miss(gap):
    """What is nearer by less than the tolerance is not looked for, unless it may touch."""
    obstacle = solid_of("box", (1.0, 1.0, 1.0))
    across = np.array([[0.05, 0.0, -0.05], [-0.05, 0.05, 0.05], [-0.05, -0.05, 0.05]])
    near = across[None] + np.array([0.5, 0.0, 0.5]) + gap * math.sqrt(0.5) * np.array([1.0, 0.0, 1.0])
    assert measure(near, obstacle).distance == pytest.approx(gap, abs=1e-7)
    through = np.array([[[-0.4, -0.1, 0.4999], [-0.2, -0.1, 0.4999], [-0.3, 0.1, 0.4999]]])
    many = np.repeat(near, 32, axis=0), np.repeat(through, 32, axis=0)  # the box round the first reaches in
    assert measure(np.concatenate(many), obstacle).distance == 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.7976931348623157e308, -1.0, 0.0])
def test_a_solver_that_fails_is_contact(monkeypatch, value):
    for obstacle in (
        solid_of("box", (1.0, 1.0, 1.0), (0, 0, 2.0)),
        solid_of("cylinder", (1.0, 1.0), (0, 0, 2.0)),
    ):
        assert measure(TRIANGLE, obstacle).distance == pytest.approx(1.5)
        with monkeypatch.context() as patch:
            patch.setattr(coal, "distance", lambda *_: value)
            assert measure(TRIANGLE, obstacle).distance == 0.0


@pytest.mark.parametrize("wrong", [-0.01, 0.01])
def test_a_distance_outside_its_bounds_is_contact(monkeypatch, wrong):
    """A flat triangle above a face: both bounds are exact, and a solver that says else has failed."""
    obstacle = solid_of("box", (50.0, 50.0, 1.0), (0.0, 0.0, 2.0))
    true = coal.distance
    monkeypatch.setattr(coal, "distance", lambda *a: true(*a) + wrong)
    assert measure(TRIANGLE, obstacle).distance == 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("shape", SOLIDS)
def test_a_pose_that_is_not_finite_is_contact(robot, model, shape, value):
    size = (0.1,) * (3 if shape == "box" else 2)
    slot, surface = slot_of(solid_of(shape, size)), Surface(mesh_of(TRIANGLE))
    slot.transform_core.setTranslation(np.array([0.0, value, 0.0]))
    with np.errstate(invalid="ignore"):
        assert SurfaceDistance().measure(surface, coal.Transform3s(), slot).distance == 0.0


def test_points_that_are_not_finite_hide_nothing(monkeypatch):
    """GJK's points give the plane that rules out others; without them it rules out none."""
    corners = TRIANGLE[:, None] * np.array([1.0, 1e-3])[None, :, None, None]
    corners = corners.reshape(-1, 3, 3) + np.array([[[0.0, 0.0, 0.2]], [[0.0, 0.0, 0.1]]])
    ours = SurfaceDistance()
    result = ours._result

    class Blind:
        def __getattr__(self, name):
            return getattr(result, name)

        def getNearestPoint2(self):
            return np.full(3, math.nan)

    obstacle = solid_of("cylinder", (0.5, 1.0), (0.0, 0.0, -1.0))
    expected = measure(corners, obstacle, distance=ours).distance
    true = coal.distance
    monkeypatch.setattr(coal, "distance", lambda *a: true(*a[:-1], result))
    ours._result = Blind()
    assert measure(corners, obstacle, distance=ours).distance == pytest.approx(expected, abs=1e-6)


def area(corners):
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


@pytest.mark.parametrize("count", [1, 2, 31, 32, 33, 1000])
def test_clusters_hold_every_triangle(count):
    """Short ones as they are, long ones in pieces, in boxes that hold them."""
    rng = np.random.default_rng(36)
    corners = rng.normal(size=(count, 1, 3)) + 0.01 * rng.normal(size=(count, 3, 3))
    corners[0] *= 30.0
    surface = Surface(mesh_of(corners))
    again = (surface.centroids + surface.offsets).transpose(2, 3, 0, 1)  # (k, w, 3 corners, 3)
    boxes = np.abs(again - surface.middles.T[:, None, None]) <= surface.halves.T[:, None, None] + 1e-9
    assert boxes.all()
    pieces = np.unique(again.reshape(-1, 9).round(9), axis=0).reshape(-1, 3, 3)
    assert area(pieces).sum() == pytest.approx(area(corners).sum(), rel=1e-6)
    if count > 1:
        known = {tuple(c) for c in again.reshape(-1, 9).round(9)}
        assert all(tuple(c) in known for c in corners[1:].reshape(-1, 9).round(9))
    edges = np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2)
    assert edges.max() <= 0.25 * np.ptp(corners.reshape(-1, 3), axis=0).max() + 1e-6
    with pytest.raises(ValueError, match="read-only"):
        surface.centroids[0] = 0.0


def test_few_triangles_are_measured(robot, model, monkeypatch):
    """What makes a tick fast, counted and not timed: Coal's traversal looks at thousands."""
    counts = []
    true = SurfaceDistance._triangle_distance

    def counted(*args):
        counts[-1] += 1
        return true(*args)

    monkeypatch.setattr(SurfaceDistance, "_triangle_distance", counted)
    for position, obstacle in scenes(robot, np.random.default_rng(37), 30):
        counts.append(0)
        model.set_obstacles([obstacle])
        model.nearest(position)
    assert max(counts) < 100
    assert np.mean(counts) < 15
    assert surface_module._TIGHT_M <= 1e-6


def test_memory_is_small(model):
    for surface in model._exact._surfaces.values():
        arrays = (surface.middles, surface.halves, surface.centroids, surface.offsets)
        assert sum(array.nbytes for array in arrays) < 2e6

import numpy as np
import pytest
from model_oracle import World, brute_force, inside, moved, random_obstacle, random_positions, write_robot

from ssm_service.errors import InputError
from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.model.exact import ExactTier
from ssm_service.model.scene import Scene

SHAPES = ("sphere", "capsule", "cylinder", "box")
TOLERANCE = {"sphere": 1e-6, "capsule": 1e-5, "cylinder": 1e-5, "box": 1e-5}


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


@pytest.fixture(scope="module")
def world(robot):
    return World(robot)


@pytest.fixture(scope="module")
def model(robot):
    return DistanceModel(robot)


def key(pair):
    return pair.link, pair.obstacle


@pytest.mark.parametrize("shape", SHAPES)
def test_distance_is_that_of_the_triangles(robot, world, model, shape):
    """In contact, where a mesh has no answer, never less severe than the triangles, and deep inside deep."""
    rng = np.random.default_rng(10)
    free = 0
    for position in random_positions(robot, rng, 12):
        obstacle = random_obstacle(rng, shape)
        model.set_obstacles([obstacle])
        pairs = sorted(model.all_pairs(position), key=lambda p: p.distance)
        bounds = dict(zip(robot.monitored_links, model.bounds(position)[:, 0], strict=True))
        for pair in [p for p in pairs if p.link in world.meshes][:4]:
            corners = world.triangles(position, pair.link)
            expected = brute_force(corners, obstacle)
            assert pair.distance <= expected + TOLERANCE[shape]
            if inside(corners, np.array(obstacle.position)):
                assert pair.distance < -obstacle.size[0] / 2
            elif bounds[pair.link] > 0 or shape == "sphere":
                free += 1
                assert pair.distance == pytest.approx(expected, abs=TOLERANCE[shape])
    assert free > 30


def test_inside_sphere_is_deep(robot, world, model):
    """A ball wholly inside a mesh reads as far from it (trap 1); here it is contact."""
    rng = np.random.default_rng(11)
    for position in random_positions(robot, rng, 10):
        corners = world.triangles(position, "upper_arm_link")
        # the upper arm's mesh spans its link: the middle of its bounding box may lie beside it, so search
        points = rng.uniform(corners.min(axis=(0, 1)), corners.max(axis=(0, 1)), size=(60, 3))
        centre = next(p for p in points if inside(corners, p))
        model.set_obstacles([Obstacle(id="o", shape="sphere", size=(0.004,), position=tuple(centre))])
        pair = next(p for p in model.all_pairs(position) if p.link == "upper_arm_link")
        assert pair.distance < -0.004
        assert model.nearest(position).distance <= pair.distance
        step = 2 * pair.distance * pair.normal  # pushes the ball out along -normal
        model.set_obstacles(
            [moved(Obstacle(id="o", shape="sphere", size=(0.004,), position=tuple(centre)), step)]
        )
        after = next(p for p in model.all_pairs(position) if p.link == "upper_arm_link")
        assert after.distance > pair.distance + 1e-3


@pytest.mark.parametrize("shape", SHAPES)
def test_bounds_are_never_above_exact_and_not_far_below(robot, model, shape):
    rng = np.random.default_rng(12)
    gaps = []
    for position in random_positions(robot, rng, 40):
        model.set_obstacles([random_obstacle(rng, shape, str(i)) for i in range(3)])
        exact = np.array([p.distance for p in model.all_pairs(position)]).reshape(-1, 3)
        bounds = model.bounds(position)
        assert bounds.shape == exact.shape
        gaps.append(exact - bounds)
    gaps = np.array(gaps)
    assert gaps.min() >= 0.0
    assert np.median(gaps) < 1e-4
    assert gaps.max() < 0.02


def test_bounds_hold_for_a_large_floor(robot, model):
    rng = np.random.default_rng(13)
    floor = Obstacle(id="floor", shape="box", size=(50.0, 50.0, 1.0), position=(0.0, 0.0, -0.9))
    model.set_obstacles([floor])
    world = World(robot)
    for position in random_positions(robot, rng, 10):
        exact = {p.link: p for p in model.all_pairs(position)}
        assert all(model.bounds(position)[:, 0] <= [p.distance for p in exact.values()])
        for link in ("base_link", "forearm_link", "wrist_3_link"):
            lowest = world.triangles(position, link)[..., 2].min()
            if lowest > -0.4:
                assert exact[link].distance == pytest.approx(lowest + 0.4, abs=1e-5)
                assert exact[link].normal == pytest.approx([0, 0, 1], abs=1e-3)


@pytest.mark.parametrize("shape", [*SHAPES, "mixed"])
def test_nearest_is_the_least_of_all_pairs(robot, model, shape):
    rng = np.random.default_rng(14)
    links = set()
    for round_, position in enumerate(random_positions(robot, rng, 60)):
        kinds = [shape] * 5 if shape != "mixed" else list(rng.choice(SHAPES, size=6))
        reach = 0.4 if round_ % 3 == 0 else 1.2
        model.set_obstacles([random_obstacle(rng, k, str(i), reach) for i, k in enumerate(kinds)])
        nearest = model.nearest(position)
        least = min(model.all_pairs(position), key=lambda p: p.distance)
        assert nearest.distance == pytest.approx(least.distance, abs=2e-6)
        if nearest.distance > 1e-4:
            assert key(nearest) == key(least)
            assert nearest.normal == pytest.approx(least.normal, abs=1e-2)
        links.add(nearest.link)
        one = robot.monitored_links[round_ % len(robot.monitored_links)]
        of_one = min((p for p in model.all_pairs(position) if p.link == one), key=lambda p: p.distance)
        model.nearest(position)  # all_pairs leaves no bounds behind
        assert model.distance_from(one) == pytest.approx(of_one.distance, abs=2e-6)
        found = model.nearest(position, one)
        assert (found.link, found.distance) == (one, pytest.approx(of_one.distance, abs=2e-6))
    assert len(links) >= 4


def test_the_nearest_of_a_link_that_is_not_monitored_is_refused(model):
    with pytest.raises(InputError) as error:
        model.distance_from("tool7")
    with pytest.raises(InputError):
        model.nearest(np.zeros(6), "tool7")
    assert error.value.cause == "unknown_link"
    assert "forearm_link" in str(error.value)


def test_primitive_and_mesh_links_compete_fairly(tmp_path):
    """A box link among mesh links, nearest now here and now there (the UR3's own lies within its wrist)."""
    robot = Robot.load(write_robot(tmp_path, top='links = ["ee_link", "wrist_2_link", "forearm_link"]'))
    model, rng, links = DistanceModel(robot), np.random.default_rng(22), set()
    for position in random_positions(robot, rng, 100):
        model.set_obstacles([random_obstacle(rng, s, s) for s in ("sphere", "sphere", "box")])
        nearest = model.nearest(position)
        least = min(model.all_pairs(position), key=lambda p: p.distance)
        assert nearest.distance == pytest.approx(least.distance, abs=2e-6)
        assert nearest.link == least.link or nearest.distance < 1e-4
        links.add(nearest.link)
    assert links == set(robot.monitored_links)


def test_points_and_normal_agree_with_the_distance(robot, model):
    rng = np.random.default_rng(15)
    contacts = 0
    for position in random_positions(robot, rng, 40):
        model.set_obstacles([random_obstacle(rng, s, s) for s in SHAPES])
        for pair in model.all_pairs(position):
            assert np.linalg.norm(pair.normal) == pytest.approx(1.0, abs=1e-9)
            assert np.isfinite([*pair.point_on_link, *pair.point_on_obstacle, pair.distance]).all()
            delta = pair.point_on_link - pair.point_on_obstacle
            assert np.linalg.norm(delta) == pytest.approx(abs(pair.distance), abs=5e-5)
            assert delta @ pair.normal == pytest.approx(pair.distance, abs=5e-5)
            assert not pair.normal.flags.writeable
            contacts += pair.distance < 0
    assert contacts > 20


@pytest.mark.parametrize("shape", SHAPES)
def test_moving_against_the_normal_moves_away(robot, model, shape):
    """From obstacle to link, in penetration too: a flipped normal would lock the robot."""
    rng = np.random.default_rng(16)
    contacts = 0
    for position in random_positions(robot, rng, 60):
        obstacle = random_obstacle(rng, shape, reach=0.6)
        model.set_obstacles([obstacle])
        before = {p.link: p for p in model.all_pairs(position)}
        for link in ("forearm_link", "upper_arm_link", "ee_link", "base_link"):
            pair = before[link]
            step = 1e-3
            model.set_obstacles([moved(obstacle, -step * pair.normal)])
            after = next(p for p in model.all_pairs(position) if p.link == link)
            assert after.distance > pair.distance
            if pair.distance > 1e-3:
                assert after.distance == pytest.approx(pair.distance + step, abs=1e-5)
            contacts += pair.distance < 0
    assert contacts > 5


def test_primitive_link_against_a_sphere_has_a_closed_form(robot, world, model):
    rng = np.random.default_rng(17)
    index = robot.geometry_of_link["ee_link"][0]
    half = np.array(robot.collision.geometryObjects[index].geometry.halfSide)
    signs = set()
    for position in random_positions(robot, rng, 200):
        pose = world.placement(position, index)
        local = rng.uniform(-0.15, 0.15, size=3) if len(signs) < 2 or rng.random() < 0.9 else np.zeros(3)
        radius = rng.uniform(0.01, 0.1)
        centre = pose.act(local)
        model.set_obstacles([Obstacle(id="o", shape="sphere", size=(radius,), position=tuple(centre))])
        pair = model.all_pairs(position)[-1]
        outside = np.abs(local) - half
        signed = np.linalg.norm(np.maximum(outside, 0)) + min(outside.max(), 0.0)
        assert pair.link == "ee_link"
        assert pair.distance == pytest.approx(signed - radius, abs=2e-6)
        signs.add(np.sign(pair.distance))
    assert signs == {-1.0, 1.0}


def test_distance_is_invariant_under_the_first_joint(robot, model):
    """Turning the first joint turns everything but the base: a rigid motion of robot and obstacle."""
    rng = np.random.default_rng(18)
    for position in random_positions(robot, rng, 20):
        angle = rng.uniform(-2, 2)
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        for shape in SHAPES:
            first = random_obstacle(rng, shape)
            x, y, z, w = first.quaternion_xyzw
            ch, sh = np.cos(angle / 2), np.sin(angle / 2)
            quaternion = (ch * x - sh * y, ch * y + sh * x, ch * z + sh * w, ch * w - sh * z)
            second = Obstacle(
                id="o",
                shape=shape,
                size=first.size,
                position=tuple(turn @ first.position),
                quaternion_xyzw=quaternion,
            )
            other = position.copy()
            other[0] += angle
            model.set_obstacles([first])
            a = model.all_pairs(position)[2:]
            model.set_obstacles([second])
            b = model.all_pairs(other)[2:]
            for one, two in zip(a, b, strict=True):
                assert two.distance == pytest.approx(one.distance, abs=5e-6)
                if one.distance > 0.01 and shape == "sphere":
                    assert two.normal == pytest.approx(turn @ one.normal, abs=1e-4)


def test_changing_sets_give_the_same_as_a_fresh_model(robot, model):
    """Grow, shrink, empty, other shapes, other sizes: whatever was written before leaves no trace."""
    rng = np.random.default_rng(19)
    model.set_obstacles([random_obstacle(rng, "sphere", "old", 0.2)])
    for count in (1, 3, 0, 45, 2, 0, 6):
        position = random_positions(robot, rng, 1)[0]
        obstacles = [random_obstacle(rng, str(rng.choice(SHAPES)), f"o{i}") for i in range(count)]
        model.set_obstacles(obstacles)
        fresh = DistanceModel(robot)
        fresh.set_obstacles(obstacles)
        assert model.obstacle_ids == tuple(o.id for o in obstacles)
        ours, theirs = model.all_pairs(position), fresh.all_pairs(position)
        assert [key(p) for p in ours] == [key(p) for p in theirs]
        assert [key(p) for p in ours] == [(n, o.id) for n in robot.monitored_links for o in obstacles]
        for a, b in zip(ours, theirs, strict=True):
            assert a.distance == pytest.approx(b.distance, abs=1e-9)
        assert model.bounds(position) == pytest.approx(fresh.bounds(position), abs=2e-6)
        nearest = model.nearest(position)
        assert (nearest is None) == (count == 0)
        if nearest is not None:
            assert nearest.distance == pytest.approx(min(p.distance for p in theirs), abs=2e-6)


def test_results_do_not_depend_on_earlier_calls(robot, model):
    """Replay is exact: the same question has the same answer, to the bit."""
    rng = np.random.default_rng(20)
    fresh = DistanceModel(robot)
    for position in random_positions(robot, rng, 40):
        obstacles = [random_obstacle(rng, "sphere", str(i), 0.7) for i in range(3)]
        model.set_obstacles(obstacles)
        for other in random_positions(robot, rng, 3):
            model.nearest(other)
        fresh.set_obstacles(obstacles)
        a, b = model.nearest(position), fresh.nearest(position)
        assert (a.link, a.obstacle, a.distance) == (b.link, b.obstacle, b.distance)
        assert a.normal.tolist() == b.normal.tolist()


def test_no_obstacles(robot, model):
    model.set_obstacles([])
    assert model.nearest(robot.rest_position) is None
    assert model.all_pairs(robot.rest_position) == []
    assert model.bounds(robot.rest_position).shape == (8, 0)


@pytest.mark.parametrize("count", [0, 1])
@pytest.mark.parametrize(
    ("position", "cause"),
    [
        ([0, 0, float("nan"), 0, 0, 0], "not_finite"),
        ([0, float("inf"), 0, 0, 0, 0], "not_finite"),
        ([0] * 5, "wrong_length"),
    ],
)
def test_bad_positions_are_refused(model, count, position, cause):
    """Coal calls a NaN pose infinitely far (trap 2)."""
    model.set_obstacles([Obstacle(id="o", shape="sphere", size=(0.1,), position=(0.4, 0.0, 0.0))][:count])
    for ask in (model.nearest, model.bounds, model.all_pairs):
        with pytest.raises(InputError) as caught:
            ask(position)
        assert caught.value.cause == cause


def test_few_pairs_are_measured_to_the_triangles(robot, model, monkeypatch):
    """What makes a tick fast, counted and not timed: of 80 pairs, the bounds leave one or two."""
    rng, count, hulls = np.random.default_rng(21), [], []
    measure, hull = ExactTier.measure, Scene.measure
    monkeypatch.setattr(ExactTier, "measure", lambda *a: count.append(1) or measure(*a))
    monkeypatch.setattr(Scene, "measure", lambda *a: hulls.append(1) or hull(*a))
    for position in random_positions(robot, rng, 100):
        model.set_obstacles([random_obstacle(rng, "sphere", str(i), 1.2) for i in range(10)])
        model.nearest(position)
    assert 100 <= len(count) < 300
    assert len(hulls) < 2500

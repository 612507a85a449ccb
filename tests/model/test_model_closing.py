"""Pairs as arrays, and how fast their points move: against finite differences and the slow way."""

from __future__ import annotations

import numpy as np
import pytest

from ssm_service.errors import ConfigError, InputError
from ssm_service.model import (
    DistanceModel,
    Obstacle,
    Robot,
    closing_gradients,
    moved_by,
    outermost_points,
    point_jacobians,
)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.load("ur3")


@pytest.fixture(scope="module")
def model(robot: Robot) -> DistanceModel:
    return DistanceModel(robot)


def position(random: np.random.Generator) -> np.ndarray:
    return random.uniform(-2.0, 2.0, 6)


def around(random: np.random.Generator) -> list[Obstacle]:
    places = random.uniform((-0.8, -0.8, -0.4), (0.8, 0.8, 1.2), (4, 3))
    return [
        Obstacle(id="ball", shape="sphere", size=(0.05,), position=tuple(places[0])),
        Obstacle(id="arm", shape="capsule", size=(0.05, 0.3), position=tuple(places[1])),
        Obstacle(id="box", shape="box", size=(0.1, 0.2, 0.1), position=tuple(places[2])),
        Obstacle(id="post", shape="cylinder", size=(0.05, 0.4), position=tuple(places[3])),
    ]


def test_pairs_are_bounds_until_they_are_refined(robot: Robot, model: DistanceModel) -> None:
    random = np.random.default_rng(1)
    for _ in range(10):
        q = position(random)
        model.set_obstacles(around(random))
        exact = model.all_pairs(q)
        pairs = model.pairs(q)
        names = [
            (pairs.links[i], pairs.obstacles[j]) for i, j in zip(pairs.link, pairs.obstacle, strict=True)
        ]
        assert names == [(pair.link, pair.obstacle) for pair in exact]
        true = np.array([pair.distance for pair in exact])
        assert (pairs.distance <= true).all()
        assert pairs.distance == pytest.approx(model.bounds(q).ravel(), abs=1e-5)
        apart = pairs.distance > 1e-3
        across = pairs.point_on_link - pairs.point_on_obstacle
        assert np.linalg.norm(across[apart], axis=1) == pytest.approx(pairs.distance[apart], abs=2e-5)
        assert np.linalg.norm(pairs.normal, axis=1) == pytest.approx(np.ones(len(pairs)))
        along = (across * pairs.normal).sum(axis=1)
        assert along[apart] == pytest.approx(pairs.distance[apart], abs=2e-5)
        assert not pairs.exact.any()
        rows = random.permutation(len(pairs))[:9].tolist()
        model.refine(pairs, rows)
        assert pairs.exact.nonzero()[0].tolist() == sorted(rows)
        assert pairs.distance[rows] == pytest.approx(true[rows], abs=1e-9)
        for row in rows:
            assert pairs.normal[row] == pytest.approx(exact[row].normal, abs=1e-6)


def test_pairs_below_a_limit_are_those_of_all(robot: Robot, model: DistanceModel) -> None:
    random, seen = np.random.default_rng(5), 0
    for _ in range(10):
        q = position(random)
        model.set_obstacles(around(random))
        every = model.pairs(q)
        limits = random.uniform(0.0, 0.5, (len(every.links), len(every.obstacles)))
        near = (every.distance < limits.ravel()).nonzero()[0]
        some = model.below(q, limits)
        seen += len(near)
        for name in ("link", "obstacle"):
            np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[near])
        # Coal begins each search where the last one ended.
        assert some.distance == pytest.approx(every.distance[near], abs=2e-6)
        far = some.distance > 0.05
        assert some.normal[far] == pytest.approx(every.normal[near][far], abs=1e-2)
        across = some.point_on_link - some.point_on_obstacle
        apart = some.distance > 1e-3
        assert (across * some.normal).sum(axis=1)[apart] == pytest.approx(some.distance[apart], abs=2e-5)
        assert np.linalg.norm(across[apart], axis=1) == pytest.approx(some.distance[apart], abs=2e-5)
        assert (some.links, some.obstacles) == (every.links, every.obstacles)
        if len(near):
            exact = model.all_pairs(q)[near[-1]]
            some = model.below(q, limits)
            model.refine(some, [len(near) - 1])
            assert some.distance[-1] == pytest.approx(exact.distance, abs=1e-9)
            assert some.exact.tolist() == [False] * (len(near) - 1) + [True]
    assert seen > 20


def test_no_pair_is_below_nothing(robot: Robot, model: DistanceModel) -> None:
    model.set_obstacles(around(np.random.default_rng(3)))
    count = len(robot.monitored_links)
    nothing = model.below(np.zeros(6), np.full((count, 4), -1.0))
    assert (len(nothing), nothing.obstacles) == (0, ("ball", "arm", "box", "post"))
    assert nothing.normal.shape == (0, 3)
    model.set_obstacles(())
    assert len(model.below(np.zeros(6), np.full((count, 0), 9.0))) == 0


def test_what_stood_there_before_is_not_taken_for_what_stands_there_now(
    robot: Robot, model: DistanceModel
) -> None:
    """Placements are kept from call to call; obstacles, the arm and other questions come between."""
    random = np.random.default_rng(8)
    q, other, first, second = position(random), position(random), around(random), around(random)
    limits = np.full((len(robot.monitored_links), 4), 0.6)

    def asked(where: np.ndarray) -> list[float]:
        found = model.below(where, limits)
        return [*found.distance.tolist(), *found.normal.ravel().tolist()]

    answers = {}
    for name, obstacles in (("first", first), ("second", second)):
        for place in (q, other):
            fresh = DistanceModel(robot)
            fresh.set_obstacles(obstacles)
            found = fresh.below(place, limits)
            answers[name, place.tobytes()] = [*found.distance.tolist(), *found.normal.ravel().tolist()]
    assert len({str(answer) for answer in answers.values()}) == 4
    for name, obstacles in (("first", first), ("second", second), ("first", first)):
        model.set_obstacles(obstacles)
        for place in (q, q, other, q):
            expected = pytest.approx(answers[name, place.tobytes()], abs=1e-9)
            assert asked(place) == expected
            model.pairs(other)
            assert asked(place) == expected
            model.nearest(place)
            assert asked(place) == expected


def test_an_arm_keeps_a_clearance_if_all_its_bounds_do(robot: Robot, model: DistanceModel) -> None:
    random, kept = np.random.default_rng(6), []
    for _ in range(20):
        q = position(random)
        model.set_obstacles(around(random))
        least = float(model.bounds(q).min())
        assert model.keeps(q, least - 1e-5)
        assert not model.keeps(q, least + 1e-5)
        kept.append(model.keeps(q, 0.1))
        assert kept[-1] == (least >= 0.1)
    assert 0 < sum(kept) < len(kept)
    model.set_obstacles([])
    assert model.keeps(np.zeros(6), 1.0)


def test_no_obstacles_are_no_pairs(robot: Robot, model: DistanceModel) -> None:
    model.set_obstacles([])
    assert len(model.pairs(np.zeros(6))) == 0
    assert model.bounds(np.zeros(6)).shape == (len(robot.monitored_links), 0)


@pytest.mark.parametrize("refined", [False, True])
def test_gradients_are_those_of_the_distance(robot: Robot, model: DistanceModel, refined: bool) -> None:
    random, step, seen = np.random.default_rng(2), 1e-6, 0

    def distances(q: np.ndarray) -> np.ndarray:
        pairs = model.pairs(q)
        if refined:
            model.refine(pairs, range(len(pairs)))
        return pairs.distance.copy()

    moved = np.array([moved_by(robot, link) for link in robot.monitored_links])
    for _ in range(8):
        q = position(random)
        balls = [ball for ball in around(random) if ball.shape == "sphere"]
        model.set_obstacles(balls)
        pairs = model.pairs(q)
        if refined:
            model.refine(pairs, range(len(pairs)))
        spatial = robot.kinematics(q).spatial_jacobian
        g = closing_gradients(spatial, moved[pairs.link], pairs.point_on_link, pairs.normal)
        for joint in range(6):
            there = q.copy()
            there[joint] += step
            back = q.copy()
            back[joint] -= step
            slope = (distances(there) - distances(back)) / (2.0 * step)
            # Where the nearest point is about to jump to another facet, a difference says nothing.
            smooth = np.abs(slope + g[:, joint]) < 2e-3
            seen += int(smooth.sum())
    assert seen >= 0.97 * 8 * 6 * 8


def test_a_distance_that_is_no_number_is_below_any(
    robot: Robot, model: DistanceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    model.set_obstacles(around(np.random.default_rng(3)))
    limits = np.full((len(robot.monitored_links), 4), 0.1)
    scene = type(model._scene)
    place = scene.place
    monkeypatch.setattr(scene, "place", lambda self, q: np.full_like(place(self, q), np.nan))
    near = int((model.pairs(np.zeros(6)).distance < 0.1).sum())
    assert near < len(model.below(np.zeros(6), limits)) + 1 == near + 1
    monkeypatch.setattr(scene, "measure", lambda *_: np.nan)
    assert len(model.below(np.zeros(6), limits)) == limits.size


def test_gradients_are_the_velocity_of_the_point_along_the_normal(robot: Robot) -> None:
    random = np.random.default_rng(3)
    for link in robot.monitored_links:
        q, velocity, point, normal = (
            position(random),
            *random.normal(0.0, 1.0, (1, 6)),
            *random.normal(0, 1, (2, 3)),
        )
        normal /= np.linalg.norm(normal)
        moved = moved_by(robot, link)
        spatial = robot.kinematics(q).spatial_jacobian
        (g,) = closing_gradients(spatial, moved[np.newaxis], point[np.newaxis], normal[np.newaxis])
        (J,) = point_jacobians(spatial, moved, point[np.newaxis])
        expected = robot.point_velocity(q, velocity, link, point)
        assert J @ velocity == pytest.approx(expected, abs=1e-12)
        assert g @ velocity == pytest.approx(-normal @ expected, abs=1e-12)
        assert not g[~moved].any()


def test_no_point_of_a_link_is_faster_than_its_outermost(robot: Robot) -> None:
    random = np.random.default_rng(4)
    frames = {frame.name: index for index, frame in enumerate(robot.model.frames)}
    for link in ("forearm_link", "upper_arm_link", "wrist_2_link"):
        corners = outermost_points(robot, link)
        for index in robot.geometry_of_link[link]:
            item = robot.collision.geometryObjects[index]
            T = robot.model.frames[frames[link]].placement.inverse() * item.placement
            inside = np.array(item.geometry.vertices()) @ T.rotation.T + T.translation
            assert (inside >= corners.min(axis=0) - 1e-9).all()
            assert (inside <= corners.max(axis=0) + 1e-9).all()
        q, velocity = position(random), random.normal(0.0, 1.0, 6)
        T_base_link = robot.link_transforms(q)[link]
        spatial, moved = robot.kinematics(q).spatial_jacobian, moved_by(robot, link)

        def fastest(points: np.ndarray, T: np.ndarray = T_base_link, s: np.ndarray = spatial) -> float:
            jacobians = point_jacobians(s, moved, points @ T[:3, :3].T + T[:3, 3])  # noqa: B023
            return float(np.linalg.norm(jacobians @ velocity, axis=1).max())  # noqa: B023

        assert fastest(inside) <= fastest(corners) + 1e-12


def test_the_sensors_count_as_part_of_their_link(robot: Robot) -> None:
    array = robot.sensor_arrays[0]
    points = outermost_points(robot, array.link)
    for sensor in array.transforms_sensor_to_link[:, :3, 3]:
        assert np.abs(points - sensor).max(axis=1).min() < 1e-12


def test_links_that_do_not_exist_are_refused(robot: Robot) -> None:
    for function in (moved_by, outermost_points):
        with pytest.raises(InputError) as caught:
            function(robot, "foreram_link")
        assert caught.value.cause == "unknown_link"


def test_what_coal_fails_at_has_points_and_a_direction(
    robot: Robot, model: DistanceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = Obstacle(id="ball", shape="sphere", size=(0.05,), position=(0.5, 0.1, 0.4))
    model.set_obstacles([ball])
    expected = model.pairs(np.zeros(6))

    class Failed:
        normal = np.full(3, np.nan)

        def getNearestPoint1(self) -> np.ndarray:
            return np.full(3, np.nan)

        getNearestPoint2 = getNearestPoint1

    monkeypatch.setattr(model._scene, "compute", lambda q: [-np.inf] * model._scene.piece_count)
    monkeypatch.setattr(model._scene, "results", [Failed()] * model._scene.piece_count)
    pairs = model.pairs(np.zeros(6))
    assert (pairs.distance == -np.inf).all()
    assert np.isfinite(pairs.point_on_link).all()
    assert pairs.point_on_obstacle == pytest.approx(np.tile(ball.position, (len(pairs), 1)))
    assert np.linalg.norm(pairs.normal, axis=1) == pytest.approx(np.ones(len(pairs)))
    assert ((pairs.normal * expected.normal).sum(axis=1) > 0.0).all()  # still from the obstacle to the link


ISO = "[profiles.iso.separation]\nintrusion_m = 0.0\nhuman_uncertainty_m = 0.05\nrobot_uncertainty_m = 0.0\n"


@pytest.mark.parametrize(
    ("text", "key", "found"),
    [
        ("", "stopping.shoulder_pan_joint", "nothing"),
        (
            "[stopping]\nshoulder_pan_joint = { speed_rad_s = 1.0, time_s = 0.1, distance_rad = 0.1 }\n",
            "stopping.shoulder_pan_joint.speed_rad_s",
            "1.0",
        ),
        (
            "[stopping]\nshoulder_pan_joint = { speed_rad_s = 2.16, time_s = 0.1, distance_rad = 0.1 }\n",
            "stopping.shoulder_lift_joint",
            "nothing",
        ),
    ],
)
def test_a_separation_needs_stopping_data_of_every_joint_that_moves(
    tmp_path, text: str, key: str, found: str
) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(
        'urdf = "example-robot-data:robots/ur_description/urdf/ur3_robot.urdf"\n'
        'end_effector_frame = "wrist_1_joint"\ndefault_profile = "iso"\n'
        "[joints.locked]\nwrist_1_joint = 0.0\nwrist_2_joint = 0.0\nwrist_3_joint = 0.0\n"
        f"{text}[sources.ranges]\nrequired = false\ntimeout_s = 0.4\n"
        "[sources.obstacles]\nrequired = true\ntimeout_s = 0.25\n" + ISO
    )
    with pytest.raises(ConfigError) as caught:
        Robot.load(path)
    assert caught.value.key == key
    assert str(caught.value.found) == found

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from raycast import quaternion_of, random_pose, random_quaternion, raycast_reading, rotation_of
from scipy.linalg import null_space

from ssm_service.errors import InputError, SsmError
from ssm_service.model.shapes import Obstacle
from ssm_service.perception import cone_program, cone_reading, scan, sphere_readings
from ssm_service.perception.seen_shapes import SeenShape

SHAPES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3}
AT_ORIGIN = np.eye(4)
ALPHA = math.radians(10.0)


def random_obstacle(rng, shape, *, low=0.03, high=0.6, spread=0.8):
    return Obstacle(
        id=shape,
        shape=shape,
        size=tuple(rng.uniform(low, high, SHAPES[shape])),
        position=tuple(rng.uniform([-0.6, -spread, -spread], [1.5, spread, spread])),
        quaternion_xyzw=random_quaternion(rng),
    )


def sphere(x, y, z, radius):
    return Obstacle(id="s", shape="sphere", size=(radius,), position=(x, y, z))


def moved(obstacle, pose):
    rotation = pose[:3, :3] @ rotation_of(obstacle.quaternion_xyzw)
    return Obstacle(
        id=obstacle.id,
        shape=obstacle.shape,
        size=obstacle.size,
        position=tuple(pose[:3, :3] @ np.array(obstacle.position) + pose[:3, 3]),
        quaternion_xyzw=quaternion_of(rotation),
    )


def grown(obstacle, factor):
    size = tuple(factor * value for value in obstacle.size)
    return Obstacle(
        id=obstacle.id,
        shape=obstacle.shape,
        size=size,
        position=obstacle.position,
        quaternion_xyzw=obstacle.quaternion_xyzw,
    )


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("half_angle_deg", [3.0, 10.0, 40.0, 80.0])
def test_reading_equals_ray_casting(shape, half_angle_deg):
    rng = np.random.default_rng(int(half_angle_deg) + len(shape))
    half_angle = math.radians(half_angle_deg)
    hits = misses = unseen = 0
    for _ in range(20):
        pose = random_pose(rng)
        obstacle = moved(random_obstacle(rng, shape, spread=0.3 + half_angle), pose)
        reading = cone_reading(obstacle, pose, half_angle, 10.0)
        cast = raycast_reading(obstacle, pose, half_angle)
        if cast < math.inf:
            hits += 1
            assert reading <= cast + 1e-7, "a point in shape and cone is nearer than the reading"
            assert reading == pytest.approx(cast, abs=2e-6)
        elif reading == math.inf:
            misses += 1
        else:  # a sliver between the rays: a slightly wider cone must show it
            unseen += 1
            assert raycast_reading(obstacle, pose, half_angle + math.radians(1.0)) <= reading + 1e-6
    assert hits >= 3
    assert misses >= 1
    assert unseen <= 2


def test_ray_casting_converges_from_above():
    rng = np.random.default_rng(5)
    for shape in ("capsule", "cylinder", "box"):
        obstacle = Obstacle(
            id="o", shape=shape, size=(0.2, 0.5, 0.3)[: SHAPES[shape]], position=(0.8, 0.25, 0.1),
            quaternion_xyzw=random_quaternion(rng),
        )  # fmt: skip
        reading = cone_reading(obstacle, AT_ORIGIN, ALPHA, 10.0)
        casts = [
            raycast_reading(
                obstacle, AT_ORIGIN, ALPHA, polar=4 * 2**k + 1, around=16 * 2**k, levels=1, polish=0
            )
            for k in range(6)
        ]
        assert all(a >= b - 1e-12 for a, b in itertools.pairwise(casts))  # the grids are nested
        assert 0.0 <= casts[-1] - reading + 1e-9 < 2e-3


@pytest.mark.parametrize("half_angle_deg", [5.0, 10.0, 35.0, 85.0])
def test_capsule_is_the_least_over_balls_along_its_axis(half_angle_deg):
    rng = np.random.default_rng(int(half_angle_deg))
    half_angle = math.radians(half_angle_deg)
    hits = 0
    for _ in range(150):
        capsule = random_obstacle(rng, "capsule")
        axis = rotation_of(capsule.quaternion_xyzw)[:, 2]
        along = np.linspace(-capsule.size[1] / 2, capsule.size[1] / 2, 2001)
        for _ in range(4):  # the reading of a ball is convex in its centre
            centres = np.array(capsule.position) + along[:, None] * axis
            balls = sphere_readings(centres, capsule.size[0], half_angle)
            best = int(np.argmin(balls))
            along = np.linspace(along[max(best - 1, 0)], along[min(best + 1, len(along) - 1)], 1001)
        reading = cone_reading(capsule, AT_ORIGIN, half_angle, 10.0)
        expected = float(balls.min())
        hits += expected < math.inf
        assert reading == expected or reading == pytest.approx(expected, abs=1e-6)
    assert hits > 10


def test_needle_capsule_is_a_sphere_and_flat_box_is_a_disc_of_the_cone():
    ball = sphere(0.7, 0.2, 0.0, 0.1)
    capsule = Obstacle(id="c", shape="capsule", size=(0.1, 1e-9), position=ball.position)
    expected = cone_reading(ball, AT_ORIGIN, ALPHA, 2.0)
    assert 0.6 < expected < 0.75
    assert cone_reading(capsule, AT_ORIGIN, ALPHA, 2.0) == pytest.approx(expected, abs=1e-6)
    # A wall whose near edge begins above the axis is met where the cone's edge ray meets its face.
    wall = Obstacle(id="w", shape="box", size=(0.2, 2.0, 2.0), position=(1.1, 1.1, 0.0))
    assert cone_reading(wall, AT_ORIGIN, ALPHA, 2.0) == pytest.approx(math.hypot(1.0, 0.1), abs=1e-6)
    # Beside the axis, endless along it: the edge ray y = x·tan α reaches y = 0.2 at x = 0.2 / tan α.
    slab = Obstacle(id="p", shape="box", size=(20.0, 1.0, 0.1), position=(0.0, 0.7, 0.0))
    assert cone_reading(slab, AT_ORIGIN, ALPHA, 2.0) == pytest.approx(0.2 / math.sin(ALPHA), abs=1e-6)
    pole = Obstacle(id="p", shape="cylinder", size=(0.1, 20.0), position=(0.0, 0.3, 0.0))
    lying = moved(pole, np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]]))
    assert cone_reading(lying, AT_ORIGIN, ALPHA, 2.0) == pytest.approx(0.2 / math.sin(ALPHA), abs=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_invariant_under_rigid_motion_and_roll(shape):
    rng = np.random.default_rng(11)
    echoes = 0
    for _ in range(40):
        obstacle, pose = random_obstacle(rng, shape), random_pose(rng)
        roll = np.eye(4)
        angle = rng.uniform(-math.pi, math.pi)
        roll[1:3, 1:3] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        here = cone_reading(obstacle, AT_ORIGIN, math.radians(30.0), 1.2)
        echoes += here < math.inf
        assert cone_reading(moved(obstacle, pose), pose @ roll, math.radians(30.0), 1.2) == pytest.approx(
            here, abs=1e-7
        )
    assert echoes > 5


@pytest.mark.parametrize("shape", SHAPES)
def test_more_range_a_wider_cone_or_a_larger_obstacle_never_reads_farther(shape):
    rng = np.random.default_rng(3)
    for _ in range(40):
        obstacle = random_obstacle(rng, shape)
        by_angle = [cone_reading(obstacle, AT_ORIGIN, a, 5.0) for a in (0.05, 0.17, 0.6, 1.2, 1.5)]
        by_size = [cone_reading(grown(obstacle, f), AT_ORIGIN, ALPHA, 5.0) for f in (0.3, 1.0, 1.5, 3.0)]
        for readings in (by_angle, by_size):
            assert all(a >= b - 1e-7 for a, b in itertools.pairwise(readings))
        far = cone_reading(obstacle, AT_ORIGIN, ALPHA, 5.0)
        for range_max in (0.1, 0.4, 0.8, 1.6, 5.0):
            near = cone_reading(obstacle, AT_ORIGIN, ALPHA, range_max)
            assert near == (far if far <= range_max else math.inf) or near == pytest.approx(far, abs=1e-7)


@pytest.mark.parametrize("shape", SHAPES)
def test_farther_along_the_axis_reads_farther_by_as_much(shape):
    size = (0.1, 0.2, 0.3)[: SHAPES[shape]]
    at = [
        cone_reading(Obstacle(id="o", shape=shape, size=size, position=(x, 0, 0)), AT_ORIGIN, ALPHA, 5.0)
        for x in (0.5, 1.0, 2.0)
    ]
    assert np.diff(at) == pytest.approx([0.5, 1.0], abs=1e-12)
    assert at[0] == pytest.approx(0.5 - (0.05 if shape == "box" else 0.1), abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_apex_inside_or_on_the_shape_reads_zero(shape):
    size = (0.25, 0.5, 0.5)[: SHAPES[shape]]
    reach = 0.125 if shape == "box" else 0.25
    for x in (0.0, -0.9 * reach, 0.9 * reach, reach, -reach):
        obstacle = Obstacle(id="o", shape=shape, size=size, position=(x, 0.0, 0.0))
        assert cone_reading(obstacle, AT_ORIGIN, ALPHA, 1.0) == 0.0


@pytest.mark.parametrize("shape", SHAPES)
def test_behind_or_beside_the_sensor_is_silence(shape):
    size = (0.1, 0.2, 0.2)[: SHAPES[shape]]
    for position in ((-0.5, 0, 0), (-0.3, 0.2, 0.1), (0.0, 0.6, 0.0), (0.3, 0.0, -0.5)):
        obstacle = Obstacle(id="o", shape=shape, size=size, position=position)
        assert cone_reading(obstacle, AT_ORIGIN, ALPHA, 5.0) == math.inf


@pytest.mark.parametrize("shape", SHAPES)
def test_exactly_at_range_max_is_an_echo(shape):
    size = (0.25, 0.5, 0.5)[: SHAPES[shape]]
    x = 1.125 if shape == "box" else 1.25
    obstacle = Obstacle(id="o", shape=shape, size=size, position=(x, 0.0, 0.0))
    assert cone_reading(obstacle, AT_ORIGIN, ALPHA, 1.0) == 1.0
    assert cone_reading(obstacle, AT_ORIGIN, ALPHA, math.nextafter(1.0, 0.0)) == math.inf


def test_solved_reading_at_and_beyond_range_max():
    slab = Obstacle(id="p", shape="box", size=(20.0, 1.0, 0.1), position=(0.0, 0.7, 0.0))
    reading = 0.2 / math.sin(ALPHA)
    assert cone_reading(slab, AT_ORIGIN, ALPHA, reading + 1e-6) == pytest.approx(reading, abs=1e-6)
    assert cone_reading(slab, AT_ORIGIN, ALPHA, reading - 1e-6) == math.inf


@pytest.mark.parametrize("shape", SHAPES)
def test_nearer_than_range_min_is_read_as_range_min(shape):
    obstacle = Obstacle(id="o", shape=shape, size=(0.1, 0.2, 0.2)[: SHAPES[shape]], position=(0.12, 0, 0))
    assert cone_reading(obstacle, AT_ORIGIN, ALPHA, 1.0, 0.3) == 0.3
    assert cone_reading(obstacle, AT_ORIGIN, ALPHA, 1.0) < 0.1


@pytest.mark.parametrize("shape", ["sphere", "capsule", "cylinder", "box"])
@pytest.mark.parametrize("gap", [1e-3, 1e-6])
def test_tangent_to_the_cone(shape, gap):
    """Touching the cone's edge ray from outside at 0.5 m: a hair nearer is an echo, farther is none."""
    normal = np.array([-math.sin(ALPHA), math.cos(ALPHA), 0.0])
    edge = np.array([math.cos(ALPHA), math.sin(ALPHA), 0.0])
    turn = np.eye(4)
    turn[:3, :3] = np.stack([edge, normal, [0.0, 0.0, 1.0]], axis=1)
    size = (0.1, 0.2, 0.2) if shape == "box" else (0.1, 0.2)[: SHAPES[shape]]
    for sign, seen in ((1.0, False), (-1.0, True)):
        plain = Obstacle(id="o", shape=shape, size=size, position=(0.5, 0.1 + sign * gap, 0.0))
        reading = cone_reading(moved(plain, turn), AT_ORIGIN, ALPHA, 2.0)
        assert (reading < math.inf) == seen
        if seen:
            assert 0.39 < reading <= 0.5 + 1e-6


@pytest.mark.parametrize("shape", ["capsule", "cylinder", "box"])
def test_grazing_never_fails_and_never_loses_a_real_echo(shape):
    rng = np.random.default_rng(8)
    for gap in (0.0, 1e-8, -1e-8, 1e-10, -1e-10, 1e-13, -1e-13, 3e-7, -3e-7):
        for _ in range(6):
            obstacle = random_obstacle(rng, shape, low=0.05, high=0.3)
            turn = rotation_of(obstacle.quaternion_xyzw)
            normal = np.array([-math.sin(ALPHA), math.cos(ALPHA), 0.0])
            lowest = -turn @ _support(obstacle, turn.T @ normal)  # from the centre to the touching point
            touch = 0.6 * np.array([math.cos(ALPHA), math.sin(ALPHA), 0.0])
            placed = Obstacle(
                id="o",
                shape=shape,
                size=obstacle.size,
                position=tuple(touch - lowest + gap * normal),
                quaternion_xyzw=obstacle.quaternion_xyzw,
            )
            reading = cone_reading(placed, AT_ORIGIN, ALPHA, 2.0)
            if gap >= 3e-7:
                assert reading == math.inf
            elif gap < -1e-9:
                assert reading <= 0.6 + 1e-6
            else:
                assert reading == math.inf or reading == pytest.approx(0.6, abs=2e-3)


def _support(obstacle, direction):
    if obstacle.shape == "box":
        return np.sign(direction) * np.array(obstacle.size) / 2
    tip = np.array([0.0, 0.0, math.copysign(obstacle.size[1] / 2, direction[2])])
    across = direction.copy()
    if obstacle.shape == "cylinder":
        across[2] = 0.0
    return tip + obstacle.size[0] * across / np.linalg.norm(across)


def test_undecided_solver_is_an_error_never_silence(monkeypatch):
    capsule = Obstacle(id="c", shape="capsule", size=(0.1, 0.4), position=(0.8, 0.22, 0.0))
    expected = cone_reading(capsule, AT_ORIGIN, ALPHA, 2.0)
    assert expected < math.inf
    solve = cone_program._solve
    calls = []

    def undecided(until):
        def fake(seen, half_angle, settings):
            calls.append(half_angle)
            return solve(seen, half_angle, settings) if len(calls) > until else None

        return fake

    for until in (1, 2):
        calls.clear()
        monkeypatch.setattr(cone_program, "_solve", undecided(until))
        assert cone_reading(capsule, AT_ORIGIN, ALPHA, 2.0) == pytest.approx(expected, abs=1e-5)
        assert len(calls) == until + 1
    calls.clear()
    monkeypatch.setattr(cone_program, "_solve", undecided(99))
    with pytest.raises(SsmError, match=r"capsule .* was not solved"):
        cone_reading(capsule, AT_ORIGIN, ALPHA, 2.0)


STATUSES = ["AlmostSolved", "AlmostPrimalInfeasible", "PrimalInfeasible", "MaxIterations", "NumericalError"]


@pytest.mark.parametrize("status", STATUSES)
@pytest.mark.parametrize("shape", ["capsule", "cylinder", "box"])
def test_silence_needs_a_proof_whatever_the_solver_says(monkeypatch, status, shape):
    rng = np.random.default_rng(4)

    class Stalled:
        def __init__(self, _quadratic, _cost, _constraints, offset, _cones, _settings):
            self.rows = len(offset)

        def solve(self):
            dual = rng.choice([0.0, 1.0, 1e300, np.nan, np.inf]) * rng.normal(size=self.rows)
            values = {"status": getattr(cone_program.clarabel.SolverStatus, status), "x": [0.7], "z": dual}
            return type("Solution", (), values)

    size, y = ((0.4, 0.4, 0.4), 0.3) if shape == "box" else ((0.1, 0.4), 0.2)
    obstacle = Obstacle(id="o", shape=shape, size=size, position=(0.7, y, 0.0))
    assert cone_reading(obstacle, AT_ORIGIN, ALPHA, 2.0) < math.inf
    monkeypatch.setattr(cone_program.clarabel, "DefaultSolver", Stalled)
    for _ in range(20):
        with pytest.raises(SsmError, match="not solved"):
            cone_reading(obstacle, AT_ORIGIN, ALPHA, 2.0)


@pytest.mark.parametrize("shape", ["capsule", "cylinder", "box"])
def test_a_proof_counts_only_inside_the_dual_cone(shape):
    """Vectors that would prove emptiness, did they not point out of K, prove nothing of a seen shape."""
    rng = np.random.default_rng(9)
    obstacle = Obstacle(id="o", shape=shape, size=(0.2, 0.3, 0.4)[: SHAPES[shape]], position=(0.8, 0.2, 0.1))
    seen = SeenShape.of(obstacle, AT_ORIGIN)
    matrix, offset = cone_program._constraints(seen, ALPHA)
    assert cone_program.least_distance(seen, ALPHA) < math.inf
    flat = null_space(matrix.T)
    for _ in range(200):
        dual = flat @ rng.normal(size=flat.shape[1])
        dual *= -np.sign(dual @ offset)
        assert dual @ offset < 0.0
        assert not cone_program._is_proven_empty(seen, matrix, offset, dual)


@pytest.mark.parametrize("shape", ["capsule", "cylinder", "box"])
def test_extent_is_the_farthest_point_and_nearest_the_nearest(shape):
    rng = np.random.default_rng(10)
    for _ in range(20):
        obstacle = random_obstacle(rng, shape)
        seen = SeenShape.of(obstacle, AT_ORIGIN)
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        turn = rotation_of(obstacle.quaternion_xyzw)
        farthest = turn @ _support(obstacle, turn.T @ normal)
        assert seen.extent(normal) == pytest.approx(farthest @ normal, abs=1e-12)
        nearest = seen.nearest()
        away = np.linalg.norm(nearest)
        if away > 1e-9:  # the nearest point of a convex shape is the one that its own plane supports
            beyond = np.array(obstacle.position) + turn @ _support(obstacle, turn.T @ -nearest)
            assert beyond @ nearest == pytest.approx(away**2, abs=1e-9)


@settings(derandomize=True, deadline=None, max_examples=150)
@given(
    c=st.floats(0.01, 3.0),
    psi=st.floats(0.0, math.pi),
    azimuth=st.floats(-math.pi, math.pi),
    radius=st.floats(0.005, 1.0),
    half_angle=st.floats(0.01, 1.55),
)
def test_sphere_equals_the_definition_written_with_angles(c, psi, azimuth, radius, half_angle):
    centre = (c * math.cos(psi), c * math.sin(psi) * math.cos(azimuth), c * math.sin(psi) * math.sin(azimuth))
    reading = cone_reading(sphere(*centre, radius), AT_ORIGIN, half_angle, 50.0)
    delta = psi - half_angle
    if (
        abs(c - radius) < 1e-9
        or (abs(c * math.sin(delta) - radius) < 1e-7)
        or abs(delta - math.pi / 2) < 1e-9
    ):
        return  # rounding decides there
    if c <= radius:
        expected = 0.0
    elif delta <= 0.0:
        expected = c - radius
    elif c * math.sin(delta) <= radius and delta < math.pi / 2:
        expected = c * math.cos(delta) - math.sqrt(radius**2 - (c * math.sin(delta)) ** 2)
    else:
        expected = math.inf
    assert reading == expected or reading == pytest.approx(expected, abs=1e-8)


def test_scan_is_the_least_over_obstacles_for_each_sensor():
    rng = np.random.default_rng(21)
    half_angle = math.radians(25.0)
    for _ in range(15):
        obstacles = [random_obstacle(rng, shape, high=0.3) for shape in SHAPES for _ in range(3)]
        poses = np.stack([random_pose(rng) for _ in range(8)])
        poses[:, :3, 3] *= 0.1
        expected = [min(cone_reading(o, pose, half_angle, 1.2) for o in obstacles) for pose in poses]
        assert scan(obstacles, poses, half_angle, 1.2) == pytest.approx(expected, abs=1e-9)


def test_scan_of_nothing_is_silence():
    assert scan([], np.tile(np.eye(4), (3, 1, 1)), ALPHA, 1.0).tolist() == [math.inf] * 3
    assert scan([sphere(0.5, 0, 0, 0.1)], np.empty((0, 4, 4)), ALPHA, 1.0).shape == (0,)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"transform_sensor_to_base": np.eye(3)}, "wrong_length"),
        ({"transform_sensor_to_base": np.full((4, 4), np.nan)}, "not_finite"),
        ({"half_angle": 0.0}, "out_of_range"),
        ({"half_angle": math.pi / 2}, "out_of_range"),
        ({"half_angle": math.nan}, "out_of_range"),
        ({"range_max": math.nan}, "out_of_range"),
        ({"range_max": math.inf}, "out_of_range"),
        ({"range_max": 0.1, "range_min": 0.1}, "out_of_range"),
        ({"range_min": -0.1}, "out_of_range"),
    ],
)
def test_bad_arguments_are_refused(change, cause):
    arguments = {"transform_sensor_to_base": AT_ORIGIN, "half_angle": ALPHA, "range_max": 1.0, **change}
    with pytest.raises(InputError) as caught:
        cone_reading(sphere(0.5, 0, 0, 0.1), **arguments)
    assert caught.value.cause == cause

"""Readings of many scenes by compiled loops, against the cone program, the closed form and cast rays."""

import dataclasses
import itertools
import math

import msgspec
import numpy as np
import pytest
from raycast import random_pose, random_quaternion, raycast_reading, rotation_of

from ssm_service.config import RobotConfig, load_robot_config
from ssm_service.errors import InputError
from ssm_service.model import Obstacle, Robot, person
from ssm_service.perception import cone_reading, scan, sphere_readings
from ssm_service.perception.batch import ArrayScan

SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3}


def array_of(**changes):
    """The sensors of the UR3's ring with changes to the robot file."""
    config = load_robot_config("ur3")
    ring = msgspec.structs.replace(config.file.rings[0], **changes)
    file = msgspec.structs.replace(config.file, rings=[ring], assumptions=None)
    return Robot(RobotConfig(name="ur3", path=config.path, file=file)).sensor_arrays[0]


RINGS = [
    {"field_of_view_deg": 10.0},
    {"field_of_view_deg": 20.0, "tilt_deg": 40.0},
    {"field_of_view_deg": 60.0, "count": 5, "tilt_deg": -25.0},
    {"field_of_view_deg": 120.0, "count": 3},
]


def random_obstacle(rng, shape, pose, reach=0.7):
    return Obstacle(
        id=shape,
        shape=shape,
        size=tuple(rng.uniform(0.01, 0.4, SIZES[shape])),
        position=tuple(pose[:3, 3] + reach * rng.normal(size=3)),
        quaternion_xyzw=random_quaternion(rng),
    )


def agree(found, expected, tolerance):
    assert np.array_equal(np.isfinite(found), np.isfinite(expected))
    echo = np.isfinite(expected)
    np.testing.assert_allclose(found[echo], expected[echo], rtol=0.0, atol=tolerance)
    return int(echo.sum())


@pytest.mark.parametrize("ring", RINGS)
@pytest.mark.parametrize("shape", SIZES)
def test_one_scene_equals_the_cone_program(ring, shape):
    array, rng = array_of(**ring), np.random.default_rng(2)
    scans, half_angle = ArrayScan(array), float(array.half_angles[0])
    echoes = 0
    for _ in range(40):
        pose = random_pose(rng)
        obstacle = random_obstacle(rng, shape, pose, 0.4)
        sensors = pose @ array.transforms_sensor_to_link
        expected = np.array([cone_reading(obstacle, sensor, half_angle, 1.2) for sensor in sensors])
        echoes += agree(scans.scan([obstacle], pose), expected, 1e-6)
    assert echoes >= 5


@pytest.mark.parametrize("ring", RINGS)
@pytest.mark.parametrize("shape", SIZES)
def test_one_scene_equals_ray_casting(ring, shape):
    array, rng = array_of(**ring), np.random.default_rng(3)
    scans, half_angle = ArrayScan(array), float(array.half_angles[0])
    hits = unseen = 0
    for _ in range(60):
        if hits >= 3:
            break
        pose = random_pose(rng)
        obstacle = random_obstacle(rng, shape, pose, 0.5)
        readings = scans.scan([obstacle], pose)
        sensor = int(np.argmin(readings))  # some sensor; another where none has an echo
        reading = readings[sensor]
        if not 0.0 < reading < math.inf:
            continue
        cast = raycast_reading(obstacle, pose @ array.transforms_sensor_to_link[sensor], half_angle)
        if cast == math.inf:
            unseen += 1  # a sliver between the rays
            continue
        hits += 1
        assert reading <= cast + 1e-7
        assert reading == pytest.approx(cast, abs=2e-6)
    assert hits >= 3
    assert unseen <= 1


def test_many_scenes_equal_one_at_a_time():
    array, rng = array_of(field_of_view_deg=35.0, range_min_m=0.1), np.random.default_rng(4)
    scans, pose, count = ArrayScan(array), random_pose(rng), 60
    half_angle = float(array.half_angles[0])
    sensors = pose @ array.transforms_sensor_to_link
    made = {
        shape: [random_obstacle(rng, shape, pose, 0.4) for _ in range(count)]
        for shape in ("sphere", "capsule", "box")
    }

    def local(points):
        return (np.array(points) - pose[:3, 3]) @ pose[:3, :3]

    balls, capsules, boxes = made["sphere"], made["capsule"], made["box"]
    axes = np.array([rotation_of(o.quaternion_xyzw)[:, 2] * o.size[1] / 2 for o in capsules])
    at = np.array([o.position for o in capsules])
    turns = np.array([pose[:3, :3].T @ rotation_of(o.quaternion_xyzw) for o in boxes])
    found = {
        "sphere": scans.spheres(local([o.position for o in balls]), [o.size[0] for o in balls]),
        "capsule": scans.capsules(local(at - axes), local(at + axes), [o.size[0] for o in capsules]),
        "box": scans.boxes(local([o.position for o in boxes]), turns, [o.size for o in boxes]),
    }
    for shape, readings in found.items():
        assert readings.shape == (count, 8)
        expected = np.array([scan([o], sensors, half_angle, 1.2, 0.1) for o in made[shape]])
        assert agree(readings, expected, 1e-6) > 40
        assert (readings == 0.1).any()  # too near to be resolved
        assert readings[np.isfinite(readings)].max() <= 1.2


def test_balls_equal_the_closed_form_to_rounding():
    array, rng = array_of(field_of_view_deg=50.0), np.random.default_rng(5)
    centres, radii = 0.4 * rng.normal(size=(4000, 3)), rng.uniform(0.01, 0.3, 4000)
    T = array.transforms_sensor_to_link
    local = np.einsum("nkj,kji->nki", centres[:, None] - T[:, :3, 3], T[:, :3, :3])
    expected = sphere_readings(local, radii[:, None], math.radians(25.0))
    expected[expected > 1.2] = math.inf
    assert agree(ArrayScan(array).spheres(centres, radii), expected, 1e-12) > 4000
    assert agree(ArrayScan(array).capsules(centres, centres, radii), expected, 1e-12) > 4000


def test_a_mixed_scene_reads_the_least():
    array, rng = array_of(field_of_view_deg=40.0), np.random.default_rng(6)
    scans = ArrayScan(array)
    for _ in range(6):
        pose = random_pose(rng)
        obstacles = [random_obstacle(rng, shape, pose) for shape in SIZES for _ in range(2)]
        expected = scan(obstacles, pose @ array.transforms_sensor_to_link, math.radians(20.0), 1.2)
        agree(scans.scan(obstacles, pose), expected, 1e-6)
    assert np.isinf(scans.scan([], pose)).all()


@pytest.mark.parametrize("gap", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("fov", [10.0, 20.0, 120.0])
def test_grazing_capsules_and_boxes_are_seen_when_they_reach_in(gap, fov):
    """A shape whose lowest corner or point is set on the mantle of the cone, a hair outside or inside."""
    array, rng = array_of(field_of_view_deg=fov, count=1), np.random.default_rng(7)
    scans, T, alpha = ArrayScan(array), array.transforms_sensor_to_link[0], math.radians(fov / 2)
    for _ in range(40):
        azimuth = rng.uniform(-math.pi, math.pi)
        out = np.array([0.0, math.cos(azimuth), math.sin(azimuth)])
        normal = math.cos(alpha) * out - math.sin(alpha) * np.array([1.0, 0.0, 0.0])
        touch = 0.5 * (math.sin(alpha) * out + math.cos(alpha) * np.array([1.0, 0.0, 0.0]))
        turn = rotation_of(random_quaternion(rng))
        half = rng.uniform(0.02, 0.1, 3)
        corner = turn @ (half * -np.sign(turn.T @ normal))  # the lowest
        axis = turn[:, 2]
        end = -math.copysign(1.0, axis @ normal) * half[2] * axis
        for sign in (1.0, -1.0):
            place = touch + sign * gap * normal
            box = T[:3, :3] @ (place - corner) + T[:3, 3]
            low = T[:3, :3] @ (place + half[0] * normal) + T[:3, 3]
            other = low - 2.0 * T[:3, :3] @ end
            boxed = scans.boxes(box[None], (T[:3, :3] @ turn)[None], 2.0 * half)[0, 0]
            rounded = scans.capsules(low[None], other[None], half[0])[0, 0]
            assert (boxed < math.inf) == (rounded < math.inf) == (sign < 0.0)
            if sign < 0.0:
                assert boxed <= 0.5 + 2.0 * gap
                assert rounded <= 0.5 + 2.0 * gap


def test_a_person_reads_as_the_least_of_the_capsules_and_as_cast_rays():
    array, rng = array_of(), np.random.default_rng(8)
    scans, half_angle = ArrayScan(array), math.radians(10.0)
    seen = cast_at = 0
    for _ in range(12):
        pose = random_pose(rng)
        pose[:3, 3] = (0.0, 0.0, 0.3)
        x, y = rng.uniform(-1.0, 1.0, 2)
        body = person([x, y, -0.75], math.atan2(-y, -x), reach_to=0.2 * rng.normal(size=3) + [0.0, 0.0, 0.3])
        readings = scans.scan(body, pose)
        sensors = pose @ array.transforms_sensor_to_link
        seen += agree(readings, scan(body, sensors, half_angle, 1.2), 1e-6)
        for sensor in np.flatnonzero(np.isfinite(readings) & (readings > 0.0))[:1]:
            casts = [raycast_reading(part, sensors[sensor], half_angle) for part in body]
            assert readings[sensor] == pytest.approx(min(casts), abs=2e-6)
            cast_at += 1
    assert seen >= 12
    assert cast_at >= 5


def test_farther_ranges_and_wider_cones_only_add():
    rng = np.random.default_rng(9)
    starts, ends = 0.4 * rng.normal(size=(300, 3)), 0.4 * rng.normal(size=(300, 3))
    turns = np.array([rotation_of(random_quaternion(rng)) for _ in range(300)])
    array = array_of()
    for angles in itertools.pairwise((0.1, 0.3, 0.8, 1.4)):
        narrow, wide = (
            ArrayScan(dataclasses.replace(array, half_angles=np.full(8, angle))) for angle in angles
        )
        assert (wide.capsules(starts, ends, 0.05) <= narrow.capsules(starts, ends, 0.05) + 1e-12).all()
        assert (
            wide.boxes(starts, turns, (0.1, 0.2, 0.3)) <= narrow.boxes(starts, turns, (0.1, 0.2, 0.3)) + 1e-12
        ).all()


@pytest.mark.parametrize(
    ("call", "cause"),
    [
        (lambda s: s.spheres(np.zeros(3), 0.1), "wrong_length"),
        (lambda s: s.spheres([[0.0, 0.0, math.nan]], 0.1), "not_finite"),
        (lambda s: s.spheres(np.zeros((2, 3)), [0.1, 0.2, 0.3]), "wrong_length"),
        (lambda s: s.spheres(np.zeros((2, 3)), 0.0), "out_of_range"),
        (lambda s: s.spheres(np.zeros((2, 3)), math.nan), "out_of_range"),
        (lambda s: s.capsules(np.zeros((2, 3)), np.zeros((3, 3)), 0.1), "wrong_length"),
        (lambda s: s.boxes(np.zeros((2, 3)), np.eye(3), 0.1), "wrong_length"),
        (lambda s: s.boxes(np.zeros((1, 3)), np.full((1, 3, 3), math.nan), 0.1), "not_finite"),
    ],
)
def test_bad_arguments_are_refused(call, cause):
    with pytest.raises(InputError) as caught:
        call(ArrayScan(array_of()))
    assert caught.value.cause == cause

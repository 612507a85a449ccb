import math

import numpy as np
import pytest

from ssm_service.config import MotionConfig
from ssm_service.errors import InputError
from ssm_service.motion import field3d, field3d_as_printed, sensor_steps
from ssm_service.motion.field3d import printed_sum

CONFIG = MotionConfig(controller="field3d")
XI, ETA, RHO0 = CONFIG.attractive_gain, CONFIG.repulsive_gain, CONFIG.influence_distance_m
BOTH = [field3d, field3d_as_printed]


def rotz(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def random_rotation(rng):
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return rotation * np.linalg.det(rotation)


def rigid(rotation, shift):
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, shift
    return transform


def ring(count=8, radius=0.0323, base=None):
    base = np.eye(4) if base is None else base
    turns = [rotz(2 * math.pi * i / count) for i in range(count)]
    return np.array([base @ rigid(turn, turn @ [radius, 0, 0]) for turn in turns])


def random_ranges(rng, count=8, echoes=3):
    ranges = np.full(count, math.inf)
    ranges[rng.choice(count, echoes, replace=False)] = rng.uniform(0.03, 0.4, echoes)
    return ranges


def sphere_reading(transform, centre, radius, half_angle=math.pi / 18):
    """The closed form of the ring: rotz(2π/8·(i − 1))·translate(r, 0, 0)."""
    x, y, z = np.linalg.inv(transform)[:3] @ [*centre, 1.0]
    c, off = math.sqrt(x * x + y * y + z * z), math.atan2(math.hypot(y, z), x)
    if c <= radius:
        return 0.0
    if off <= half_angle:
        return c - radius
    delta = off - half_angle
    if delta < math.pi / 2 and c * math.sin(delta) <= radius:
        return c * math.cos(delta) - math.sqrt(radius**2 - (c * math.sin(delta)) ** 2)
    return math.inf


def by_the_algorithm(position, goal, transforms, ranges):
    """Algorithm 1 sensor by sensor, with the step |F_i| diag(2, 1)/k, in homogeneous coordinates."""
    k, total = len(ranges), np.zeros(3)
    for transform, d in zip(transforms, ranges, strict=True):
        g = np.linalg.inv(transform) @ np.array([*(goal - position), 0.0])
        q_goal, q_obs, q = np.array([g[0], g[2]]), np.array([d, 0.0]), np.zeros(2)
        force = -XI * (q - q_goal)
        if d <= RHO0:
            force = force + ETA * (1 / d - 1 / RHO0) / d**2 * (q - q_obs) / d
        step = np.linalg.norm(force) * np.array([2.0, 1.0]) / k
        moved = step * force / np.linalg.norm(force)
        total += (transform @ np.array([moved[0], 0.0, moved[1], 0.0]))[:3]
    return total


@pytest.mark.parametrize("count", [3, 4, 8, 12])
def test_is_algorithm_1_sensor_by_sensor(count):
    rng = np.random.default_rng(1)
    for _ in range(50):
        base = rigid(random_rotation(rng), rng.normal(size=3))
        position, goal = rng.uniform(-0.5, 0.5, (2, 3))
        transforms, ranges = ring(count, base=base), random_ranges(rng, count, 2)
        force = by_the_algorithm(position, goal, transforms, ranges)
        distance = np.linalg.norm(goal - position)
        cap = min(CONFIG.speed_m_s, CONFIG.approach_gain * distance)
        expected = force * cap / max(XI * distance, np.linalg.norm(force))
        np.testing.assert_allclose(field3d(position, goal, transforms, ranges, CONFIG), expected, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_without_an_echo_it_heads_straight_for_the_goal(count):
    rng = np.random.default_rng(2)
    for _ in range(50):
        transforms = ring(count, base=rigid(random_rotation(rng), rng.normal(size=3)))
        position, goal = rng.uniform(-0.5, 0.5, (2, 3))
        offset, distance = goal - position, np.linalg.norm(goal - position)
        cap = min(CONFIG.speed_m_s, CONFIG.approach_gain * distance)
        for silence in (math.inf, RHO0, RHO0 + 0.1):
            velocity = field3d(position, goal, transforms, np.full(count, silence), CONFIG)
            np.testing.assert_allclose(velocity, cap * offset / distance, atol=1e-14)


def test_the_printed_sum_nears_the_goal_but_up_to_26_degrees_off():
    """What the docstring says of the constant step."""
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    sums = np.array([printed_sum(e, ring(), np.zeros(8), XI) for e in directions])
    cosines = np.sum(sums * directions, axis=1) / np.linalg.norm(sums, axis=1)
    angles = np.degrees(np.arccos(np.minimum(cosines, 1.0)))
    assert 25 < angles.max() < 26
    assert 18.5 < angles.mean() < 20
    for angle in np.radians([5, 20, 40]):  # within the ring's plane: only multiples of 22.5°
        total = printed_sum(np.array([math.cos(angle), math.sin(angle), 0.0]), ring(), np.zeros(8), XI)
        assert math.degrees(math.atan2(total[1], total[0])) == pytest.approx(22.5)


def test_only_the_step_in_proportion_keeps_clear_of_an_obstacle_straight_ahead():
    goal, ranges = np.array([0.4, 0.0, 0.0]), np.full(8, math.inf)
    for echo in (0.001, 0.01, 0.05, 0.09):
        ranges[0] = echo
        assert field3d(np.zeros(3), goal, ring(), ranges, CONFIG)[0] < 0
        assert field3d_as_printed(np.zeros(3), goal, ring(), ranges, CONFIG)[0] > 0.5 * CONFIG.speed_m_s


@pytest.mark.parametrize("field", BOTH)
def test_turns_with_the_scene(field):
    rng = np.random.default_rng(4)
    for _ in range(50):
        rotation, shift = random_rotation(rng), rng.normal(size=3)
        position, goal = rng.uniform(-0.5, 0.5, (2, 3))
        transforms, ranges = ring(base=rigid(random_rotation(rng), rng.normal(size=3))), random_ranges(rng)
        velocity = field(position, goal, transforms, ranges, CONFIG)
        moved = field(
            rotation @ position + shift,
            rotation @ goal + shift,
            rigid(rotation, shift) @ transforms,
            ranges,
            CONFIG,
        )
        np.testing.assert_allclose(moved, rotation @ velocity, atol=1e-12)


@pytest.mark.parametrize("field", BOTH)
def test_turning_goal_and_echoes_by_one_sensor_turns_the_velocity_by_45_degrees(field):
    rng = np.random.default_rng(5)
    for _ in range(20):
        position, goal = rng.uniform(-0.5, 0.5, (2, 3))
        ranges = random_ranges(rng)
        velocity = field(position, goal, ring(), ranges, CONFIG)
        for turns in range(1, 8):
            turn = rotz(turns * math.pi / 4)
            moved = field(turn @ position, turn @ goal, ring(), np.roll(ranges, turns), CONFIG)
            np.testing.assert_allclose(moved, turn @ velocity, atol=1e-12)


@pytest.mark.parametrize("field", BOTH)
def test_speed_is_bounded_and_finite_everywhere(field):
    rng = np.random.default_rng(6)
    for _ in range(500):
        position = rng.uniform(-1, 1, 3)
        goal = position + rng.normal(size=3) * 10.0 ** rng.uniform(-9, 0)
        ranges = rng.choice([0.0, 1e-12, 0.01, 0.1, RHO0, 1.0, math.inf], 8)
        velocity = field(position, goal, ring(), ranges, CONFIG)
        bound = min(CONFIG.speed_m_s, CONFIG.approach_gain * np.linalg.norm(goal - position))
        assert np.linalg.norm(velocity) <= bound * (1 + 1e-12)
        assert not field(goal, goal, ring(), ranges, CONFIG).any()


def test_is_continuous_in_goal_readings_and_at_the_influence():
    rng = np.random.default_rng(7)
    for _ in range(200):
        position, goal = rng.uniform(-0.5, 0.5, (2, 3))
        ranges = rng.uniform(0.03, 0.4, 8)
        velocity = field3d(position, goal, ring(), ranges, CONFIG)
        beside = field3d(position, goal + 1e-8, ring(), ranges + rng.uniform(-1e-8, 1e-8, 8), CONFIG)
        assert np.linalg.norm(velocity - beside) < 1e-4
    goal, ranges = np.array([0.4, 0.0, 0.0]), np.full(8, math.inf)
    free = field3d(np.zeros(3), goal, ring(), ranges, CONFIG)
    ranges[2] = RHO0 - 1e-9
    np.testing.assert_allclose(field3d(np.zeros(3), goal, ring(), ranges, CONFIG), free, atol=1e-8)


def test_a_nearer_echo_never_turns_it_more_towards_that_sensor():
    rng = np.random.default_rng(8)
    for _ in range(50):
        position, goal = rng.uniform(-0.5, 0.5, (2, 3))
        along = []
        for echo in np.linspace(0.35, 0.0, 60):
            ranges = np.full(8, math.inf)
            ranges[0] = echo
            along.append(field3d(position, goal, ring(), ranges, CONFIG)[0])
        # Towards the obstacle it only ever slows; once it retreats, it goes on retreating.
        towards = np.maximum(along, 0.0)
        assert (np.diff(towards) <= 1e-12).all()


@pytest.mark.parametrize("field", BOTH)
@pytest.mark.parametrize("dt", [0.002, 0.02])
def test_reaches_the_goal_from_anywhere_and_rests_there(field, dt):
    rng = np.random.default_rng(9)
    goal, silence = np.array([0.2, -0.1, 0.3]), np.full(8, math.inf)
    for start in goal + rng.uniform(-0.25, 0.25, (5, 3)):
        here, distances = start, []
        for _ in range(int(9.0 / dt)):
            velocity = field(here, goal, ring(base=rigid(np.eye(3), here)), silence, CONFIG)
            here = here + dt * velocity
            distances.append(np.linalg.norm(here - goal))
        assert distances[-1] <= CONFIG.arrival_tolerance_m
        assert (np.diff(distances) <= 1e-15).all()
        assert not velocity.any()


@pytest.mark.parametrize("dt", [0.005, 0.02])
def test_reaches_the_goal_past_an_obstacle_beside_the_path(dt):
    rng = np.random.default_rng(10)
    goal, centre, radius = np.array([0.4, 0.0, 0.0]), np.zeros(3), 0.05
    turn = random_rotation(rng)
    heard = 0
    for start in ([-0.4, 0.2, 0.05], [-0.35, -0.2, 0.1], [-0.4, 0.1, -0.25], [-0.3, 0.25, 0.0]):
        here = np.array(start)
        for _ in range(int(20.0 / dt)):
            transforms = ring(base=rigid(turn, here))
            ranges = np.array([sphere_reading(t, centre, radius) for t in transforms])
            heard += int((ranges < RHO0).any())
            velocity = field3d(here, goal, transforms, ranges, CONFIG)
            here = here + dt * velocity
            assert np.linalg.norm(here - centre) > radius
            if not velocity.any():
                break
        assert np.linalg.norm(here - goal) <= CONFIG.arrival_tolerance_m
    assert heard > 20


def test_steps_keep_the_rings_apart():
    np.testing.assert_array_equal(sensor_steps([8, 4]), [0.25] * 8 + [0.5] * 4)
    np.testing.assert_array_equal(sensor_steps([1, 2]), [1.0, 1.0, 1.0])
    assert sensor_steps([]).shape == (0,)
    rng = np.random.default_rng(11)
    position, goal = rng.uniform(-0.5, 0.5, (2, 3))
    one, other = ring(), ring(4, base=rigid(random_rotation(rng), np.ones(3)))
    ranges = random_ranges(rng)
    alone = field3d(position, goal, one, ranges, CONFIG)
    np.testing.assert_allclose(field3d(position, goal, one, ranges, CONFIG, sensor_steps([8])), alone)
    both, silent = np.concatenate([one, other]), np.concatenate([ranges, np.full(4, math.inf)])
    np.testing.assert_allclose(field3d(position, goal, both, silent, CONFIG, sensor_steps([8, 4])), alone)


@pytest.mark.parametrize("field", BOTH)
@pytest.mark.parametrize(
    ("reading", "cause"), [(math.nan, "not_finite"), (-1.0, "out_of_range"), (-math.inf, "out_of_range")]
)
def test_refuses_a_reading_that_is_no_distance(field, reading, cause):
    ranges = np.full(8, math.inf)
    ranges[3] = reading
    for goal in (np.ones(3), np.zeros(3)):
        with pytest.raises(InputError) as caught:
            field(np.zeros(3), goal, ring(), ranges, CONFIG)
        assert (caught.value.cause, caught.value.where) == (cause, "ranges[3]")


@pytest.mark.parametrize("field", BOTH)
def test_refuses_the_wrong_number_of_readings_and_a_goal_that_is_not_finite(field):
    with pytest.raises(InputError) as caught:
        field(np.zeros(3), np.ones(3), ring(), np.full(7, math.inf), CONFIG)
    assert caught.value.cause == "wrong_length"
    with pytest.raises(InputError) as caught:
        field(np.zeros(3), np.array([0.0, math.nan, 0.0]), ring(), np.full(8, math.inf), CONFIG)
    assert caught.value.cause == "not_finite"

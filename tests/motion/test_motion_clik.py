"""The three modes of [Neri2023]: signs, what each holds, continuity, limits, refusals."""

import msgspec
import numpy as np
import pinocchio as pin
import pytest

from ssm_service.config import MotionConfig
from ssm_service.errors import InputError
from ssm_service.motion import Critical, activation, clik_velocity, influence_radius, pose_error

PRINTED = MotionConfig(singular_value_threshold=1e-3, max_damping=1e-3)
CLIK = msgspec.structs.replace(
    PRINTED.clik,
    position_gain=10.0,
    orientation_gain=30.0,
    repulsive_speed_m_s=0.2,
    joint_speed_max_rad_s=100.0,
)
CONFIG = msgspec.structs.replace(PRINTED, clik=CLIK)
RADIUS = 0.15
HELD = {1: [], 2: [3, 4], 3: [3, 4, 5]}


def rotation(vector):
    return pin.exp3(np.asarray(vector, dtype=float))


def jacobian_like(rng, k=6):
    return rng.normal(size=(6, k))


def critical(rng, k=6, distance=0.05, joints=None):
    direction = rng.normal(size=3)
    jacobian = rng.normal(size=(3, k))
    if joints is not None:
        jacobian[:, joints:] = 0.0
    return Critical(distance=distance, direction=direction / np.linalg.norm(direction), jacobian=jacobian)


def still(mode, jacobian, pair, config=CONFIG):
    """The velocity of the avoidance alone."""
    return clik_velocity(mode, jacobian, np.zeros(6), np.zeros(6), pair, RADIUS, config)


def test_the_error_is_the_formula_of_the_paper():
    rng = np.random.default_rng(1)
    for _ in range(50):
        a, b = rotation(rng.normal(size=3)), rotation(rng.normal(size=3))
        p, q = rng.normal(size=(2, 3))
        error = pose_error(p, a, q, b)
        np.testing.assert_allclose(error[:3], q - p)
        np.testing.assert_allclose(error[3:], 0.5 * np.cross(a.T, b.T).sum(axis=0), atol=1e-14)


@pytest.mark.parametrize("angle", [1e-6, 0.1, 1.0, np.pi / 2, 3.0])
def test_the_angular_error_is_the_axis_times_the_sine(angle):
    rng = np.random.default_rng(2)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    start = rotation(rng.normal(size=3))
    error = pose_error(np.zeros(3), start, np.zeros(3), rotation(angle * axis) @ start)
    np.testing.assert_allclose(error[3:], np.sin(angle) * axis, atol=1e-12)


def test_plus_the_error_drives_the_pose_to_the_desired_one():
    """Finite differences: along the twist +e both errors shrink; and the integral converges."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        p, goal = rng.normal(size=(2, 3))
        turn = rng.normal(size=3)
        turn *= rng.uniform(0.1, 3.0) / np.linalg.norm(turn)
        now, wanted = rotation(rng.normal(size=3)), None
        wanted = rotation(turn) @ now

        def apart(p, r, goal=goal, wanted=wanted):
            return np.linalg.norm(goal - p), np.linalg.norm(pin.log3(wanted @ r.T))

        before = apart(p, now)
        error = pose_error(p, now, goal, wanted)
        after = apart(p + 1e-6 * error[:3], rotation(1e-6 * error[3:]) @ now)
        assert after[0] < before[0]
        assert (after[1] - before[1]) / 1e-6 == pytest.approx(-np.sin(before[1]), abs=1e-4)
        for _ in range(2000):
            error = pose_error(p, now, goal, wanted)
            p, now = p + 0.02 * error[:3], rotation(0.02 * error[3:]) @ now
        assert max(apart(p, now)) < 1e-6


def test_the_radius_is_linear_between_the_two_speeds():
    speeds = [0.0, 0.1, 0.3, 0.5, 2.0, np.inf]
    assert [influence_radius(v, PRINTED) for v in speeds] == pytest.approx([0.15, 0.15, 0.175, 0.2, 0.2, 0.2])
    assert influence_radius(0.11, PRINTED) == pytest.approx(0.15125)


@pytest.mark.parametrize(("speed", "cause"), [(np.nan, "not_finite"), (-0.1, "out_of_range")])
def test_a_speed_that_is_none_is_refused(speed, cause):
    with pytest.raises(InputError) as caught:
        influence_radius(speed, PRINTED)
    assert caught.value.cause == cause


def test_the_activation_is_continuous_and_never_falls_nearer_by():
    distances = np.linspace(0.3, -0.1, 4001)
    values = np.array([activation(d, RADIUS) for d in distances])
    assert (np.diff(values) >= 0.0).all()
    assert np.diff(values).max() <= 3.0 / RADIUS * 1.01e-4
    assert not values[distances >= RADIUS].any()
    assert (values[distances <= 0.1] >= 1.0 - 1e-12).all()
    assert activation(0.125, RADIUS) == pytest.approx(0.5)
    assert activation(-np.inf, RADIUS) == 1.0
    assert activation(np.inf, RADIUS) == 0.0


@pytest.mark.parametrize("numbers", [(np.nan, 0.1), (0.1, np.nan), (0.1, 0.0), (0.1, -1.0), (0.1, np.inf)])
def test_an_activation_of_nothing_is_refused(numbers):
    with pytest.raises(InputError):
        activation(*numbers)


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_without_an_obstacle_the_task_is_tracked(mode):
    rng = np.random.default_rng(4)
    for distance in (None, RADIUS, 0.4, np.inf):
        jacobian, twist, error = jacobian_like(rng), 0.1 * rng.normal(size=6), 0.01 * rng.normal(size=6)
        pair = None if distance is None else critical(rng, distance=distance)
        velocity = clik_velocity(mode, jacobian, twist, error, pair, RADIUS, CONFIG)
        gains = np.array([10.0, 10.0, 10.0, 30.0, 30.0, 30.0])
        np.testing.assert_allclose(jacobian @ velocity, twist + gains * error, atol=1e-10)


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_the_avoidance_moves_the_point_away_and_holds_what_the_mode_holds(mode):
    rng = np.random.default_rng(5)
    for joints in (6, 5, 4, 3):
        jacobian, pair = jacobian_like(rng), critical(rng, distance=0.125, joints=joints)
        velocity = still(mode, jacobian, pair)
        np.testing.assert_allclose(pair.jacobian @ velocity, 0.5 * 0.2 * pair.direction, atol=1e-9)
        np.testing.assert_allclose(jacobian[HELD[mode]] @ velocity, 0.0, atol=1e-9)


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_where_the_point_moves_in_two_directions_only_the_rest_is_held_all_the_same(mode):
    """A point of the upper arm: two joints move it, three turn the wrist. Orientation is not traded."""
    rng = np.random.default_rng(6)
    jacobian, pair = jacobian_like(rng), critical(rng, joints=2)
    velocity = still(mode, jacobian, pair)
    np.testing.assert_allclose(jacobian[HELD[mode]] @ velocity, 0.0, atol=1e-6)
    columns = pair.jacobian[:, :2]
    nearest = 0.2 * columns @ np.linalg.pinv(columns) @ pair.direction
    np.testing.assert_allclose(pair.jacobian @ velocity, nearest, atol=1e-6)
    assert (pair.jacobian @ velocity) @ pair.direction > 0.0


def test_the_modes_give_up_less_and_less():
    rng = np.random.default_rng(7)
    jacobian, pair = jacobian_like(rng), critical(rng)
    velocities = [still(mode, jacobian, pair) for mode in (1, 2, 3)]
    norms = [np.linalg.norm(velocity) for velocity in velocities]
    assert norms[0] < norms[1] < norms[2]
    assert abs(jacobian[3:] @ velocities[0]).min() > 1e-3
    assert abs(jacobian[5] @ velocities[1]) > 1e-3


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_the_terms_add_up_and_every_joint_is_cut_for_itself(mode):
    rng = np.random.default_rng(8)
    jacobian, pair = jacobian_like(rng), critical(rng)
    twist, error = rng.normal(size=6), 0.1 * rng.normal(size=6)
    whole = clik_velocity(mode, jacobian, twist, error, pair, RADIUS, CONFIG)
    free = clik_velocity(mode, jacobian, twist, error, None, RADIUS, CONFIG)
    np.testing.assert_allclose(whole, free + still(mode, jacobian, pair), atol=1e-12)
    limit = float(np.median(np.abs(whole)))
    slow = msgspec.structs.replace(CONFIG, clik=msgspec.structs.replace(CLIK, joint_speed_max_rad_s=limit))
    cut = clik_velocity(mode, jacobian, twist, error, pair, RADIUS, slow)
    np.testing.assert_array_equal(cut, np.clip(whole, -limit, limit))
    assert 0 < (cut != whole).sum() < 6


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_is_the_same_in_every_frame_that_keeps_the_vertical(mode):
    rng = np.random.default_rng(9)
    jacobian, pair = jacobian_like(rng), critical(rng)
    twist, error = rng.normal(size=6), 0.1 * rng.normal(size=6)
    turn = rotation([0.0, 0.0, 1.3]) if mode == 2 else rotation(rng.normal(size=3))
    both = np.kron(np.eye(2), turn)
    moved = Critical(distance=pair.distance, direction=turn @ pair.direction, jacobian=turn @ pair.jacobian)
    there = clik_velocity(mode, both @ jacobian, both @ twist, both @ error, moved, RADIUS, CONFIG)
    here = clik_velocity(mode, jacobian, twist, error, pair, RADIUS, CONFIG)
    np.testing.assert_allclose(there, here, atol=1e-9)


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_a_command_does_not_jump_at_the_radius_nor_at_a_singularity(mode):
    rng = np.random.default_rng(10)
    config = msgspec.structs.replace(CONFIG, singular_value_threshold=0.02, max_damping=0.02)
    start, step = jacobian_like(rng), rng.normal(size=(6, 6))
    start[:, 5] = start[:, 4]
    direction, arm = critical(rng).direction, rng.normal(size=(3, 6))
    arm[:, 3:] = 0.0
    arm[2] = arm[1]
    twist = rng.normal(size=6)
    jumps = []
    for count in (501, 1001, 2001):
        shares = np.linspace(-1.0, 1.0, count)
        pairs = [Critical(distance=RADIUS * (1 + 0.4 * s), direction=direction, jacobian=arm) for s in shares]
        commands = [
            clik_velocity(mode, start + 0.2 * s * step, twist, np.zeros(6), pair, RADIUS, config)
            for s, pair in zip(shares, pairs, strict=True)
        ]
        jumps.append(np.linalg.norm(np.diff(commands, axis=0), axis=1).max())
    assert jumps[1] < 0.62 * jumps[0]
    assert jumps[2] < 0.62 * jumps[1]


@pytest.mark.parametrize("k", [1, 2, 3, 4, 5])
def test_with_fewer_joints_only_the_linear_rows_are_tracked(k):
    rng = np.random.default_rng(11)
    jacobian, twist, error = jacobian_like(rng, k), rng.normal(size=6), rng.normal(size=6)
    velocity = clik_velocity(1, jacobian, twist, error, None, RADIUS, CONFIG)
    expected = np.linalg.pinv(jacobian[:3]) @ (twist + 10.0 * error)[:3]
    np.testing.assert_allclose(velocity, expected, atol=1e-9)


def test_five_joints_keep_the_axis_in_mode_two():
    rng = np.random.default_rng(12)
    jacobian, twist, error = jacobian_like(rng, 5), rng.normal(size=6), 0.1 * rng.normal(size=6)
    pair = critical(rng, 5)
    free = clik_velocity(2, jacobian, twist, error, None, RADIUS, CONFIG)
    gains = np.array([10.0, 10.0, 10.0, 30.0, 30.0])
    np.testing.assert_allclose(jacobian[:5] @ free, twist[:5] + gains * error[:5], atol=1e-9)
    np.testing.assert_allclose(jacobian[3:5] @ still(2, jacobian, pair), 0.0, atol=1e-9)


def test_seven_joints_work_in_every_mode():
    rng = np.random.default_rng(13)
    jacobian, twist = jacobian_like(rng, 7), rng.normal(size=6)
    for mode in (1, 2, 3):
        velocity = clik_velocity(mode, jacobian, twist, np.zeros(6), None, RADIUS, CONFIG)
        np.testing.assert_allclose(jacobian @ velocity, twist, atol=1e-9)


@pytest.mark.parametrize(("mode", "k"), [(2, 4), (3, 5), (3, 1), (0, 6), (4, 6)])
def test_a_mode_that_the_joints_cannot_keep_is_refused(mode, k):
    with pytest.raises(InputError) as caught:
        clik_velocity(mode, np.ones((6, k)), np.zeros(6), np.zeros(6), None, RADIUS, CONFIG)
    assert caught.value.cause == "unsupported_mode"


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(bad):
    rng = np.random.default_rng(14)
    arguments = [jacobian_like(rng), np.zeros(6), np.zeros(6)]
    for index, argument in enumerate(arguments):
        spoilt = [a.copy() for a in arguments]
        spoilt[index].flat[argument.size - 1] = bad
        with pytest.raises(InputError) as caught:
            clik_velocity(1, *spoilt, critical(rng), RADIUS, CONFIG)
        assert caught.value.cause == "not_finite"
    jacobian = np.ones((3, 6))
    jacobian[1, 2] = bad
    pair = Critical(distance=0.01, direction=np.array([1.0, 0.0, 0.0]), jacobian=jacobian)
    with pytest.raises(InputError):
        clik_velocity(1, *arguments, pair, RADIUS, CONFIG)


@pytest.mark.parametrize(
    "wrong",
    [
        {"distance": np.nan},
        {"direction": np.zeros(3)},
        {"direction": np.array([np.nan, 0.0, 1.0])},
        {"direction": np.array([1.0, 0.0])},
        {"jacobian": np.ones((6, 3))},
        {"jacobian": np.ones(3)},
    ],
)
def test_a_pair_that_is_none_is_refused(wrong):
    right = {"distance": 0.1, "direction": np.array([0.0, 0.0, 1.0]), "jacobian": np.ones((3, 6))}
    with pytest.raises(InputError):
        Critical(**(right | wrong))


def test_what_does_not_fit_together_is_refused():
    rng = np.random.default_rng(15)
    for arguments in (
        (1, np.ones((3, 6)), np.zeros(6), np.zeros(6), None),
        (1, np.ones((6, 6)), np.zeros(3), np.zeros(6), None),
        (1, np.ones((6, 6)), np.zeros(6), np.zeros(5), None),
        (1, np.ones((6, 6)), np.zeros(6), np.zeros(6), critical(rng, 5)),
    ):
        with pytest.raises(InputError) as caught:
            clik_velocity(*arguments, RADIUS, CONFIG)
        assert caught.value.cause == "wrong_length"


def test_the_pair_keeps_its_own_numbers():
    jacobian = np.ones((3, 6))
    pair = Critical(distance=0.1, direction=np.array([0.0, 0.0, 1.0]), jacobian=jacobian)
    jacobian[:] = 7.0
    assert pair.jacobian.max() == 1.0
    with pytest.raises(ValueError, match="read-only"):
        pair.direction[0] = 1.0

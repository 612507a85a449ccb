import numpy as np
import pytest

from ssm_service.errors import InputError
from ssm_service.motion import damped_pseudo_inverse

SHAPES = [(3, 3), (3, 5), (3, 7), (6, 6), (6, 7), (3, 1), (3, 2), (5, 3), (6, 4)]


def with_singular_values(rng, shape, values):
    m, k = shape
    left = np.linalg.qr(rng.normal(size=(m, m)))[0]
    right = np.linalg.qr(rng.normal(size=(k, k)))[0]
    middle = np.zeros(shape)
    np.fill_diagonal(middle, values)
    return left @ middle @ right


def planar_jacobian(q1, q2, first=0.24, second=0.21):
    s1, c1, s12, c12 = np.sin(q1), np.cos(q1), np.sin(q1 + q2), np.cos(q1 + q2)
    return np.array([[-first * s1 - second * s12, -second * s12], [first * c1 + second * c12, second * c12]])


@pytest.mark.parametrize("shape", SHAPES)
def test_equals_the_pseudo_inverse_when_well_conditioned(shape):
    rng = np.random.default_rng(1)
    for _ in range(50):
        jacobian = with_singular_values(rng, shape, rng.uniform(0.05, 2.0, min(shape)))
        inverse = damped_pseudo_inverse(jacobian, threshold=0.05 - 1e-9, max_damping=0.3)
        assert inverse.shape == shape[::-1]
        np.testing.assert_allclose(inverse, np.linalg.pinv(jacobian), atol=1e-10)


@pytest.mark.parametrize("shape", SHAPES)
def test_satisfies_the_four_moore_penrose_equations(shape):
    jacobian = with_singular_values(np.random.default_rng(2), shape, np.linspace(0.3, 1.0, min(shape)))
    inverse = damped_pseudo_inverse(jacobian, threshold=0.1, max_damping=0.1)
    np.testing.assert_allclose(jacobian @ inverse @ jacobian, jacobian, atol=1e-12)
    np.testing.assert_allclose(inverse @ jacobian @ inverse, inverse, atol=1e-12)
    np.testing.assert_allclose((jacobian @ inverse).T, jacobian @ inverse, atol=1e-12)
    np.testing.assert_allclose((inverse @ jacobian).T, inverse @ jacobian, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_equals_both_closed_forms_when_damped(shape):
    rng = np.random.default_rng(3)
    threshold, greatest = 0.4, 0.15
    for least in (0.0, 1e-9, 0.1, 0.39):
        values = np.linspace(least, 1.0, min(shape)) if min(shape) > 1 else [least]
        jacobian = with_singular_values(rng, shape, values)
        squared = (1 - (least / threshold) ** 2) * greatest**2
        m, k = shape
        wide = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + squared * np.eye(m))
        tall = np.linalg.inv(jacobian.T @ jacobian + squared * np.eye(k)) @ jacobian.T
        inverse = damped_pseudo_inverse(jacobian, threshold=threshold, max_damping=greatest)
        np.testing.assert_allclose(inverse, wide, atol=1e-11)
        np.testing.assert_allclose(inverse, tall, atol=1e-11)


@pytest.mark.parametrize(("threshold", "greatest"), [(0.02, 0.02), (0.02, 0.05), (0.1, 0.02), (0.05, 0.03)])
@pytest.mark.parametrize("shape", SHAPES)
def test_gain_is_bounded_at_and_near_singularities(shape, threshold, greatest):
    rng = np.random.default_rng(4)
    ratio = greatest / threshold
    bound = 1 / threshold
    if ratio < np.sqrt(0.5):
        bound = 1 / (2 * greatest * np.sqrt(1 - ratio**2))
    for least in np.concatenate([[0.0], np.geomspace(1e-12, 3 * threshold, 60)]):
        values = least + np.concatenate([[0.0], rng.uniform(0, 0.2, min(shape) - 1)])
        inverse = damped_pseudo_inverse(
            with_singular_values(rng, shape, values), threshold=threshold, max_damping=greatest
        )
        assert np.linalg.norm(inverse, 2) <= bound * (1 + 1e-9)


def test_zero_jacobian_gives_zero():
    assert not damped_pseudo_inverse(np.zeros((3, 4)), threshold=0.1, max_damping=0.1).any()
    assert damped_pseudo_inverse(np.zeros((3, 0)), threshold=0.1, max_damping=0.1).shape == (0, 3)


@pytest.mark.parametrize("centre", [0.0, np.pi])
def test_is_continuous_through_a_singular_configuration(centre):
    """Halving the step between configurations halves the greatest jump of the command."""
    velocity = np.array([0.07, -0.07])
    jumps = []
    for count in (2001, 4001, 8001):
        q2 = np.linspace(centre - 0.4, centre + 0.4, count)
        commands = np.array(
            [
                damped_pseudo_inverse(planar_jacobian(0.3, x), threshold=0.02, max_damping=0.02) @ velocity
                for x in q2
            ]
        )
        assert np.isfinite(commands).all()
        jumps.append(np.linalg.norm(np.diff(commands, axis=0), axis=1).max())
    assert jumps[1] < 0.6 * jumps[0]
    assert jumps[2] < 0.6 * jumps[1]


def test_direction_through_rank_loss_is_continuous_for_random_paths():
    rng = np.random.default_rng(5)
    for shape in SHAPES:
        start = with_singular_values(rng, shape, np.linspace(0.0, 0.3, min(shape)))
        step = rng.normal(size=shape)
        for size in (1e-4, 1e-6, 1e-8):
            there = damped_pseudo_inverse(start + size * step, threshold=0.02, max_damping=0.02)
            back = damped_pseudo_inverse(start - size * step, threshold=0.02, max_damping=0.02)
            # |d J+| <= c |dJ| with c of the order of 1/threshold²
            assert np.linalg.norm(there - back) <= 20 * size * np.linalg.norm(step) / 0.02**2


def test_tracks_the_velocity_when_it_can_and_never_more_than_it():
    rng = np.random.default_rng(6)
    for _ in range(100):
        jacobian = with_singular_values(rng, (3, 3), [rng.uniform(0, 0.03), 0.1, 0.2])
        velocity = rng.normal(size=3)
        reached = jacobian @ damped_pseudo_inverse(jacobian, threshold=0.02, max_damping=0.02) @ velocity
        assert np.linalg.norm(reached) <= np.linalg.norm(velocity) * (1 + 1e-12)
        assert reached @ velocity >= 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_refuses_a_jacobian_that_is_not_finite(bad):
    jacobian = np.eye(3)
    jacobian[1, 2] = bad
    with pytest.raises(InputError) as caught:
        damped_pseudo_inverse(jacobian, threshold=0.1, max_damping=0.1)
    assert caught.value.cause == "not_finite"

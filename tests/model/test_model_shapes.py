import math

import numpy as np
import pytest
from model_oracle import quaternion_matrix, random_obstacle

from ssm_service.errors import InputError
from ssm_service.model import Obstacle

GOOD = {"id": "o", "shape": "box", "size": (0.1, 0.2, 0.3), "position": (1.0, 2.0, 3.0)}
NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("change", "cause", "where"),
    [
        ({"shape": "cone"}, "unknown_shape", "shape"),
        ({"shape": ["box"]}, "unknown_shape", "shape"),
        ({"size": (0.1, 0.2)}, "wrong_length", "size"),
        ({"size": ()}, "wrong_length", "size"),
        ({"shape": "sphere"}, "wrong_length", "size"),
        ({"shape": "capsule"}, "wrong_length", "size"),
        ({"size": (0.1, 0.2, 0.0)}, "out_of_range", "size"),
        ({"size": (0.1, -0.2, 0.1)}, "out_of_range", "size"),
        ({"size": (0.1, 0.2, 100.1)}, "out_of_range", "size"),
        ({"size": (0.1, NAN, 0.1)}, "not_finite", "size"),
        ({"size": (0.1, INF, 0.1)}, "not_finite", "size"),
        ({"size": None}, "wrong_type", "size"),
        ({"size": ("a", "b", "c")}, "wrong_type", "size"),
        ({"position": (0.0, 0.0)}, "wrong_length", "position"),
        ({"position": (0.0, 0.0, -INF)}, "not_finite", "position"),
        ({"position": (0.0, 800.0, 800.0)}, "out_of_range", "position"),
        ({"position": (10**400, 0, 0)}, "wrong_type", "position"),
        ({"velocity": (0.0, 0.0, 1000.1)}, "out_of_range", "velocity"),
        ({"velocity": (NAN, 0.0, 0.0)}, "not_finite", "velocity"),
        ({"quaternion_xyzw": (0.0, 0.0, 0.0, 0.0)}, "bad_quaternion", "quaternion_xyzw"),
        ({"quaternion_xyzw": (0.0, 0.0, 0.0, 1.002)}, "bad_quaternion", "quaternion_xyzw"),
        ({"quaternion_xyzw": (0.0, 0.0, 1.0)}, "wrong_length", "quaternion_xyzw"),
        ({"quaternion_xyzw": (0.0, 0.0, NAN, 1.0)}, "not_finite", "quaternion_xyzw"),
    ],
)
def test_bad_obstacles_are_refused(change, cause, where):
    with pytest.raises(InputError) as caught:
        Obstacle(**{**GOOD, **change})
    assert (caught.value.cause, caught.value.where) == (cause, where)


def test_an_unknown_shape_lists_the_known_ones():
    with pytest.raises(InputError, match=r"did you mean 'sphere'.*sphere, capsule, cylinder, box"):
        Obstacle(**{**GOOD, "shape": "spere"})


def test_values_are_plain_tuples_of_floats_and_the_quaternion_is_of_unit_length():
    obstacle = Obstacle(**{**GOOD, "size": [1, 2, 3], "quaternion_xyzw": [0.0, 0.0, 0.6004, 0.8004]})
    assert obstacle.size == (1.0, 2.0, 3.0)
    assert all(type(v) is float for v in obstacle.size)
    assert math.hypot(*obstacle.quaternion_xyzw) == pytest.approx(1.0, abs=1e-15)
    assert obstacle.velocity is None
    assert Obstacle(**{**GOOD, "velocity": [1, 2, 3]}).velocity == (1.0, 2.0, 3.0)


def test_rotation_and_axis():
    rng = np.random.default_rng(0)
    for _ in range(50):
        obstacle = random_obstacle(rng, "capsule")
        rotation = quaternion_matrix(obstacle.quaternion_xyzw)
        assert obstacle.rotation() == pytest.approx(rotation, abs=1e-12)
        assert obstacle.axis == pytest.approx(rotation[:, 2], abs=1e-12)


def test_radius():
    assert Obstacle(**GOOD).radius == pytest.approx(math.hypot(0.05, 0.1, 0.15))
    assert Obstacle(**{**GOOD, "shape": "cylinder", "size": (0.2, 3.0)}).radius == 0.2

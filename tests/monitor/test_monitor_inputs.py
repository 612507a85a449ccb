import itertools
import math

import numpy as np
import pytest

from ssm_service.errors import InputError
from ssm_service.monitor import checked_target, joint_sample, range_scan


def cause(call, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        call(*args, **kwargs)
    return caught.value.cause


def test_all_720_orders_of_the_names_are_the_same_joints(robot):
    position = np.linspace(-1, 1, 6)
    velocity = np.linspace(0.5, -0.5, 6)
    expected = joint_sample(robot, position.tolist(), velocity.tolist())
    for order in itertools.permutations(range(6)):
        sample = joint_sample(
            robot,
            [position[i] for i in order],
            [velocity[i] for i in order],
            [robot.joint_names[i] for i in order],
        )
        assert sample.position.tobytes() == expected.position.tobytes()
        assert sample.velocity.tobytes() == expected.velocity.tobytes()


def test_bad_joint_states(robot):
    names = list(robot.joint_names)
    zeros = [0.0] * 6
    assert cause(joint_sample, robot, zeros[:5]) == "wrong_length"
    assert cause(joint_sample, robot, zeros, zeros[:5]) == "wrong_length"
    assert cause(joint_sample, robot, zeros, zeros, names[:5]) == "missing_joint"
    assert cause(joint_sample, robot, zeros, zeros, [*names[:5], names[0]]) == "repeated_joint"
    assert cause(joint_sample, robot, zeros, zeros, [*names[:5], "wrist_4"]) == "unknown_joint"
    for bad in (math.nan, math.inf, -math.inf):
        assert cause(joint_sample, robot, [bad, *zeros[1:]]) == "not_finite"
        assert cause(joint_sample, robot, zeros, [bad, *zeros[1:]]) == "not_finite"
    assert cause(joint_sample, robot, [7.0, *zeros[1:]]) == "out_of_range"
    assert cause(joint_sample, robot, zeros, [100.0, *zeros[1:]]) == "out_of_range"


def test_readings(robot):
    scan = range_scan(robot, [None, 0.0, 1.2, 0.5, None, None, None, None])
    assert scan.tolist() == [math.inf, 0.0, 1.2, 0.5, *[math.inf] * 4]
    assert cause(range_scan, robot, [None] * 7) == "wrong_length"
    assert cause(range_scan, robot, [-1.0, *[None] * 7]) == "out_of_range"
    assert cause(range_scan, robot, [math.nextafter(1.2, 2), *[None] * 7]) == "out_of_range"
    assert cause(range_scan, robot, [math.nan, *[None] * 7]) == "not_finite"


def test_targets(robot):
    assert checked_target(robot, "position", [0.1, 0.2, 0.3]).value.tolist() == [0.1, 0.2, 0.3]
    assert cause(checked_target, robot, "position", [0.1, 0.2]) == "wrong_length"
    assert cause(checked_target, robot, "joint_velocity", [0.1] * 5) == "wrong_length"
    assert cause(checked_target, robot, "pose", [0.0] * 7) == "unsupported_kind"
    assert cause(checked_target, robot, "position", [math.nan, 0, 0]) == "not_finite"
    assert cause(checked_target, robot, "position", [1e9, 0, 0]) == "out_of_range"
    assert cause(checked_target, robot, "twist", [0, 0, 0, 0, 0, 0.1]) == "out_of_range"

"""What the door refuses: field, what stood there, what may stand there; and where exactly it begins to."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ssm_service.errors import InputError
from ssm_service.model import Robot
from ssm_service.monitor import checked_target, joint_sample, range_scan
from ssm_service.monitor.inputs import POSITION_SLACK, SPEED_SLACK, Inputs, Received

ZEROS = [0.0] * 6
NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
LISTED = ", ".join(NAMES)


@pytest.fixture(scope="module")
def free() -> Robot:
    """An arm whose six joints are all free, and which has no rings."""
    found = Robot.load("ur5e")
    assert len(found.free) == 6
    return found


def said(action: Callable[..., Any], *arguments: Any, **named: Any) -> tuple[Any, ...]:
    """What a refusal says: cause, field, found, allowed."""
    with pytest.raises(InputError) as caught:
        action(*arguments, **named)
    error = caught.value
    assert error.fault == ""
    return error.cause, error.where, error.found, error.allowed


def with_one(value: float, place: int = 0) -> list[float]:
    values = list(ZEROS)
    values[place] = value
    return values


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((ZEROS[:5],), ("wrong_length", "position", "5 values", "6 values")),
        ((ZEROS, [0.0] * 7), ("wrong_length", "velocity", "7 values", "6 values")),
        (
            (with_one(math.inf),),
            ("not_finite", "position", with_one(math.inf), "finite numbers"),
        ),
        (
            (ZEROS, with_one(-math.inf, 5)),
            ("not_finite", "velocity", with_one(-math.inf, 5), "finite numbers"),
        ),
        (
            (ZEROS, None, [*NAMES, "gripper"]),
            ("unknown_joint", "name", "gripper", LISTED),
        ),
        (
            (ZEROS, None, [*NAMES[:5], NAMES[1]]),
            ("repeated_joint", "name", NAMES[1], "each joint once"),
        ),
        ((ZEROS, None, NAMES[1:]), ("missing_joint", "name", f"no '{NAMES[0]}'", f"all of {LISTED}")),
    ],
)
def test_joint_states(robot: Robot, arguments: tuple[Any, ...], expected: tuple[Any, ...]) -> None:
    assert said(joint_sample, robot, *arguments) == expected


@pytest.mark.parametrize("joint", range(6))
def test_every_joint_may_be_so_far_beyond_its_limits_and_so_fast_and_no_more(
    robot: Robot, joint: int
) -> None:
    low, high = robot.position_lower[joint] - POSITION_SLACK, robot.position_upper[joint] + POSITION_SLACK
    fastest = SPEED_SLACK * robot.velocity_limit[joint]
    for end in (low, high):
        assert joint_sample(robot, with_one(end, joint)).position[joint] == end
        beyond = math.nextafter(end, math.copysign(math.inf, end))
        assert said(joint_sample, robot, with_one(beyond, joint)) == (
            "out_of_range",
            f"position of {NAMES[joint]}",
            beyond,
            f"{low:.3f} to {high:.3f}",
        )
    for end in (-fastest, fastest):
        assert joint_sample(robot, ZEROS, with_one(end, joint)).velocity[joint] == end
        beyond = math.nextafter(end, math.copysign(math.inf, end))
        assert said(joint_sample, robot, ZEROS, with_one(beyond, joint)) == (
            "out_of_range",
            f"velocity of {NAMES[joint]}",
            beyond,
            f"±{fastest:.3f}",
        )


def test_what_is_left_out_is_rest_and_the_robots_own_order(robot: Robot) -> None:
    position = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
    sample = joint_sample(robot, position)
    assert sample.position.tolist() == position
    assert sample.velocity.tolist() == ZEROS
    assert sample.position.dtype == sample.velocity.dtype == np.float64
    whole = joint_sample(robot, [0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0])
    assert whole.position.dtype == whole.velocity.dtype == np.float64


@pytest.mark.parametrize(
    ("place", "reading", "cause", "allowed"),
    [
        (0, -1e-12, "out_of_range", "0 to 1.2 m, or null for no echo"),
        (7, math.nextafter(1.2, 2.0), "out_of_range", "0 to 1.2 m, or null for no echo"),
        (3, math.inf, "not_finite", "a finite number or null"),
    ],
)
def test_readings(robot: Robot, place: int, reading: float, cause: str, allowed: str) -> None:
    ranges: list[float | None] = [None] * 8
    ranges[place] = reading
    assert said(range_scan, robot, ranges) == (cause, f"ranges[{place}]", reading, allowed)


def test_a_scan_has_a_reading_for_each_sensor(robot: Robot) -> None:
    for count in (0, 7, 9):
        expected = ("wrong_length", "ranges", f"{count} values", "8 values")
        assert said(range_scan, robot, [None] * count) == expected
    ends = range_scan(robot, [0.0, 1.2, *[None] * 5, 0.5])
    assert ends.tolist() == [0.0, 1.2, *[math.inf] * 5, 0.5]


POSE = [0.3, 0.1, 0.4, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        (
            "speed",
            [],
            ("unsupported_kind", "target.kind", "speed", "joint_velocity, twist, position, pose"),
        ),
        (
            "position",
            [0.0] * 2,
            ("wrong_length", "target.value", "2 values", "3 values for position"),
        ),
        ("twist", [0.0] * 7, ("wrong_length", "target.value", "7 values", "6 values for twist")),
        (
            "joint_velocity",
            [0.0] * 5,
            ("wrong_length", "target.value", "5 values", "6 values for joint_velocity"),
        ),
        ("pose", [0.0] * 6, ("wrong_length", "target.value", "6 values", "7 values for pose")),
        (
            "position",
            [0.0, math.inf, 0.0],
            ("not_finite", "target.value", [0.0, math.inf, 0.0], "finite numbers"),
        ),
        (
            "position",
            [0.0, 0.0, -1000.0000001],
            ("out_of_range", "target.value", [0.0, 0.0, -1000.0000001], "±1000"),
        ),
        (
            "twist",
            [0.0, 0.0, 0.0, 0.0, 0.5, 0.0],
            (
                "out_of_range",
                "target.value[3:6]",
                [0.0, 0.5, 0.0],
                "zeros: 3 free joints cannot hold an orientation",
            ),
        ),
        (
            "pose",
            POSE,
            (
                "unsupported_kind",
                "target.kind",
                "pose",
                "joint_velocity, twist or position: 3 free joints cannot hold an orientation",
            ),
        ),
    ],
)
def test_targets(robot: Robot, kind: str, value: list[float], expected: tuple[Any, ...]) -> None:
    assert len(robot.free) == 3
    assert said(checked_target, robot, kind, value) == expected


def test_what_a_target_may_be(robot: Robot, free: Robot) -> None:
    for kind, value in (
        ("position", [1000.0, -1000.0, 0.0]),
        ("twist", [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]),
        ("joint_velocity", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
    ):
        target = checked_target(robot, kind, value)
        assert (target.kind, target.value.tolist(), target.controller) == (kind, value, None)
    turning = [0.0, 0.0, 0.0, 0.1, 0.2, 0.3]
    assert checked_target(free, "twist", turning).value.tolist() == turning
    assert checked_target(robot, "position", [1, 2, 3]).value.dtype == np.float64


@pytest.mark.parametrize("length", [0.9991, 1.0, 1.0009])
def test_a_quaternion_is_brought_to_unit_length(free: Robot, length: float) -> None:
    sent = [0.3, 0.1, 0.4, *(length * number for number in (0.5, -0.5, 0.5, -0.5))]
    value = checked_target(free, "pose", sent).value
    assert value[:3].tolist() == sent[:3]
    np.testing.assert_allclose(value[3:], [0.5, -0.5, 0.5, -0.5], atol=1e-15)


@pytest.mark.parametrize("length", [0.0, 0.998, 1.002])
def test_a_quaternion_too_far_from_unit_length_is_refused(free: Robot, length: float) -> None:
    sent = [0.3, 0.1, 0.4, length, 0.0, 0.0, 0.0]
    expected = ("out_of_range", "target.value[3:7]", sent[3:], "a unit quaternion")
    assert said(checked_target, free, "pose", sent) == expected


def test_a_method_that_a_robot_has_too_few_joints_or_no_rings_for(robot: Robot, free: Robot) -> None:
    goal = ("position", [0.3, 0.1, 0.4])
    for controller in ("field", "field3d", "clik-1", "filter"):
        assert checked_target(robot, *goal, controller).controller == controller
    assert said(checked_target, robot, *goal, "clik-2") == (
        "unsupported_controller",
        "target.controller",
        "clik-2",
        "a method for 3 free joints; this one needs 5",
    )
    assert said(checked_target, free, *goal, "field3d") == (
        "unsupported_controller",
        "target.controller",
        "field3d",
        "a method that needs no sensor ring; the robot file has none",
    )
    for controller in ("field", "clik-1", "clik-2", "filter"):
        assert checked_target(free, *goal, controller).controller == controller
    assert said(checked_target, robot, *goal, "clik-3") == (
        "unsupported_controller",
        "target.controller",
        "clik-3",
        "a method for 3 free joints; this one needs 6",
    )
    assert checked_target(free, *goal, "clik-3").controller == "clik-3"


def test_nothing_received_is_nothing_known() -> None:
    nothing = Inputs()
    for name in ("joints", "ranges", "obstacles", "target"):
        received: Received[Any] = getattr(nothing, name)
        assert (received.value, received.age_s, received.invalid, received.period_s) == (None, None, False, 0)
    assert (nothing.overrun_s, nothing.duplicate, nothing.latched) == (0.0, False, False)

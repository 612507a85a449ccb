"""The monitor's parts where the rings say little, or nobody assumes anything of what is there."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ssm_service.errors import ConfigError
from ssm_service.model import LinkDistance, Robot
from ssm_service.monitor import EvaluationInput, JointSample, Monitor, RangeReader, zone_profile
from ssm_service.monitor.estimates import Estimators
from ssm_service.monitor.ranges import ball_as_nearest, link_pose, nearest_by_rings, towards_link
from ssm_service.perception import Bound, LowerBound
from ssm_service.perception.estimators import NO_ASSUMPTIONS, NO_BALL, NO_ECHO

UR3 = (Path(__file__).parents[2] / "robots" / "ur3.toml").read_text(encoding="utf-8")
POSITION = np.array([0.4, -1.1, 1.0, 0.0, 0.0, 0.0])
SILENCE = np.full(8, np.inf)


def part(text: str, head: str) -> str:
    """Return one table of a robot file, from its head up to the next blank line."""
    begin = text.index(head)
    return text[begin : text.index("\n\n", begin)]


@pytest.fixture(scope="module")
def unassumed(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """The UR3 without assumptions of what is round it."""
    path = tmp_path_factory.mktemp("robots") / "arm.toml"
    path.write_text(UR3.replace(part(UR3, "[assumptions]"), ""), encoding="utf-8")
    return Robot.load(path)


@pytest.fixture(scope="module")
def estimators(robot: Robot) -> Estimators:
    return Estimators(robot)


def test_an_unknown_profile_is_refused_with_those_that_there_are(robot: Robot) -> None:
    with pytest.raises(ConfigError) as caught:
        zone_profile(robot, "kang2021")
    error = caught.value
    assert (error.key, error.found) == ("profiles", "kang2021")
    assert "did you mean 'kang2022'" in error.allowed
    assert "the profiles here are" in error.allowed
    assert zone_profile(robot, None) == zone_profile(robot, robot.config.file.default_profile)


def test_without_assumptions_the_solvers_say_so(unassumed: Robot) -> None:
    estimators = Estimators(unassumed)
    assert estimators.bound("forearm_link") is None
    ranges = SILENCE.copy()
    ranges[3] = 0.3
    found = estimators.of(ranges, unassumed.kinematics(POSITION))
    assert (found.sphere_fit, found.lower_bound) == (None, None)
    assert found.reasons["sphere_fit"] == found.reasons["lower_bound"] == NO_ASSUMPTIONS
    assert found.nearest is not None
    assert found.nearest.distance == 0.3


def test_silence_is_no_echo_to_fit_but_something_may_touch_between_the_cones(
    robot: Robot, estimators: Estimators
) -> None:
    found = estimators.of(SILENCE, robot.kinematics(POSITION))
    assert found.sphere_fit is None
    assert found.reasons["sphere_fit"] == NO_ECHO
    assert found.lower_bound is not None
    bound = estimators.bound("forearm_link")
    assert bound is not None
    assert found.lower_bound.distance == bound.silent == 0.0
    assert found.lower_bound.sensors == ()


def test_a_bound_whose_ball_is_not_known_has_no_place(
    robot: Robot, estimators: Estimators, monkeypatch: pytest.MonkeyPatch
) -> None:
    nowhere = Bound(distance=0.2, centre=None, radius=None)
    monkeypatch.setattr(LowerBound, "of", lambda _bound, _readings: nowhere)
    found = estimators.of(SILENCE, robot.kinematics(POSITION)).lower_bound
    assert found is not None
    assert (found.distance, found.position, found.bearing, found.sensors) == (0.2, None, None, ())


def test_readings_that_no_ball_explains_are_said(robot: Robot, estimators: Estimators) -> None:
    ranges = SILENCE.copy()
    ranges[[0, 4]] = 0.3
    found = estimators.of(ranges, robot.kinematics(POSITION))
    assert found.lower_bound is None
    assert found.reasons["lower_bound"] == NO_BALL


def test_what_is_made_beforehand_changes_no_answer(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    filled: list[LowerBound] = []
    monkeypatch.setattr(LowerBound, "fill", lambda self, go_on=lambda: True: filled.append(self))
    ranges = SILENCE.copy()
    ranges[2] = 0.4
    question = EvaluationInput(joints=JointSample(position=POSITION, velocity=np.zeros(6)), ranges=ranges)
    cold, warm = Monitor(robot), Monitor(robot)
    first = cold.evaluate(question)
    warm.evaluate(EvaluationInput(joints=question.joints))
    evaluator = warm._evaluator
    assert evaluator is not None
    evaluator.prepare()
    evaluator.fill()
    assert len(filled) == 1
    assert evaluator.evaluate(question).estimates == first.estimates


def test_only_what_takes_long_is_prepared_beside_the_loop(robot: Robot) -> None:
    reader = RangeReader(robot, zone_profile(robot, None))
    assert reader.slow


def test_a_scan_that_was_prepared_elsewhere_is_taken_as_it_is(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinematics = robot.kinematics(POSITION)
    ranges = SILENCE.copy()
    ranges[3] = 0.3
    alone, helped = (RangeReader(robot, zone_profile(robot, None)) for _ in range(2))
    helped.take(helped.prepare(ranges, POSITION))
    monkeypatch.setattr(helped, "prepare", lambda *_: pytest.fail("it was there already"))
    one, other = (reader.read(ranges, POSITION, kinematics, tracked=False) for reader in (alone, helped))
    assert one.least == other.least
    assert one.nearest is not None
    assert other.nearest is not None
    assert one.nearest.distance == other.nearest.distance == 0.3


def test_a_bound_without_a_ball_is_put_before_the_first_sensor(robot: Robot) -> None:
    array = robot.sensor_arrays[0]
    kinematics = robot.kinematics(POSITION)
    surface = LinkDistance(robot, array.link)
    bound = Bound(distance=0.25, centre=None, radius=None)
    found = ball_as_nearest(array, bound, 0.25, surface, kinematics)
    sensor = kinematics.transform_sensor_to_base(int(array.indices[0]))
    np.testing.assert_allclose(found.point_on_link, sensor[:3, 3], atol=1e-12)
    np.testing.assert_allclose(found.point_on_obstacle, sensor[:3, 3] + 0.25 * sensor[:3, 0], atol=1e-12)
    np.testing.assert_allclose(found.normal, -sensor[:3, 0], atol=1e-12)
    assert (found.source, found.link, found.obstacle, found.distance) == ("ranges", array.link, None, 0.25)
    link = robot.link_transforms(POSITION)[array.link]
    np.testing.assert_allclose(link_pose(array, kinematics), link, atol=1e-12)


class Hill:
    """A distance with a known gradient, or none."""

    def __init__(self, slope: tuple[float, float, float]) -> None:
        self.slope = np.array(slope)

    def distance(self, points):
        return points @ self.slope


def test_the_way_to_the_link_goes_down_the_distance() -> None:
    point = np.array([0.1, 0.2, 0.3])
    found = towards_link(Hill((3.0, 0.0, -4.0)), point)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [-0.6, 0.0, 0.8], atol=1e-9)
    flat = towards_link(Hill((0.0, 0.0, 0.0)), point)  # type: ignore[arg-type]
    assert math.hypot(*flat) == 1.0


def test_no_sensors_and_no_echo_are_nothing_near(robot: Robot) -> None:
    kinematics = robot.kinematics(POSITION)
    assert nearest_by_rings(robot, kinematics, np.empty(0)) is None
    assert nearest_by_rings(robot, kinematics, SILENCE) is None


def test_a_period_at_which_the_approach_overshoots_is_refused(robot: Robot) -> None:
    gain = robot.config.file.motion.approach_gain
    with pytest.raises(ConfigError, match=r"motion\.approach_gain: found .* the approach overshoots"):
        Monitor(robot, period_s=1.0 / gain)
    assert Monitor(robot, period_s=0.99 / gain).period_s == 0.99 / gain


def test_without_rings_no_echo_is_the_arms_own(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(
        'urdf = "example-robot-data:robots/ur_description/urdf/ur3_robot.urdf"\n'
        'end_effector_frame = "wrist_1_joint"\ndefault_profile = "near"\n'
        "[sources]\nranges = { required = false, timeout_s = 0.4 }\n"
        "obstacles = { required = true, timeout_s = 0.25 }\n[profiles.near]\n"
        "red = { distance_m = 0.1, joint_speed_rad_s = 0.1, speed_scaling = 0.1 }\n"
        "yellow = { distance_m = 0.2, joint_speed_rad_s = 0.2, speed_scaling = 0.2 }\n",
        encoding="utf-8",
    )
    bare = Robot.load(path)
    prepared = RangeReader(bare, zone_profile(bare, None)).prepare(np.empty(0), POSITION)
    assert prepared.ranges.shape == (0,)

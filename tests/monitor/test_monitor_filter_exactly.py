"""What ``filter`` and the commander hand from one part to the next, to the letter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.monitor import JointSample, Target, commander
from ssm_service.monitor.commander import Commander
from ssm_service.monitor.filter_rows import RowMaker
from ssm_service.monitor.filtering import BLOCKED_SHARE, MEMORY_S, Filtering
from ssm_service.monitor.snapshot import Keeping, Snapshot
from ssm_service.motion import Changeover, Circulation, VelocityFilter, softness, task_metric
from ssm_service.motion.filter import DAMPING_M_RAD

DT = 0.008
FILE = Path(__file__).parents[2] / "bench" / "avoidance_robot.toml"
HERE = np.array([0.3, -1.3, 1.4, -0.6, -1.2, 0.4])


@pytest.fixture(scope="module")
def arm():
    return Robot.load(FILE)


def snapshot_of(arm, target, obstacles=(), position=HERE):
    return Snapshot(
        kinematics=arm.kinematics(position),
        joints=JointSample(position=position, velocity=np.zeros(6)),
        target=target,
        nearest=None,
        obstacles=obstacles,
    )


def hand(arm):
    return arm.kinematics(HERE).transform_end_effector_to_base[:3, 3]


def goal(arm, x=0.1, kind="position"):
    place = hand(arm) + np.array([x, 0.0, 0.0])
    more = [1.0, 0.0, 0.0, 0.0] if kind == "pose" else []
    return Target(kind=kind, value=np.array([*place, *more]), controller="filter")


def near_hand(arm, velocity=(0.0, 0.0, 0.0)):
    """Return a ball before the hand, in its margin."""
    place = tuple((hand(arm) + np.array([0.12, 0.0, 0.0])).tolist())
    return (Obstacle(id="ball", shape="sphere", size=(0.05,), position=place, velocity=velocity),)


@pytest.fixture
def distances(arm):
    return DistanceModel(arm)


def rows(arm, distances, obstacles):
    distances.set_obstacles(obstacles)
    made = RowMaker(arm).within(snapshot_of(arm, goal(arm), obstacles), np.full(6, 0.5), distances)
    tracked = made.normals.any(axis=1)
    return made.bounds[tracked], made.approach[tracked]


def test_what_moves_at_an_unknown_velocity_counts_as_standing(arm, distances):
    unknown, standing = (rows(arm, distances, near_hand(arm, v)) for v in (None, (0.0, 0.0, 0.0)))
    assert len(unknown[0]) > 0
    for one, other in zip(unknown, standing, strict=True):
        np.testing.assert_array_equal(one, other)
    coming = rows(arm, distances, near_hand(arm, (-0.2, 0.0, 0.0)))
    assert coming[1].max() > 0.1


class Recorder:
    """Stands before a method and keeps what it was given and what it returned."""

    def __init__(self, monkeypatch, kind, name, returns=None):
        self.given, self.returned, real = [], [], getattr(kind, name)

        def watched(*given, **more):
            self.given.append((*given[1:], more))
            self.returned.append(real(*given, **more) if returns is None else returns)
            return self.returned[-1]

        monkeypatch.setattr(kind, name, watched)


def test_the_way_round_is_added_and_begins_anew_with_a_goal(arm, monkeypatch):
    it, linear, added = Filtering(arm, DT), np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.02, 0.01])
    assert it.last is None
    step = Recorder(monkeypatch, Circulation, "step", added)
    resets = Recorder(monkeypatch, Circulation, "reset")
    near, far = (snapshot_of(arm, goal(arm, x)) for x in (0.1, 0.2))
    for count, snapshot in ((1, near), (1, near), (2, far), (2, far), (3, near)):
        np.testing.assert_array_equal(it.around(snapshot, linear), linear + added)
        assert len(resets.given) == count
    wanted, normal, blocked, distance, dt, _ = step.given[0]
    np.testing.assert_array_equal(wanted, linear)
    np.testing.assert_array_equal(normal, np.zeros(3))
    assert (blocked, distance, dt) == (False, pytest.approx(0.1), DT)
    it.around(snapshot_of(arm, goal(arm, 0.1, "pose")), linear)
    assert step.given[-1][3] == pytest.approx(0.1)


def test_the_way_counts_as_blocked_after_a_known_time_and_a_reset_forgets_it(arm, distances, monkeypatch):
    obstacles = near_hand(arm)
    distances.set_obstacles(obstacles)
    it, snapshot = Filtering(arm, DT), snapshot_of(arm, Target(kind="twist", value=np.zeros(6)), obstacles)
    towards = np.linalg.pinv(arm.kinematics(HERE).jacobian_full) @ [0.05, 0.0, 0.0, 0.0, 0.0, 0.0]
    monkeypatch.setattr(RowMaker, "_of_itself", lambda self, *_: _none_of(6))

    def ticks_until_blocked():
        for tick in range(1, 500):
            it.step(snapshot, towards, towards, np.full(6, 1.0), distances)
            if it._blocked:
                return tick
        raise AssertionError

    assert not it._blocked
    first = ticks_until_blocked()
    asked = arm.kinematics(HERE).jacobian @ towards
    left = arm.kinematics(HERE).jacobian @ it.last.velocity
    share = min(max(float(asked @ left) / float(asked @ asked), 0.0), 1.0)
    fading = (BLOCKED_SHARE - share) / (1.0 - share)
    assert first == int(np.floor(np.log(fading) / np.log(1.0 - DT / MEMORY_S))) + 1
    assert it._normal.any()
    it.reset()
    assert (it.last, it._blocked, it._normal.shape) == (None, False, (3,))
    assert ticks_until_blocked() == first


def _none_of(count):
    from ssm_service.monitor.filter_rows import _none

    return _none(count)


@pytest.mark.parametrize("kind", ["twist", "joint_velocity"])
def test_the_programme_gets_metric_and_softness_of_its_rows(arm, distances, monkeypatch, kind):
    obstacles = near_hand(arm, (-0.3, 0.0, 0.0))
    distances.set_obstacles(obstacles)
    solve, made = Recorder(monkeypatch, VelocityFilter, "solve"), Recorder(monkeypatch, RowMaker, "_rows")
    snapshot = snapshot_of(arm, Target(kind=kind, value=np.zeros(6)), obstacles)
    wanted, it = np.full(6, 0.1), Filtering(arm, DT)
    it.step(snapshot, wanted, wanted, np.full(6, 1.0), distances)
    ((asked, gradients, bounds, _, metric, ceilings, slack, _),) = solve.given
    rows = made.returned[-1]
    np.testing.assert_array_equal(asked, wanted)
    for given, expected in ((gradients, rows.gradients), (bounds, rows.bounds), (ceilings, rows.ceilings)):
        np.testing.assert_array_equal(given, expected)
    np.testing.assert_array_equal(slack, softness(rows.bounds, rows.approach, DAMPING_M_RAD))
    assert slack.max() > DAMPING_M_RAD
    if kind == "twist":
        np.testing.assert_array_equal(metric, task_metric(snapshot.kinematics.jacobian))
    else:
        assert metric is None


def test_no_joint_speeds_up_faster_than_it_may_after_the_last_command(arm, distances):
    gain = arm.config.file.limits.acceleration_rad_s2 * DT
    snapshot = snapshot_of(arm, Target(kind="joint_velocity", value=np.zeros(6)))
    found = Filtering(arm, DT).step(snapshot, np.full(6, 0.5), np.full(6, 0.1), np.full(6, 1.0), distances)
    np.testing.assert_allclose(found, 0.1 + gain)
    free = Filtering(arm, DT).step(snapshot, np.full(6, 0.5), None, np.full(6, 1.0), distances)
    np.testing.assert_allclose(free, 0.5)


@pytest.mark.parametrize("settled", [False, True])
def test_the_commander_hands_on_what_it_told_last(arm, distances, monkeypatch, settled):
    change = Recorder(monkeypatch, Changeover, "step")
    step = Recorder(monkeypatch, Filtering, "step")
    around = Recorder(monkeypatch, Filtering, "around")
    limited = []
    real = commander.limited_velocity

    def watched(*given, **more):
        limited.append(more)
        return real(*given, **more)

    monkeypatch.setattr(commander, "limited_velocity", watched)
    it, keeping = Commander(arm, DT), Keeping(speed_limit=np.full(6, 1.0))
    snapshot = snapshot_of(arm, goal(arm))
    told = [np.zeros(6)]
    for _ in range(3):
        told.append(it.step(snapshot, keeping, distances, settled=settled))
        key, wanted, before, _ = change.given[-1]
        assert key == ("filter", "position")
        assert len(around.given) == len(told) - 1
        of_filter = step.given[-1][2]
        if settled:
            np.testing.assert_array_equal(before, wanted)
            assert of_filter is None
            np.testing.assert_array_equal(limited[-1]["previous"], step.returned[-1])
        else:
            for previous in (before, of_filter, limited[-1]["previous"]):
                np.testing.assert_array_equal(previous, told[-2])
    assert np.abs(told[-1]).max() > 0.0
    stood = it.stand()
    np.testing.assert_array_equal(stood, np.zeros(6))
    nobody, wanted, before, _ = change.given[-1]
    assert nobody is None
    np.testing.assert_array_equal(wanted, np.zeros(6))
    np.testing.assert_array_equal(before, np.zeros(6))

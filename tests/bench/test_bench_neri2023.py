"""The benchmark of [Neri2023]: its scenario, its loop with latency, its judgement, and small runs."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench import neri2023 as table
from bench.neri2023_run import (
    LOG_S,
    Arm,
    Piece,
    Task,
    Track,
    loop_of,
    robot,
    run,
    scenario,
    start_joints,
)
from ssm_service.model import DistanceModel

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def tracks() -> dict[str, Track]:
    return {loop: run(Piece(case=2, mode=3, loop=loop)) for loop in ("ideal", "real")}


def test_the_line_takes_the_paper_s_five_seconds_at_its_speed() -> None:
    task, goal = Task(1), np.array(scenario().line.goal_m)
    times = np.linspace(0.0, 6.0, 601)
    speeds = [float(np.linalg.norm(task.twist(t))) for t in times]
    assert max(speeds) == pytest.approx(0.12)
    np.testing.assert_allclose(task.position(5.0), goal, atol=1e-12)
    assert np.linalg.norm(task.position(4.9) - goal) > 1e-4
    assert not task.twist(5.0).any()


def test_the_sphere_moves_at_the_paper_s_speed_and_passes_the_place_half_way() -> None:
    task = Task(3)
    early, late = task.sphere(1.0), task.sphere(2.0)
    assert np.linalg.norm(np.subtract(late.position, early.position)) == pytest.approx(0.11)
    assert math.hypot(*early.velocity) == pytest.approx(0.11)
    assert task.sphere(2.5).position[1] == pytest.approx(0.0)
    assert not any(task.sphere(5.5).velocity)
    assert Task(1).sphere(0.0) is None


@pytest.mark.parametrize(("case", "when"), [(2, 0.0), (3, 2.5)])
def test_an_arm_that_did_not_avoid_would_be_hit(case: int, when: float) -> None:
    task, model = Task(case), DistanceModel(robot())
    model.set_obstacles([task.sphere(when)])
    on_the_way = [task.position(t) for t in np.linspace(0.0, 5.0, 51)]
    assert min(model.nearest(start_joints(place)).distance for place in on_the_way) < 0.0


def test_the_start_holds_the_tool_straight_down() -> None:
    for case in (1, 3):
        place = Task(case).start
        pose = robot().kinematics(start_joints(place)).transform_end_effector_to_base
        np.testing.assert_allclose(pose[:3, 3], place, atol=1e-12)
        np.testing.assert_allclose(pose[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_without_lag_the_arm_integrates_commands_and_none_is_early() -> None:
    start = start_joints(Task(1).start)
    arm, velocity = Arm(start, 0.0), np.full(6, 0.1)
    arm.send(0.0051, velocity)
    arm.run_to(0.003)
    np.testing.assert_array_equal(arm.seen(0.003), start)
    arm.run_to(0.0121)
    assert len(arm.log) == 1 + 6
    np.testing.assert_allclose(arm.log[-1][0], start + 0.1 * (0.012 - 0.0051), atol=1e-12)
    np.testing.assert_array_equal(arm.log[2][0], start)
    np.testing.assert_array_equal(arm.seen(0.0099), arm.log[4][0])
    np.testing.assert_array_equal(arm.seen(-1.0), start)


def test_with_lag_the_arm_follows_the_exponential() -> None:
    start = start_joints(Task(1).start)
    arm = Arm(start, 0.02)
    arm.send(0.0, np.full(6, 0.5))
    for k in range(1, 60):
        arm.run_to(k / 350.0)
    for index, (_, speed) in enumerate(arm.log):
        np.testing.assert_allclose(speed, 0.5 * (1.0 - math.exp(-index * LOG_S / 0.02)), atol=1e-12)


def test_mode_three_keeps_orientation_and_clear_of_the_sphere_and_comes_back(
    tracks: dict[str, Track],
) -> None:
    for track in tracks.values():
        assert len(track.time) == round(scenario().horizon_s / LOG_S) + 1
        assert track.distance.min() > 0.0
        assert math.degrees(track.turned.max()) < 0.5
        assert track.off.max() > 0.03
        assert table.settled(track, track.off) < 5.0
    assert tracks["real"].distance.min() != tracks["ideal"].distance.min()


def test_errors_are_those_of_table_two(tracks: dict[str, Track]) -> None:
    ideal, real = tracks["ideal"], tracks["real"]
    assert not any(table.errors(ideal, ideal).values())
    late = replace(ideal, joints=ideal.joints.copy(), speeds=ideal.speeds.copy())
    late.joints[100, 3] += 0.5
    late.speeds[100, 3] -= 0.25
    late.joints[2600] += 9.0  # after T
    found = table.errors(ideal, late)
    assert found["position_max"] == pytest.approx(0.5)
    assert found["position_mean"] == pytest.approx(0.5 / (2501 * 6))
    assert found["speed_max"] == pytest.approx(0.25)
    assert 0.0 < table.errors(ideal, real)["position_mean"] < 0.1


def test_what_breaks_a_promise_is_said(tracks: dict[str, Track]) -> None:
    pieces = {Piece(case=2, mode=3, loop=loop): track for loop, track in tracks.items()}
    right = table.row(2, 3, pieces)
    assert table.broken([right]) == []
    real = tracks["real"]
    distance = real.distance.copy()
    distance[[50, 51, 60]] = -1e-6
    wrong = replace(
        real,
        distance=distance,
        turned=real.turned + math.radians(0.6),
        place=real.place + np.array([0, 0, 0.01]),
    )
    found = table.broken([table.row(2, 3, pieces | {Piece(case=2, mode=3, loop="real"): wrong})])
    assert [text.split(": ")[-1].split(" ")[0] for text in found] == ["2", "0.60°", "not"]


def test_errors_far_from_the_paper_s_are_said() -> None:
    rows = [
        {"case": "1: a", "paper": table.PAPER[1], "errors": dict.fromkeys(table.PAPER[1], value)}
        for value in (0.001, 0.01)
    ]
    assert table.beyond(rows) == [
        "case 1 position error, mean: 3.3 times the paper's",
        "case 1 speed error, mean: 3.3 times the paper's",
    ]


def test_every_run_has_its_loop_and_other_readings_are_tried_in_case_two_only() -> None:
    pieces = table.pieces(3)
    assert len(set(pieces)) == len(pieces) == 18 + 2 * len(scenario().other_readings)
    for piece in pieces:
        assert loop_of(piece.loop).rate_hz in (350.0, 500.0)
    assert {piece.case for piece in pieces if piece.loop not in {"ideal", "real"}} == {2}
    assert len(table.pieces(1)) == 6


def test_a_user_s_run(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "bench.neri2023", "--json", "--out", str(tmp_path), "--cases", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert [(row["case"][0], row["mode"]) for row in document["rows"]] == [
        ("1", "I"),
        ("1", "II"),
        ("1", "III"),
    ]
    for row in document["rows"]:
        assert row["contacts"] == 0
        assert row["real"]["arrived_s"] <= 5.1
        assert 0.0 < row["errors"]["position_mean"] < 2.0 * row["paper"]["position_mean"]
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"neri2023.md", "neri2023.json", "neri2023.png", "neri2023-frames.png"}

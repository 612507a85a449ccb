"""The reproduction of [Kang2022]: its scene, its law, its figures by hand, and the whole as users run it."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench import kang2022, kang2022_run
from bench.kang2022_places import METHODS, draw, place_notes
from bench.kang2022_run import Record, Run, run, wanted
from bench.kang2022_scene import CASES, FIELD, FIELD3D, FREE, FULL, PRINTED, Case, robot, scene, start
from bench.kang2022_table import COLUMNS, limits, notes, path_difference, row, table, zone_of
from ssm_service.motion import LineSegmentParabolicBlend

GOAL = np.array(scene().goal_m)


def case(method=FREE, limited=True, plant="ideal", **more):
    return Case(method=method, limited=limited, plant=plant, **more)


@pytest.fixture(scope="module")
def free():
    return run(case())


@pytest.fixture(scope="module")
def ours():
    return run(case(FIELD3D))


def line():
    arm, told = robot("ideal"), scene()
    begin = arm.kinematics(start(arm)).transform_end_effector_to_base[:3, 3]
    return LineSegmentParabolicBlend(
        start=begin, goal=told.goal_m, speed=told.speed_m_s, acceleration=told.acceleration_m_s2
    )


def made(time=None, sensed=(0.1, 0.3, 1.0, math.inf), speeds=None, place=None, method=FIELD3D, **more):
    """A run of four samples, made by hand."""
    count = len(sensed)
    record = Record(
        time=np.arange(count) * 0.01 if time is None else time,
        joints=np.zeros((count, 3)),
        speeds=np.zeros((count, 3)) if speeds is None else np.array(speeds),
        place=np.zeros((count, 3)) if place is None else np.array(place),
        sensed=np.array(sensed),
        zone=np.zeros(count),
        arm=np.array(more.pop("arm", sensed)),
        ringed=np.array(sensed),
    )
    return Run(
        case=case(method, plant=more.pop("plant", "ideal")),
        arrived_s=more.pop("arrived_s", 8.0),
        remaining_m=0.0,
        contacts=more.pop("contacts", 0),
        record=record,
    )


def test_the_free_run_is_the_straight_line_in_the_papers_time(free):
    assert free.arrived_s == pytest.approx(8.04, rel=0.05)
    reference = line()
    gaps = path_difference(free.record.place, np.array([reference.start, reference.goal]))
    assert gaps.max() < 1e-3
    assert not np.isfinite(free.record.sensed).any()
    for time_s, place in list(zip(free.record.time, free.record.place, strict=True))[::40]:
        assert np.linalg.norm(place - reference.position(time_s)) < 0.002


def test_with_ssm_no_ideal_joint_is_over_its_limit_after_the_tick_that_enters_a_zone(ours):
    zones = zone_of(ours.record.sensed)
    assert set(zones.tolist()) == {0, 1, 2}
    settled = np.flatnonzero(zones[1:] == zones[:-1]) + 1
    speeds = np.abs(ours.record.speeds).max(axis=1)
    assert (speeds[settled] <= limits()[zones[settled]] + 1e-9).all()
    assert ours.arrived_s is not None
    assert ours.contacts == 0
    assert ours.record.arm.min() > 0.0


def test_the_recorded_zone_is_that_of_the_readings(ours):
    np.testing.assert_array_equal(ours.record.zone, zone_of(ours.record.sensed))


def test_the_obstacle_leads_the_arm_astray(ours, free):
    assert path_difference(ours.record.place, free.record.place).max() > 0.02


def test_the_same_seed_gives_the_same_run_and_another_does_not():
    one, same, other = (
        run_for_half_a_second(case(FIELD3D, plant="real robot", seed=seed)) for seed in (4, 4, 5)
    )
    np.testing.assert_array_equal(one.record.joints, same.record.joints)
    assert not np.array_equal(one.record.sensed, other.record.sensed)


def run_for_half_a_second(one):
    """The ball stands beside the start, so that there are echoes at once."""
    sensors = robot("ideal").kinematics(start(robot("ideal"))).transform_sensors_to_base
    x, y, z, _ = (sensors[2] @ [0.15, 0.0, 0.0, 1.0]).tolist()
    told = scene()
    short = type(told)(**{name: getattr(told, name) for name in told.__struct_fields__} | {"horizon_s": 0.5})
    before, kang2022_run.scene = kang2022_run.scene, lambda: short
    try:
        return run(replace(one, ball_m=(x, y, z)))
    finally:
        kang2022_run.scene = before


@pytest.mark.parametrize("method", [FREE, FIELD, FIELD3D, FULL])
def test_without_an_echo_every_field_heads_straight_for_the_goal(method):
    arm, told = robot("ideal"), scene()
    kinematics = arm.kinematics(start(arm))
    way = GOAL - kinematics.transform_end_effector_to_base[:3, 3]
    velocity = wanted(case(method), kinematics, np.full(8, math.inf), 3.0)
    np.testing.assert_allclose(velocity, told.speed_m_s * way / np.linalg.norm(way), atol=1e-12)


def test_one_echo_repels_as_the_conventional_field_at_the_full_step_and_less_at_the_scenes():
    arm = robot("ideal")
    kinematics = arm.kinematics(start(arm))
    ranges = np.full(8, math.inf)
    ranges[2] = 0.12
    conventional, full, ours, free = (
        wanted(case(m), kinematics, ranges, 3.0) for m in (FIELD, FULL, FIELD3D, FREE)
    )
    np.testing.assert_allclose(full, conventional, atol=1e-12)
    away = -kinematics.transform_sensors_to_base[2, :3, 0]
    assert away @ free < away @ ours < away @ full
    assert not np.allclose(wanted(case(PRINTED), kinematics, ranges, 3.0), ours, atol=1e-3)


def test_zones_end_where_the_papers_do():
    assert zone_of(np.array([0.0, 0.1775, 0.1776, 0.355, 0.3551, math.inf])).tolist() == [2, 2, 1, 1, 0, 0]
    np.testing.assert_array_equal(limits(), [math.inf, 0.24, 0.18])


def test_path_difference_is_that_of_the_paths_whatever_the_time():
    corner = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    points = np.array([[0.5, 0.1, 0.0], [1.3, 0.5, 0.4], [0.25, 0.0, 0.0], [2.0, 0.0, 0.0]])
    np.testing.assert_allclose(path_difference(points, corner), [0.1, 0.5, 0.0, 1.0], atol=1e-12)


def test_a_row_by_hand():
    speeds = [[0.19, 0.0, 0.05], [0.0, -0.3, 0.0], [0.9, 0.0, 0.0], [0.0, 0.0, -1.5]]
    found = row([made(speeds=speeds, arm=(0.3, 0.1, 0.2, 0.5)), made(arrived_s=None, contacts=2)], None)
    assert found["mean_red"] == pytest.approx(0.08)
    assert found["most_yellow"] == pytest.approx(0.3)
    assert found["mean_green"] == pytest.approx(2.4 / 6)
    assert found["over_sensed"] == 50.0  # 0.19 in red, 0.3 in yellow
    assert found["over_true"] == 50.0  # 0.3 in red, 0.9 in yellow
    assert found["unseen"] == 50.0  # yellow that is red, green that is yellow
    assert found["arrived"] == "1/2"
    assert found["contacts_all"] == [0, 2]
    assert found["paper_s"] == 16.40


def test_a_run_that_does_not_arrive_is_said():
    found = {}
    for method, limited in CASES:
        for plant in ("ideal", "real robot"):
            one = made(method=method, plant=plant, arrived_s=None if method == FIELD else 10.0)
            found[method, limited, plant] = [replace(one, case=case(method, limited, plant))]
    rows = table(found)
    assert len(rows) == 2 * len(CASES)
    said = " ".join(notes(rows))
    assert "not reproduced, `conventional, no speed limits` does not arrive" in said
    assert "time with the obstacle over time without: 1.00 (the paper: 2.04)" in said
    assert [r["path_most_m"] for r in rows if r["plant"] == "real robot"] == [0.0] * len(CASES)


def test_places_are_drawn_again_the_same(free):
    assert draw(free, 5, 3) == draw(free, 5, 3) != draw(free, 5, 4)
    clean, late = made(arrived_s=20.0), made(arrived_s=None, contacts=1)
    said = list(place_notes([(made(arrived_s=10.0), clean), (clean, late)]))
    assert "2 arrive, 2 of them without contact; 0 touch" in said[0]
    assert "1 arrive, 1 of them without contact; 1 touch" in said[1]
    assert "at 1: 3-D with SSM over conventional without is 2.00 to 2.00" in said[2]
    assert len(METHODS) == len(said) - 1
    assert list(place_notes([])) == []


def test_it_runs_as_its_users_run_it(monkeypatch, tmp_path, capsys, free):
    def short(one):
        return replace(free, case=one) if one.method == FREE else replace(made(time=TIMES), case=one)

    TIMES = np.array([0.0, 1.0, 2.0, 3.5])
    monkeypatch.setattr(kang2022, "run", short)
    monkeypatch.setattr(kang2022, "run_places", lambda places, advance: [])
    monkeypatch.setattr(sys, "argv", ["kang2022", "--json", "--out", str(tmp_path), "--repeats", "2"])
    kang2022.main()
    document = json.loads(capsys.readouterr().out)
    assert document["benchmark"] == "kang2022"
    assert [(r["case"], r["plant"]) for r in document["rows"]][:2] == [
        ("no obstacle", "ideal"),
        ("no obstacle", "real robot"),
    ]
    assert document["rows"][1]["arrived"] == "2/2"
    assert set(COLUMNS) - {"path_most_m", "path_mean_m"} <= document["rows"][0].keys()
    figures = {f"kang2022_{name}.png" for name in ("frames", "joints", "paths", "speeds")}
    assert {path.name for path in tmp_path.iterdir()} == figures | {"kang2022.md", "kang2022.json"}


def test_no_repeats_are_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["kang2022", "--repeats", "0"])
    with pytest.raises(SystemExit):
        kang2022.main()
    assert "--repeats" in capsys.readouterr().err

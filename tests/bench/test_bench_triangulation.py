"""The sweep of estimators: the same digits for the same seed, however it was run; its truth is Coal's."""

from __future__ import annotations

import itertools
import json
import math
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import msgspec
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench import sweep
from bench.triangulation_chunk import Bench, Settings, Task, tasks, work
from bench.triangulation_claims import contests, coverage
from bench.triangulation_estimators import BOUNDS, ESTIMATORS
from bench.triangulation_noise import NOISES
from bench.triangulation_person import reaching
from bench.triangulation_points import point_errors, point_rows
from bench.triangulation_scenes import RADIUS_M, ball_centres, draw, solids
from bench.triangulation_strata import all_rows, figures, zones
from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.perception import scan

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ("rows", "coverage", "contests", "points", "touching", "settings", "notes")
SMALL = {"sphere": 2100, "forearm": 4, "hand": 4, "person": 2}
CHEAP = ("as_printed", "corrected", "nearest")


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


@pytest.fixture(scope="module")
def small():
    """A small sweep, done here: settings, tasks, pieces."""
    settings = Settings(robot="ur3", seed=3, estimators=CHEAP, arm_every=50)
    every = tasks(settings, SMALL)
    return settings, every, [work(task) for task in every]


def same(one, other):
    assert one.keys() == other.keys()
    return all(one[name].tobytes() == other[name].tobytes() for name in one)


def merged_by(executor, every, folder, workers):
    store = sweep.Store(folder=folder)
    sweep.complete(work, every, store, executor, workers)
    return [store.load(place) for place in range(len(every))]


def test_a_chunk_depends_on_nothing_but_its_task(small):
    _, every, pieces = small
    for task, piece in list(zip(every, pieces, strict=True))[::-1]:  # another order, another history
        assert same(work(task), piece)


def test_seeds_and_chunks_differ(small):
    _, every, pieces = small
    other = Task(
        settings=Settings(robot="ur3", seed=4, estimators=CHEAP),
        shape="sphere",
        index=0,
        count=every[0].count,
    )
    assert not np.array_equal(work(other)["gap"], pieces[0]["gap"])
    assert not np.array_equal(pieces[0]["gap"], pieces[1]["gap"])


def test_a_noise_is_the_same_with_and_without_the_others(small):
    _, every, pieces = small
    alone = Settings(robot="ur3", seed=3, noises=("±6 cm",), estimators=CHEAP, arm_every=0)
    piece = work(Task(settings=alone, shape="sphere", index=2, count=every[2].count))
    assert every[2].count == 100
    for name in piece:
        if name != "arm":
            np.testing.assert_array_equal(piece[name], pieces[2][name])


def test_two_processes_give_what_one_gives(small, tmp_path):
    _, every, pieces = small
    with sweep.local(2) as executor:
        found = merged_by(executor, every, tmp_path, 2)
    assert all(same(a, b) for a, b in zip(found, pieces, strict=True))


def test_all_estimators_are_the_same_in_another_process_and_after_other_scenes():
    """The bound remembers what it was asked: here first the scenes in one order, there in another."""
    settings = Settings(robot="ur3", seed=3, arm_every=0)
    every = [Task(settings=settings, shape="sphere", index=i, count=40) for i in range(4)]
    here = [work(task) for task in every]
    assert {name.split(".")[1] for name in here[0] if name.startswith("none.")} >= set(ESTIMATORS)
    with sweep.local(1) as executor:
        there = list(executor.map(work, every[::-1]))[::-1]
    assert all(same(a, b) for a, b in zip(here, there, strict=True))
    for piece in here:
        apart = piece["link"] > 0.0
        for noise, name in itertools.product(("none", "1 mm", "±6 cm"), BOUNDS):
            assert np.all(piece[f"{noise}.{name}"][apart] <= piece["link"][apart])


def test_a_dask_cluster_gives_what_one_process_gives(small, tmp_path):
    _, every, pieces = small
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from distributed import LocalCluster

        with (
            LocalCluster(
                n_workers=1,
                threads_per_worker=2,
                processes=False,
                host="127.0.0.1",
                protocol="tcp://",
                dashboard_address=None,
            ) as cluster,
            sweep.dask(cluster.scheduler_address) as (executor, threads),
        ):
            assert threads == 2
            found = merged_by(executor, every, tmp_path, threads)
    assert all(same(a, b) for a, b in zip(found, pieces, strict=True))


def bench(*arguments):
    return [sys.executable, "-m", "bench.triangulation", "--json", "--seed", "5", *arguments]


def results(done):
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    return json.dumps({name: document[name] for name in RESULTS})


def test_a_run_that_was_killed_goes_on_to_the_same_result(tmp_path):
    sized = ("--scenes", "4000", "--workers", "0", "--estimators", *CHEAP)
    options = {"cwd": ROOT, "capture_output": True, "text": True, "timeout": 100}
    whole = subprocess.run(bench(*sized, "--out", str(tmp_path / "whole")), **options)
    with subprocess.Popen(
        bench(*sized, "--out", str(tmp_path / "cut")),
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as cut:
        deadline = time.monotonic() + 60.0
        while not list(tmp_path.glob("cut/chunks/*/000002.npz")) and time.monotonic() < deadline:
            time.sleep(0.002)
        cut.send_signal(signal.SIGKILL)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("cut/chunks/*/*.npz")}
    pieces = len(list(tmp_path.glob("whole/chunks/*/*.npz")))
    assert 3 <= len(kept) < pieces
    resumed = subprocess.run(bench(*sized, "--out", str(tmp_path / "cut")), **options)
    assert results(resumed) == results(whole)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    names = {path.name for path in (tmp_path / "cut").iterdir() if path.is_file()}
    figures_of = {f"triangulation_{what}.png" for what in ("error", "seen", "polar", "zones")}
    assert names == {"triangulation.md", "triangulation.json"} | figures_of


@pytest.fixture(scope="module")
def balls():
    """Ideal ball scenes, no arm: cheap enough for statistics."""
    settings = Settings(robot="ur3", seed=11, noises=("none",), estimators=("nearest",), arm_every=0)
    pieces = [work(task) for task in tasks(settings, {"sphere": 30_000})]
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def test_who_sees_what_is_as_the_text_says(balls):
    rows = coverage(balls)
    assert [row["agrees"] for row in rows] == ["yes"] * len(rows)
    assert sum(row["scenes"] for row in rows[:3]) == 30_000
    two = [row["share"] for row in rows[:3]]
    error = [row["standard_error"] for row in rows[:3]]
    assert abs(two[0] - 0.16) < 0.005 + 4.0 * error[0]
    assert abs(two[1] - 0.05) < 0.005 + 4.0 * error[1]


def test_two_sensors_see_a_ball_as_far_as_geometry_allows(balls, robot):
    """Midway in the plane, the ball touches the near edge of both cones: ρ·sin(π/8 − α) + r·sin α = R."""
    ring = robot.rings[0]
    rho = (0.05 - ring.radius * math.sin(ring.half_angle)) / math.sin(math.pi / 8.0 - ring.half_angle)
    farthest = rho - 0.05 - ring.radius
    assert farthest == pytest.approx(0.1227, abs=1e-4)
    seen = balls["gap"][balls["none.echoes"] >= 2]
    assert 0.1 < seen.max() < farthest


def test_a_wrong_ring_does_not_agree(balls):
    wrong = {**balls, "none.echoes": np.minimum(balls["none.echoes"], 1)}
    assert coverage(wrong)[0]["agrees"] == "NO"


def test_the_links_distance_is_that_of_the_distance_model(small, robot):
    """Ball scenes go another way than the rest: straight to the mesh, in the link's frame."""
    made, distances = Bench("ur3"), DistanceModel(robot)
    draws = draw(robot, 60, np.random.default_rng(1))
    found, _ = made.balls(draws, arm_every=1)
    T_link_ring = made.estimators.transform_ring_to_link
    for i, centre in enumerate(ball_centres(draws, made.ring.radius)):
        position = draws.positions[i]
        T_base_ring = robot.link_transforms(position)["forearm_link"] @ T_link_ring
        x, y, z = (T_base_ring[:3, :3] @ centre + T_base_ring[:3, 3]).tolist()
        distances.set_obstacles([Obstacle(id="b", shape="sphere", size=(RADIUS_M,), position=(x, y, z))])
        pairs = {pair.link: pair for pair in distances.all_pairs(position)}
        nearest = pairs["forearm_link"]
        assert found["link"][i] == pytest.approx(nearest.distance, abs=1e-9)
        assert found["arm"][i] == pytest.approx(min(p.distance for p in pairs.values()), abs=1e-9)
        in_ring = T_base_ring[:3, :3].T @ (nearest.point_on_obstacle - T_base_ring[:3, 3])
        assert found["towards"][i] == pytest.approx(math.atan2(in_ring[1], in_ring[0]), abs=1e-6)


def test_readings_of_balls_are_those_of_the_scan(robot):
    made = Bench("ur3")
    draws = draw(robot, 100, np.random.default_rng(2))
    _, readings = made.balls(draws, arm_every=0)
    ring = made.ring
    for centre, row in zip(ball_centres(draws, ring.radius), readings, strict=True):
        ball = Obstacle(id="b", shape="sphere", size=(RADIUS_M,), position=tuple(centre.tolist()))
        wanted = scan([ball], ring.transform_sensors_to_ring, ring.half_angle, ring.range_max, ring.range_min)
        np.testing.assert_allclose(row, wanted, atol=1e-12)


@pytest.mark.parametrize("shape", ["forearm", "hand"])
def test_solids_touch_the_plane_of_their_gap(shape, robot):

    draws = draw(robot, 40, np.random.default_rng(3))
    for i, solid in enumerate(solids(shape, draws, 0.0323)):
        u = draws.outward[i]
        if shape == "forearm":
            reach = solid.size[0] + 0.5 * solid.size[1] * abs(float(np.array(solid.axis) @ u))
        else:
            reach = 0.5 * float(np.abs(u @ solid.rotation()) @ np.array(solid.size))
        assert float(np.array(solid.position) @ u) - reach == pytest.approx(0.0323 + draws.gap[i], abs=1e-12)


def test_the_person_leaves_the_gap_or_passes_near(robot):
    made = Bench("ur3")
    draws = draw(robot, 25, np.random.default_rng(8))
    found, _ = made.bodies("person", draws, arm_every=1)
    assert np.all(found["link"] > 0.9999 * draws.gap)
    assert np.all(found["link"] < 1.0)
    assert (found["link"] < draws.gap + 1e-3).mean() > 0.5
    assert np.all(found["arm"] <= found["link"] + 1e-9)


def test_who_passes_the_arm_does_not_walk_on(robot):
    """The link seems 0.6 m farther than it is, so that nobody comes as near as the gap."""

    class Far(DistanceModel):
        def nearest(self, position, link=None):
            pair = super().nearest(position, link)
            return msgspec.structs.replace(pair, distance=pair.distance + 0.6)

    draws = draw(robot, 3, np.random.default_rng(8))
    distances = Far(robot)
    for i, position in enumerate(draws.positions):
        T_base_link = robot.link_transforms(position)["forearm_link"]
        limbs = reaching(draws, i, distances, "forearm_link", T_base_link[:3, 3])
        feet = np.array(limbs[0].position[:2])
        assert np.linalg.norm(feet - T_base_link[:2, 3]) < 2.5


def test_noise_is_what_it_says(small):
    _, _, pieces = small
    ideal = np.concatenate([p["none.nearest"] for p in pieces[:3]])
    heard = {noise: np.concatenate([p[f"{noise}.nearest"] for p in pieces[:3]]) for noise in NOISES}
    echo = ~np.isnan(ideal)
    assert np.nanmax(np.abs(heard["1 mm"] - ideal)) <= 0.0005 + 1e-12
    assert np.abs(heard["1 mm"][echo] * 1000.0 - np.round(heard["1 mm"][echo] * 1000.0)).max() < 1e-9
    error = (heard["±6 cm"] - ideal)[echo]
    assert np.abs(error).max() <= 0.06
    assert 0.025 < np.abs(error).mean() < 0.035  # uniform: 3 cm
    np.testing.assert_array_equal(np.isnan(heard["±6 cm"]), ~echo)
    echoes = [sum(int(p[f"{noise}.echoes"].sum()) for p in pieces[:3]) for noise in ("none", "drop-outs")]
    assert echoes[1] / echoes[0] == pytest.approx(0.9, abs=4.0 * math.sqrt(0.09 / echoes[0]))


def test_corrected_is_exact_for_points_in_two_cones_and_as_printed_short(robot):
    ring, errors, truth = point_errors(robot, seed=1, count=3000)
    assert np.isnan(errors["corrected"]).mean() < 0.2
    assert np.nanmax(np.abs(errors["corrected"])) < 1e-9
    far = errors["as_printed"][truth > 0.4]
    assert np.nanmax(far) < -0.5 * ring.radius
    assert np.nanmin(far) > -1.1 * ring.radius
    (row,) = [row for row in point_rows(robot, 1, 500) if row["estimator"] == "as_printed"]
    assert -1.0 < row["median_in_radii"] < -0.6


def made_up(said, true):
    n = len(true)
    return {
        "gap": np.full(n, 0.03),
        "bearing": np.zeros(n),
        "axial": np.zeros(n),
        "link": np.array(true),
        "arm": np.full(n, np.nan),
        "towards": np.full(n, 3.1),
        "none.echoes": np.full(n, 2),
        "none.guess": np.array(said),
        "none.guess.bearing": np.full(n, -3.1),
        "none.other": np.array(said) * 2.0,
    }


def test_figures_of_a_stratum():
    nan = math.nan
    found = made_up(said=[0.12, 0.19, nan, 0.5, 9.0], true=[0.1, 0.2, 0.3, 0.36, -0.01])
    row = figures(found, "guess", "none", "link", np.ones(5, dtype=bool), (0.1775, 0.355))
    assert (row["scenes"], row["answered"], row["answers"]) == (4, 3, 0.75)
    assert row["bias"] == pytest.approx((0.02 - 0.01 + 0.14) / 3)
    assert row["median"] == pytest.approx(0.02)
    assert row["abs_p50"] == pytest.approx(0.02)
    assert row["worst_over"] == pytest.approx(0.14)
    assert row["worst_under"] == pytest.approx(-0.01)
    assert row["over"] == pytest.approx(2 / 3)
    assert row["bearing_p50_deg"] == pytest.approx(math.degrees(2.0 * math.pi - 6.2))
    assert row["zones"] == [[1, 0, 0], [0, 1, 1], [0, 0, 1]]
    assert row["unsafe"] == 0.25
    none = figures(found, "guess", "none", "arm", np.ones(5, dtype=bool), (0.1775, 0.355))
    assert none["scenes"] == 0
    assert none["answers"] is none["bias"] is none["unsafe"] is None


def test_the_edges_belong_to_the_nearer_zone():
    row = zones(np.array([0.1775, 0.355, 0.356]), np.array([0.356, 0.1775, math.inf]), (0.1775, 0.355))
    assert row["zones"] == [[0, 0, 1], [1, 0, 0], [0, 0, 1]]
    assert row["unsafe"] == row["too_strict"] == pytest.approx(1 / 3)


def test_a_contest_is_judged_where_both_answer():
    found = made_up(said=[0.11, 0.22, math.nan], true=[0.1, 0.2, 0.3])
    rows = contests(found, "sphere", ("none",), 8, champion="guess", rivals=("other",))
    assert [row["stratum"] for row in rows][:2] == ["2+ echoes", "2+ echoes, gap 0.01–0.05 m"]
    assert [row["scenes"] for row in rows] == [2, 2, 0, 0, 0, 0]
    assert rows[0]["p50"] == pytest.approx(0.015)
    assert rows[0]["rival_p50"] == pytest.approx((0.12 + 0.24) / 2)
    assert rows[0]["wins"] == "both"
    assert rows[-1]["wins"] is None


def test_every_stratum_has_a_row_and_the_parts_make_the_whole(small):
    settings, every, pieces = small
    chosen = [p for task, p in zip(every, pieces, strict=True) if task.shape == "sphere"]
    found = {name: np.concatenate([piece[name] for piece in chosen]) for name in chosen[0]}
    rows = all_rows(found, "sphere", settings.noises, settings.estimators, 8, (0.1775, 0.355))
    assert len(rows) == len(NOISES) * 20 * 2 * len(settings.estimators)
    for noise in NOISES:
        for kind in ("gap", "bearing", "axial"):
            parts = [r for r in rows if r["kind"] == kind and r["noise"] == noise and r["truth"] == "link"]
            total = sum(r["scenes"] for r in parts if r["estimator"] == "nearest")
            assert total == int((found["link"] > 0.0).sum())

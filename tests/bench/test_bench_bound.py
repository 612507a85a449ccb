"""The sweep of the bound finds what is wrong and says it; its brute force is right by the closed form."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench import bound, bound_chunk
from bench.bound_chunk import Task, tasks, violates, work
from bench.bound_report import BRUTE, SOUNDNESS
from bench.bound_scenes import SWEEP
from bench.brute import _from_cone
from ssm_service.perception import sphere_readings

ROOT = Path(__file__).resolve().parents[2]
CHEAP = 2


def run(name, *arguments):
    done = subprocess.run(
        [sys.executable, "-m", f"bench.{name}", "--json", "--seed", "7", *arguments],
        cwd=ROOT, capture_output=True, text=True, timeout=110,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_bound_runs_as_its_users_run_it(tmp_path):
    found = run("bound", "--scenes", "200", "--brute", "2", "--workers", "0", "--out", str(tmp_path))
    assert [row["configuration"] for row in found["rows"]] == [case.label for case in SWEEP]
    assert sum(row["scenes"] for row in found["rows"]) == pytest.approx(200, abs=len(SWEEP))
    assert all(row.keys() >= SOUNDNESS.keys() for row in found["rows"])
    assert found["violations"] == []
    assert [row["scenes"] for row in found["brute"]] == [1, 1]
    assert all(row.keys() >= BRUTE.keys() and row["below"] == 0 for row in found["brute"])
    table = (tmp_path / "bound.md").read_text(encoding="utf-8")
    assert "0 violations" in table
    assert "| excess p50 [mm] |" in table
    assert {path.name for path in tmp_path.iterdir()} == {"bound.md", "bound.json", "bound.png", "chunks"}


def test_the_estimators_run_as_their_users_run_them(tmp_path):
    found = run("estimators", "--scans", "5", "--out", str(tmp_path))
    whats = ["argmin", "the paper's", "sphere_fit", "lower_bound", "all", "lower_bound, known", "all, known"]
    scans = ["as drawn", "with an echo", "with two echoes"]
    assert [(row["scans"], row["what"]) for row in found["rows"]] == [(s, w) for s in scans for w in whats]
    for row in found["rows"]:
        values = [row[name] for name in ("p50_us", "p99_us", "p99.9_us", "max_us")]
        assert values == sorted(values)
        assert values[0] >= 0.0


def test_the_pieces_make_up_what_was_asked_for():
    todo = tasks(1, 1_000_000, 1000)
    scenes, brute = (sum(task.count for task in todo if task.brute is kind) for kind in (False, True))
    assert scenes == pytest.approx(1_000_000, abs=len(SWEEP))
    assert brute == 1000
    assert len(set(todo)) == len(todo)
    assert all(SWEEP[task.case].error > 0.0 for task in todo if task.brute)


def test_a_piece_is_the_same_after_others():
    task = Task(seed=3, case=CHEAP, brute=False, index=1, count=60)
    first = work(task)
    work(Task(seed=3, case=CHEAP, brute=False, index=0, count=60))
    again = work(task)
    assert (first["echoes"] > 0).mean() > 0.6
    for name in first.keys() - {"seconds"}:
        np.testing.assert_array_equal(first[name], again[name])


def test_what_violates_is_found_and_written_out(monkeypatch, capsys):
    monkeypatch.setattr(bound_chunk, "draw", too_near)
    monkeypatch.setattr(bound, "SWEEP", SWEEP[: CHEAP + 1])
    monkeypatch.setattr(bound, "tasks", lambda *sizes: [t for t in tasks(*sizes) if t.case <= CHEAP])
    monkeypatch.setattr(sys, "argv", ["bound", "--scenes", "20", "--brute", "0", "--workers", "0", "--json"])
    with pytest.raises(SystemExit, match="violate the bound"):
        bound.main()
    bad = json.loads(capsys.readouterr().out)["violations"]
    assert bad
    for scene in bad:
        assert scene["bound"] is None or scene["bound"] > scene["distance"] == 0.0
        assert any(value is not None for value in scene["readings"])


def too_near(*arguments):
    readings, distances, centres, radii = DRAW(*arguments)
    return readings, 0.0 * distances, centres, radii


DRAW = bound_chunk.draw


def test_a_denied_ball_violates_and_rounding_does_not():
    bounds, distances = np.array([math.nan, 1.0, 1.0, 0.0]), np.array([1.0, 1.0 - 1e-8, 1.0 - 1e-10, 0.0])
    assert violates(bounds, distances).tolist() == [True, True, False, False]


def test_a_ball_reads_no_more_than_the_length_of_the_part_of_the_cone_that_it_meets():
    rng, angle = np.random.default_rng(2), math.radians(20.0)
    centres = rng.uniform([-0.2, -0.3, -0.3], [0.7, 0.3, 0.3], (20_000, 3))
    radii = rng.uniform(0.02, 0.2, 20_000)
    readings = sphere_readings(centres, radii, angle)
    off = np.hypot(centres[:, 1], centres[:, 2])
    met = np.array([_from_cone(centres[:, 0], off, angle, length) for length in (0.1, 0.3, 0.6)]) <= radii
    assert 0.05 < met.mean() < 0.95
    np.testing.assert_array_equal(met, [readings <= length for length in (0.1, 0.3, 0.6)])

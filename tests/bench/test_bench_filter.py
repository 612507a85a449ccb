"""The benchmark of the filter runs, and its solvers solve the same programme. No figure is judged."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.filter_solvers import SOLVERS, Programme
from ssm_service.motion import Box, VelocityFilter

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("filter")
    done = subprocess.run(
        [sys.executable, "-m", "bench.filter", "--json", "--seed", "7", "--ticks", "5", "--out", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=110,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), folder


def test_it_times_ticks_parts_and_solvers(result):
    document, folder = result
    assert document["benchmark"] == "filter"
    rows = {row["what"]: row for row in document["rows"]}
    for place in ("spread", "crowd"):
        field, filtered = (rows[f"`Monitor.step`, `{name}`, {place}"] for name in ("field", "filter"))
        assert field["calls"] == filtered["calls"] == 5
        assert filtered["added_us"] == pytest.approx(filtered["p50_us"] - field["p50_us"])
    parts = [row for row in rows.values() if row.get("share_percent") is not None]
    assert [row["share_percent"] for row in parts[:4]] == [100.0] * 4
    assert sum(row["share_percent"] for row in parts[4:]) == pytest.approx(100.0)
    assert any(what.startswith("daqp ") for what in rows)
    assert {path.name for path in folder.iterdir()} == {"filter.md", "filter.json", "filter.png"}


@pytest.mark.parametrize("name", ["daqp", "clarabel"])
def test_the_solvers_agree_with_the_filter(name):
    rng = np.random.default_rng(3)
    solve = SOLVERS[name]()
    for _ in range(20):
        programme = Programme(
            wanted=rng.normal(size=6),
            gradients=rng.normal(size=(30, 6)) * 0.3,
            bounds=np.append(rng.uniform(0.0, 0.5, 29), np.inf),
            box=Box(-rng.uniform(0.1, 1.0, 6), rng.uniform(0.1, 1.0, 6)),
        )
        found = VelocityFilter().solve(programme.wanted, programme.gradients, programme.bounds, programme.box)
        np.testing.assert_allclose(solve(*programme.prepared()), found.velocity, atol=1e-4)

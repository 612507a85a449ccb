"""Every benchmark runs as its users run it, and says what it promises. No figure is judged."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TIMES = {"p50_us", "p99_us", "p99.9_us", "max_us"}
SMALL = {"tick": ("--ticks", "3"), "loop": ("--seconds", "0.05"), "latency": ("--messages", "20")}


def run(module: str, *arguments: str, status: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=110
    )
    assert done.returncode == status, done.stderr
    return done


@pytest.fixture(scope="module", params=SMALL)
def result(request, tmp_path_factory):
    """Name, what stdout said as JSON, and the folder of ``--out``."""
    folder = tmp_path_factory.mktemp(request.param)
    done = run(f"bench.{request.param}", "--json", "--seed", "7", "--out", str(folder), *SMALL[request.param])
    return request.param, json.loads(done.stdout), folder


def test_the_results_say_what_they_depend_on(result):
    name, document, _ = result
    assert document["benchmark"] == name
    assert document["machine"].keys() == {"cpu", "cores", "kernel", "python"}
    assert document["versions"].keys() == {"pin", "coal", "eclipse-zenoh", "numpy", "ssm-service"}
    assert document["settings"]["seed"] == 7
    assert document["notes"]


def test_every_row_has_ordered_percentiles(result):
    _, document, _ = result
    for row in document["rows"]:
        assert row.keys() >= TIMES
        values = [row[name] for name in ("p50_us", "p99_us", "p99.9_us", "max_us")]
        assert all(map(math.isfinite, values))
        assert values == sorted(values)
        assert values[0] >= 0.0


def test_the_rows_are_all_there(result):
    name, document, _ = result
    wanted = {
        "tick": {
            ("pace", "what", "obstacles"): [
                (pace, what, count)
                for pace in ("tight", "2 ms sleeps")
                for what in ("step", "steady", "scan", "floor", "wire")
                for count in (1, 10, 100)
            ]
        },
        "loop": {
            ("rate_hz", "load", "method"): [
                (rate, load, method)
                for rate in (100, 500, 1000)
                for load in ("idle", "busy")
                for _ in ("ordinary", "real-time")
                for method in ("loop", "spin")
            ]
        },
        "latency": {
            ("rate_hz", "path"): [
                (rate, path)
                for rate in (500, 1000)
                for path in ("command", "zone", "one_way_in", "one_way_out", "tick_phase", "floors")
            ]
        },
    }[name]
    for keys, rows in wanted.items():
        assert [tuple(row[key] for key in keys) for row in document["rows"]] == rows


def test_each_benchmark_gives_its_own_fields(result):
    name, document, _ = result
    for row in document["rows"]:
        if name == "tick":
            assert row["ticks"] == 3
            assert row["per_obstacle_us"] == pytest.approx(row["p50_us"] / row["obstacles"])
            assert (row["ratio_to_floor"] is None) == (row["what"] in ("wire", "scan"))
        elif name == "loop":
            assert row["skipped"] >= 0
            assert math.isfinite(row["rate_error_percent"])
            assert row["scheduling"].startswith("real-time") == bool(row["in_force"])
        elif row["path"] == "command":
            assert row["messages"] + row["unanswered"] == 20
            assert row["superseded"] >= 0


def test_out_holds_table_json_and_figure(result):
    name, document, folder = result
    assert {path.name for path in folder.iterdir()} == {f"{name}.md", f"{name}.json", f"{name}.png"}
    assert json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) == document
    table = (folder / f"{name}.md").read_text(encoding="utf-8")
    assert document["machine"]["kernel"] in table
    assert "| p50 [µs] |" in table


def test_the_list_names_every_benchmark_in_one_line():
    listed = run("bench").stdout.splitlines()
    names = json.loads(run("bench", "--json").stdout)
    assert set(names) >= set(SMALL)
    assert [line.split()[2] for line in listed] == [f"bench.{name}" for name in names]
    assert all(names.values())


@pytest.mark.parametrize("wrong", ["0", "-1", "nan", "many"])
def test_a_wrong_size_is_refused(wrong):
    assert "--ticks" in run("bench.tick", "--ticks", wrong, status=2).stderr

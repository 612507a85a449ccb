"""The table of ``bench.avoidance`` counts what happened, and its lines let a run go on where it ended."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from bench import avoidance, avoidance_lines, avoidance_table
from bench.avoidance_lines import Lines, of_value, outcome_digest, scene_digest, to_value
from bench.avoidance_methods import METHODS
from bench.avoidance_notes import against_peer, notes, stuck_ratio
from bench.avoidance_outcome import Outcome
from bench.avoidance_table import table


def outcome(**changes) -> Outcome:
    base = Outcome(number=1, kind="static", method="filter", possible=True, blocked=True, planned=2.0)
    base.least_m, base.solve_us = 0.05, Counter({10.0: 1, 30.0: 1})
    base.instants, base.info = 2, {"plans": 0, "failed": 0}
    return replace(base, **changes)


FOUND = [
    outcome(end="arrived", arrived_s=3.0, path=3.0, least_m=0.03),
    outcome(number=2, end="stuck", goal_m=0.2, least_m=0.04),
    outcome(number=3, end="contact", contact="drove", where="a and b", least_m=-0.01),
    outcome(
        number=4,
        end="arrived",
        arrived_s=5.0,
        path=5.0,
        least_m=0.05,
        retreating=2,
        helpless=1,
        info={"plans": 1, "failed": 0, "apart": "c and d"},
        possible=False,
        planned=None,
    ),
    outcome(number=5, kind="crossing", end="late", least_m=0.02, over=1, itself=3),
]


def test_table_counts_what_happened():
    rows = table(FOUND, ["filter"])
    assert [(row["kind"], row["scenes"]) for row in rows] == [("all", 5), ("static", 4), ("crossing", 1)]
    total = rows[0]
    assert (total["possible"], total["arrivals"], total["stuck"], total["late"]) == (4, 1, 1, 1)
    assert (total["contacts"], total["drove"], total["yielding"]) == (1, 1, 0)
    assert (total["retreating"], total["helpless"], total["itself"]) == (1, 1, 1)
    assert (total["arrival_share"], total["stuck_share"]) == (0.25, 0.25)
    assert total["arrivals_thought_impossible"] == 1
    assert (total["time_s"], total["path_ratio"], total["least_m"]) == (3.0, 1.5, -0.01)
    assert total["over_share"] == 0.1
    assert (total["p50_us"], total["p99_us"]) == (10.0, 30.0)
    assert avoidance_table.broken(rows) == ["filter: 1 contacts by its own fault"]
    assert (
        avoidance_table.broken(table([replace(one, contact="", end="late") for one in FOUND], ["filter"]))
        == []
    )
    assert set(avoidance_table.COLUMNS) <= set(total)
    assert any("3: a and b" in note for note in notes(rows, FOUND))
    assert any("4: c and d" in note for note in notes(rows, FOUND))


def test_notes_say_where_the_filter_is_worse_than_the_peer():
    mine = [outcome(number=n, end="arrived", arrived_s=3.0, path=2.5, least_m=0.03) for n in range(4)]
    same = [replace(one, method="pink") for one in mine]
    rows = {row["method"]: row for row in table([*mine, *same], ["filter", "pink"]) if row["kind"] == "all"}
    said = against_peer(rows["filter"], rows["pink"], [*mine, *same])
    assert "at least as good in every column" in said
    assert "4 scenes where both arrive: time 3.00 to 3.00 s, path 2.50 to 2.50 rad" in said
    same[0] = replace(same[0], arrived_s=1.0, least_m=0.05)
    same[1:] = [
        replace(one, arrived_s=2.0, end="stuck" if one.number == 3 else "arrived") for one in same[1:]
    ]
    rows = {row["method"]: row for row in table([*mine, *same], ["filter", "pink"]) if row["kind"] == "all"}
    said = against_peer(rows["filter"], rows["pink"], [*mine, *same])
    assert "worse in time [s] 3 to 2" in said
    assert "share" not in said
    assert "In the 3 scenes where both arrive: time 3.00 to 2.00 s" in said
    assert "least d" not in said.partition("5 % d")[0]


def test_notes_say_how_much_less_often_the_filter_is_stuck():
    mine = [outcome(number=n, end="stuck" if n == 0 else "arrived", arrived_s=1.0) for n in range(6)]
    field = [outcome(number=n, method="field3d", end="stuck" if n < 3 else "late") for n in range(6)]
    (said,) = stuck_ratio(table([*mine, *field], ["filter", "field3d"]))
    assert "filter 1 to field3d 3 (3 times less often" in said
    assert "late: 0 to 3" in said
    assert list(stuck_ratio(table([*mine, *field[:5]], ["filter", "field3d"]))) == []


def test_an_outcome_comes_back_from_its_json():
    for one in FOUND:
        assert of_value(json.loads(json.dumps(to_value(one)))) == one


def test_lines_are_kept_and_a_torn_one_does_no_harm(tmp_path):
    path = tmp_path / "new" / "lines.jsonl"
    lines = Lines(path)
    lines.keep("a", {"x": 1})
    lines.keep("b", {"x": 2})
    path.write_text(path.read_text()[:-7])
    again = Lines(path)
    assert (again.get("a"), again.get("b")) == ({"x": 1}, None)
    again.keep("c", {"x": 3})
    assert Lines(path).get("c") == {"x": 3}
    assert Lines(path).get("a") == {"x": 1}


def test_digests_change_with_what_counts(monkeypatch):
    scene = {"scene": {}, "planned": 1.0}
    digests = [outcome_digest(scene, method, 40.0) for method in METHODS]
    digests += [outcome_digest(scene | {"planned": 2.0}, "field", 40.0), outcome_digest(scene, "field", 4.0)]
    digests += [scene_digest(1, 0), scene_digest(1, 1), scene_digest(2, 0)]
    assert len(set(digests)) == len(digests)
    assert set(avoidance_lines.SOURCES) == set(METHODS)
    meaning = avoidance_lines._meaning

    def changed(name: str) -> str:
        return meaning(name) + ("#" if name.endswith("filtering.py") else "")

    monkeypatch.setattr(avoidance_lines, "_meaning", changed)
    after = [outcome_digest(scene, method, 40.0) for method in METHODS]
    other = {method for method, a, b in zip(METHODS, digests, after, strict=False) if a != b}
    assert other == {"filter-only", "filter", "filter+planner"}


def test_the_filters_settings_count_only_where_they_matter(monkeypatch):
    file = avoidance_lines.robot().config.file

    def digests(**changes: float) -> list[str]:
        own = msgspec.structs.replace(file.motion.filter, **changes)
        motion = msgspec.structs.replace(file.motion, filter=own)
        changed = msgspec.structs.replace(file, motion=motion)
        arm = SimpleNamespace(config=SimpleNamespace(file=changed))
        monkeypatch.setattr(avoidance_lines, "robot", lambda: arm)
        outcomes = [outcome_digest({}, method, 40.0) for method in ("filter", "field", "pink")]
        return [scene_digest(1, 0), *outcomes]

    def which(**changes: float) -> list[bool]:
        return [a != b for a, b in zip(digests(), digests(**changes), strict=True)]

    assert which(circulation_m_s=0.01) == [False, True, False, False]
    assert which(margin_m=0.05) == [False, True, True, True]


def test_comments_and_docstrings_are_no_code(tmp_path, monkeypatch):
    monkeypatch.setattr(avoidance_lines, "_ROOT", tmp_path)
    texts = {
        "a.py": "def f():\n    'one'\n    return 1\n",
        "b.py": "def f():  # two\n    return (1)\n",
        "c.py": "def f():\n    return 2\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    a, b, c = (avoidance_lines._meaning(name) for name in texts)
    assert a == b != c


def started(arguments: list[str], monkeypatch, capsys) -> dict:
    monkeypatch.setattr("sys.argv", ["avoidance", "--json", "--workers", "0", *arguments])
    avoidance.main()
    document: dict = json.loads(capsys.readouterr().out)
    return document


def test_benchmark_runs_writes_its_files_and_goes_on_from_its_lines(tmp_path: Path, monkeypatch, capsys):
    lines, counted = ["--lines", str(tmp_path / "lines.jsonl")], []
    kept = avoidance._run

    def counting(piece, digest):
        counted.append((piece.scene["scene"]["number"], piece.method))
        return kept(piece, digest)

    monkeypatch.setattr(avoidance, "_run", counting)
    started(["--scenes", "1", "--first", "1", "--methods", "field3d", *lines], monkeypatch, capsys)
    out = tmp_path / "out"
    arguments = ["--scenes", "1", "--first", "1", "--methods", "field3d,pink", "--out", str(out), *lines]
    document = started(arguments, monkeypatch, capsys)
    assert counted == [(1, "field3d"), (1, "pink")]
    assert document["benchmark"] == "avoidance"
    assert {row["method"] for row in document["rows"]} == {"field3d", "pink"}
    assert document["notes"]
    assert {path.name for path in out.iterdir()} == {"avoidance.md", "avoidance.json", "avoidance.png"}
    again = started(arguments, monkeypatch, capsys)
    assert again["rows"] == document["rows"]
    assert len(counted) == 2


def test_unknown_method_is_refused(monkeypatch):
    monkeypatch.setattr("sys.argv", ["avoidance", "--methods", "wish"])
    with pytest.raises(SystemExit):
        avoidance.main()

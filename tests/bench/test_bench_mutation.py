"""The mutation bench on a room made for it: what tests miss is found, named and held against the list."""

from __future__ import annotations

import shutil
import sys
import tomllib
from collections import Counter
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench.mutation import LIST, judge, rooms
from bench.mutation_run import MutationError, Outcome, Room, Survivor, run_room, survivor

ROOT = Path(__file__).resolve().parents[2]
SOURCE = '''\
class Gate:
    """Lets through what is small."""

    def __init__(self, limit):
        self.limit = limit

    def open(self, value):
        return value < self.limit


def unseen(value):
    return value + 1
'''
TESTS = """\
import pytest
from ssm_service.tiny.gate import Gate


@pytest.mark.parametrize("name", ["ü", b"\\xff"], ids=repr)
def test_it_opens(name):
    assert Gate(5).open(3)
    assert not Gate(5).open(7)
"""


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tree with one room of one file and one test, which forgets the edge and a whole function.

    The test's names are such as pytest escapes: not found again, they made every mutant look noticed.
    """
    root = tmp_path_factory.mktemp("tree")
    for name, text in {
        "pyproject.toml": "[tool.pytest.ini_options]\naddopts = '-q'\n",
        "ssm_service/__init__.py": "",
        "ssm_service/tiny/__init__.py": "",
        "ssm_service/tiny/gate.py": SOURCE,
        "tests/tiny/test_gate.py": TESTS,
    }.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return root


@pytest.fixture(scope="module")
def outcome(tree: Path) -> Outcome:
    room = Room(name="tiny", modules=("ssm_service/tiny/gate.py",), tests=("tests/tiny",))
    return run_room(tree, room, 1)


EDGE = Survivor(
    file="ssm_service/tiny/gate.py",
    function="Gate.open",
    number=8,
    line="return value < self.limit",
    mutant="return value <= self.limit",
    status="survived",
)


def test_what_the_tests_miss_is_found_with_its_place(outcome: Outcome) -> None:
    assert EDGE in outcome.survivors
    unreached = [one for one in outcome.survivors if one.function == "unseen"]
    assert unreached
    assert {(one.number, one.status) for one in unreached} == {(12, "no tests")}
    assert outcome.survivors == [EDGE, *unreached]
    assert outcome.counts["killed"] >= 1
    assert outcome.counts.total() == outcome.counts["killed"] + len(outcome.survivors)


def test_what_is_known_is_kept_as_long_as_it_rests_on_the_same(tree: Path, tmp_path: Path) -> None:
    """After a new test only survivors are tested again, and all mutants after a change of their file."""
    root = tmp_path / "root"
    shutil.copytree(tree, root)
    kept = tmp_path / "kept"
    room = Room(name="tiny", modules=("ssm_service/tiny/gate.py",), tests=("tests/tiny",))
    assert run_room(root, room, 1, keep=kept, count=True).counts.keys() == {"not tested"}
    numbers, tested = [], 0
    for name, text in (
        ("tests/tiny/test_gate.py", TESTS),
        ("tests/tiny/test_gate.py", TESTS),
        ("tests/tiny/test_edge.py", TESTS.replace("open(7)", "open(5)")),
        ("ssm_service/tiny/gate.py", SOURCE + "\n# changed\n"),
    ):
        (root / name).write_text(text, encoding="utf-8")
        outcome = run_room(root, room, 2, keep=kept)
        lines = (kept / "tiny" / "mutants.jsonl").read_text(encoding="utf-8").count("\n")
        numbers.append((lines - tested, outcome.counts.total(), len(outcome.survivors)))
        tested = lines
    (first, every, survivors), *others = numbers
    assert first == every > survivors > 1
    assert others == [
        (0, every, survivors),
        (survivors, every, survivors - 1),
        (every, every, survivors - 1),
    ]


def test_a_test_that_was_left_out_notices_nothing(tree: Path) -> None:
    room = Room(
        name="tiny",
        modules=("ssm_service/tiny/gate.py",),
        tests=("tests/tiny/test_gate.py",),
        without=("tests/tiny/test_gate.py::test_it_opens",),
    )
    with pytest.raises(MutationError, match="collected"):
        run_room(tree, room, 1)


def test_the_tree_itself_is_left_alone(tree: Path, outcome: Outcome) -> None:
    assert (tree / "ssm_service/tiny/gate.py").read_text(encoding="utf-8") == SOURCE
    assert not (tree / "mutants").exists()


def test_tests_that_fail_without_a_mutant_are_an_error(tree: Path) -> None:
    (tree / "tests/tiny/test_wrong.py").write_text("def test_wrong():\n    assert False\n")
    room = Room(name="tiny", modules=("ssm_service/tiny/gate.py",), tests=("tests/tiny/test_wrong.py",))
    with pytest.raises(MutationError):
        run_room(tree, room, 1)


def test_a_name_that_cannot_be_read_is_an_error(tree: Path) -> None:
    with pytest.raises(MutationError, match="gate"):
        survivor(tree, "ssm_service.tiny.gate", "survived", "")


def entry(**changes: str) -> dict[str, str]:
    known = {"file": EDGE.file, "function": EDGE.function, "line": EDGE.line, "mutant": EDGE.mutant}
    return {**known, "reason": "why", **changes}


@pytest.mark.parametrize("changes", [{}, {"mutant": "return value *"}])
def test_a_listed_survivor_is_no_difference(changes: dict[str, str]) -> None:
    assert judge(Outcome(counts=Counter(), survivors=[EDGE]), [entry(**changes)]) == ([], [])


@pytest.mark.parametrize("key", ["file", "function", "line", "mutant"])
def test_another_place_or_change_is_a_difference_both_ways(key: str) -> None:
    other = entry(**{key: "x"})
    assert judge(Outcome(counts=Counter(), survivors=[EDGE]), [other]) == ([EDGE], [other])


def test_a_listed_one_that_is_noticed_by_now_is_a_difference() -> None:
    assert judge(Outcome(counts=Counter(), survivors=[]), [entry()]) == ([], [entry()])


def test_the_list_names_files_and_lines_that_exist_and_reasons() -> None:
    listed = tomllib.loads(LIST.read_text(encoding="utf-8"))
    every = rooms(listed)
    assert set(every) == {"safety", "wire", "client", "monitor"}
    for room in every.values():
        assert room.modules
        assert all((ROOT / path).exists() for path in (*room.modules, *room.tests))
    for left_out in listed["not_run"]:
        assert (ROOT / left_out["file"]).exists()
        assert left_out["reason"]
    modules = {module for room in every.values() for module in room.modules}
    for unknown in listed.get("not_finished", []):
        assert unknown["file"] in modules
        assert unknown["reason"]
    for known in listed["survivor"]:
        assert known["reason"]
        source = (ROOT / known["file"]).read_text(encoding="utf-8")
        assert known["line"] in " ".join(line.strip() for line in source.splitlines())

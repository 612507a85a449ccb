"""Runs mutmut on one room in a copy of the tree, and reads which mutants its tests let through."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

CAUGHT = {"killed", "timeout", "segfault", "caught by type check"}
"""What counts as noticed; a mutant that no test even reaches is a survivor like any other."""

_NAME = re.compile(r"(?P<module>[\w.]+?)\.x(?:_|ǁ(?P<kind>\w+?)ǁ)(?P<function>\w+)__mutmut_\d+")
_SHOW = """
import sys
from mutmut.__main__ import find_mutant, get_diff_for_mutant
for name in sys.stdin.read().split():
    print(get_diff_for_mutant(name, path=find_mutant(name).path), end="\\0")
"""
# A test's name with a backslash is escaped once more at each collection in one process. mutmut asks for the
# names of the first one, finds none of them, and takes that for a mutant that was noticed.
_NAMES_AS_THEY_ARE = "disable_test_id_escaping_and_forfeit_all_rights_to_community_support=true"
_PARTS = ("ssm_service", "robots", "tests", "bench", "docker", "README.md", "CHANGELOG.md", "constraints.txt")


@dataclass(frozen=True, slots=True, kw_only=True)
class Room:
    """What is mutated, and the tests that must notice.

    Attributes:
        name: The room's name.
        modules: Its files that are mutated, from the root of the tree; a pattern may end in ``*``.
        tests: Files or folders of tests.
    """

    name: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Survivor:
    """A change that no test noticed.

    Attributes:
        file: From the root of the tree.
        function: With its class, if it has one.
        number: Of the first changed line; 0 where it is not found.
        line: The changed lines, without the space around them.
        mutant: What they became.
        status: In mutmut's words.
    """

    file: str
    function: str
    number: int
    line: str
    mutant: str
    status: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of one room.

    Attributes:
        counts: Mutants by status.
        survivors: In the order of the files and lines.
    """

    counts: Counter[str]
    survivors: list[Survivor]


class MutationError(Exception):
    """mutmut could not do its work; what it said."""


def run_room(root: Path, room: Room, jobs: int) -> Outcome:
    """Mutate a room in a copy of the tree; the tree itself is left alone.

    Args:
        root: The tree.
        room: The room.
        jobs: Tests that run at once.

    Raises:
        MutationError: The room's tests fail without a mutant, or mutmut does.
    """
    with tempfile.TemporaryDirectory(prefix=f"mutation-{room.name}-") as folder:
        copy = Path(folder)
        _copy(root, copy, room)
        done = _mutmut(copy, "run", "--max-children", str(jobs))
        if done.returncode != 0:
            raise MutationError((done.stdout + done.stderr).replace("\r", "\n")[-4000:])
        statuses = dict(_statuses(_mutmut(copy, "results", "--all", "true").stdout))
        left = [name for name, status in statuses.items() if status not in CAUGHT]
        found = [survivor(copy, name, statuses[name], shown) for name, shown in _shown(copy, left)]
    found.sort(key=lambda one: (one.file, one.number, one.mutant))
    return Outcome(counts=Counter(statuses.values()), survivors=found)


def survivor(root: Path, name: str, status: str, shown: str) -> Survivor:
    """Return a survivor from mutmut's name of it and the difference that it shows."""
    parts = _NAME.fullmatch(name)
    if parts is None:
        raise MutationError(f"a name of a mutant that cannot be read: {name}")
    file = next(
        path for path in (f"{parts['module'].replace('.', '/')}{end}" for end in (".py", "/__init__.py"))
        if (root / path).exists()
    )  # fmt: skip
    function = ".".join(filter(None, (parts["kind"], parts["function"])))
    body = [line for line in shown.splitlines() if not line.startswith(("---", "+++"))]
    line, mutant = (" ".join(row[1:].strip() for row in body if row.startswith(sign)) for sign in "-+")
    first = next((row[1:].strip() for row in body if row.startswith("-")), "")
    return Survivor(
        file=file,
        function=function,
        number=_place(root / file, function, first),
        line=line,
        mutant=mutant,
        status=status,
    )


def _place(path: Path, function: str, line: str) -> int:
    """Return the number of the first such line of the function; 0 where there is none."""
    source = path.read_text(encoding="utf-8")
    *kinds, name = function.split(".")
    nodes: list[ast.AST] = [ast.parse(source)]
    for wanted in (*kinds, name):
        nodes = [
            node
            for outer in nodes
            for node in ast.iter_child_nodes(outer)
            if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.name == wanted
        ]
    lines = source.splitlines()
    for node in nodes:
        for number in range(node.lineno, (node.end_lineno or 0) + 1):  # type: ignore[attr-defined]
            if lines[number - 1].strip() == line:
                return number
    return 0


def _copy(root: Path, copy: Path, room: Room) -> None:
    ignore = shutil.ignore_patterns("__pycache__", "*.pyc")
    present = [part for part in _PARTS if (root / part).exists()]
    for part in present:
        if (root / part).is_dir():
            shutil.copytree(root / part, copy / part, ignore=ignore)
        else:
            shutil.copy2(root / part, copy / part)
    settings = {
        "source_paths": ["ssm_service"],
        "only_mutate": list(room.modules),
        "also_copy": [part for part in present if part != "ssm_service"],
        "pytest_add_cli_args_test_selection": list(room.tests),
        "pytest_add_cli_args": ["-p", "no:cacheprovider", "-o", _NAMES_AS_THEY_ARE],
    }
    lines = [f"{key} = {_toml(value)}" for key, value in settings.items()]
    project = (root / "pyproject.toml").read_text(encoding="utf-8")
    text = "\n".join([project, "[tool.mutmut]", *lines, ""])
    (copy / "pyproject.toml").write_text(text, encoding="utf-8")


def _toml(values: Sequence[str]) -> str:
    return "[" + ", ".join(f"'{value}'" for value in values) + "]"


def _mutmut(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mutmut", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL)


def _shown(folder: Path, names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Give each mutant's name and difference, as ``mutmut show`` does, which takes a second for each."""
    command = [sys.executable, "-c", _SHOW]
    done = subprocess.run(command, cwd=folder, input="\n".join(names), capture_output=True, text=True)
    if done.returncode != 0:
        raise MutationError(done.stderr[-4000:])
    yield from zip(names, done.stdout.split("\0")[:-1], strict=True)


def _statuses(text: str) -> Iterator[tuple[str, str]]:
    """Give name and status of each mutant of ``mutmut results``."""
    for line in text.splitlines():
        name, separator, status = line.strip().partition(": ")
        if separator and "__mutmut_" in name:
            yield name, status

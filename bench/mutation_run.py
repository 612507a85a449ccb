"""Runs the mutants of one room in a copy of the tree, and says which of them its tests let through."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

CAUGHT = {"killed", "timeout", "segfault"}
"""What counts as noticed; a mutant that no test even reaches is a survivor like any other."""

UNTESTED = "not tested"
"""Status of a mutant of which nothing is known."""

_NAME = re.compile(r"(?P<module>[\w.]+?)\.x(?:_|ǁ(?P<kind>\w+?)ǁ)(?P<function>\w+)__mutmut_\d+")
_PARTS = ("ssm_service", "robots", "tests", "bench", "docker", "README.md", "CHANGELOG.md", "constraints.txt")
_WORKER = Path(__file__).with_name("mutation_worker.py")


@dataclass(frozen=True, slots=True, kw_only=True)
class Room:
    """What is mutated, and the tests that must notice.

    Attributes:
        name: The room's name.
        modules: Its files that are mutated, from the root of the tree.
        tests: Files or folders of tests.
        without: Beginnings of names of tests among them that take too long to be run for every mutant. To
            leave out a test can only make more mutants survive.
        warm: Beginnings of names of tests that load what many others load as well. They run once before the
            first mutant, and must start no threads.
    """

    name: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]
    without: tuple[str, ...] = ()
    warm: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Survivor:
    """A change that no test noticed.

    Attributes:
        file: From the root of the tree.
        function: With its class, if it has one.
        number: Of the first changed line; 0 where it is not found.
        line: The changed lines, without the space around them.
        mutant: What they became.
        status: ``survived``, or ``no tests`` where no test reaches the function.
    """

    file: str
    function: str
    number: int
    line: str
    mutant: str
    status: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of some files of a room.

    Attributes:
        counts: Mutants by status.
        survivors: In the order of the files and lines.
        by_file: The same counts for each file.
        stopped: Mutants that ran out of time or broke the process, each with the test it was at.
    """

    counts: Counter[str]
    survivors: list[Survivor]
    by_file: dict[str, Counter[str]] = field(default_factory=dict)
    stopped: list[str] = field(default_factory=list)


class MutationError(Exception):
    """The mutants could not be tested; what was said."""


def run_room(
    root: Path,
    room: Room,
    jobs: int,
    *,
    files: Sequence[str] = (),
    keep: Path | None = None,
    count: bool = False,
) -> Outcome:
    """Mutate a room in a copy of the tree; the tree itself is left alone.

    Args:
        root: The tree.
        room: The room.
        jobs: Tests that run at once.
        files: Only the mutants of these of its files are tested; empty for all.
        keep: A folder that keeps the copy, for one run at a time, and what is known of each mutant. What was
            noticed is not tested again before its file, or the file of the test that noticed, changes; what
            survived, not before any file of the room's tests does. So an interrupted run goes on, and after
            a new test only what survived is tested.
        count: Make the mutants, and test none.

    Raises:
        MutationError: The room's tests fail without a mutant, or the tool does.
    """
    files = files or room.modules
    with _folder(room, keep) as folder:
        kept = _Kept(Path(folder), root, room)
        if kept.run(jobs, files, count=count) != 0:
            raise MutationError(kept.log.read_text(encoding="utf-8")[-4000:])
        shown = json.loads(kept.shown_file.read_text(encoding="utf-8"))
        known = kept.known()
    names = {name for module in files for name in shown[module]}
    status = {name: known[name]["status"] if name in known else UNTESTED for name in names}
    by_file = {module: Counter(status[name] for name in shown[module]) for module in files}
    survivors = [
        survivor(root, name, status[name], difference)
        for module in files
        for name, difference in shown[module].items()
        if status[name] not in CAUGHT | {UNTESTED}
    ]
    survivors.sort(key=lambda one: (one.file, one.number, one.mutant))
    stopped = [
        f"{name}: {status[name]} at {known[name]['by']}"
        for name in sorted(names)
        if status[name] in ("timeout", "segfault")
    ]
    counts = sum(by_file.values(), Counter())
    return Outcome(counts=counts, survivors=survivors, by_file=by_file, stopped=stopped)


def _folder(room: Room, keep: Path | None) -> AbstractContextManager[Path | str]:
    if keep is not None:
        return nullcontext(keep)
    return tempfile.TemporaryDirectory(prefix=f"mutation-{room.name}-")


class _Kept:
    """A folder: the copy of the tree, and what is known of a room's tests and mutants, one on a line."""

    def __init__(self, folder: Path, root: Path, room: Room) -> None:
        self.room = room
        self.tree = folder / "tree"
        folder /= room.name
        self.shown_file = folder / "shown.json"
        self.tests_file = folder / "tests.jsonl"
        self.log = folder / "log"
        self.mutants_file = folder / "mutants.jsonl"
        folder.mkdir(parents=True, exist_ok=True)
        _copy(root, self.tree)
        self.stamps, self.test_stamps = _stamps(root, room)

    def known(self) -> dict[str, dict[str, str]]:
        """Return what is known of mutants and still holds, by name."""
        return {one["mutant"]: one for one in _lines(self.mutants_file) if one["stamp"] == self._stamp(one)}

    def _stamp(self, one: dict[str, str]) -> str | None:
        return self.stamps.get(one["mutant"].rpartition(".")[0], {}).get(one["by"].partition("::")[0])

    def run(self, jobs: int, files: Sequence[str], *, count: bool) -> int:
        """Run the process that does the work, and writes into the log how far it is; return its status."""
        seen = {
            one["test"]: one
            for one in _lines(self.tests_file)
            if not one["failed"] and one["stamp"] == self.test_stamps.get(one["test"].partition("::")[0])
        }
        plan = {
            "modules": self.room.modules,
            "files": files,
            "tests": self.room.tests,
            "without": self.room.without,
            "warm": self.room.warm,
            "jobs": jobs,
            "count": count,
            "done": sorted(self.known()),
            "seen": seen,
            "stamps": self.stamps,
            "test_stamps": self.test_stamps,
            "shown_file": str(self.shown_file.resolve()),
            "tests_file": str(self.tests_file.resolve()),
            "mutants_file": str(self.mutants_file.resolve()),
        }
        path = self.log.with_name("plan.json")
        path.write_text(json.dumps(plan), encoding="utf-8")
        environment = os.environ | {"PYTHONPATH": str(self.tree.resolve())}
        command = [sys.executable, "-P", str(_WORKER), str(path.resolve())]
        with self.log.open("w", encoding="utf-8") as log:
            return subprocess.run(
                command, cwd=self.tree, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            ).returncode


def _stamps(root: Path, room: Room) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """Return digests of what a verdict rests on, and of what is known of a test.

    The first by module and by the file of the test that noticed, ``""`` where none did; the second by file.
    """
    folders = {root / one if (root / one).is_dir() else (root / one).parent for one in room.tests}
    helpers = [path for path in _python(folders) if not path.name.startswith("test_")]
    helpers += [path for path in (root / "tests" / "conftest.py",) if path.exists()]
    common = _digest(helpers)
    chosen = [path for path in _python(root / one for one in room.tests) if path.name.startswith("test_")]
    tests = {path.relative_to(root).as_posix(): _digest([path]) + common for path in chosen}
    every = _digest(chosen) + common
    modules = {module: _digest([root / module]) for module in room.modules}
    room_digest = _digest(root / module for module in room.modules)
    stamps = {
        _dotted(module): {"": digest + every} | {test: digest + stamp for test, stamp in tests.items()}
        for module, digest in modules.items()
    }
    return stamps, {test: room_digest + stamp for test, stamp in tests.items()}


def _python(places: Iterable[Path]) -> list[Path]:
    return sorted(
        {path for place in places for path in (place.rglob("*.py") if place.is_dir() else (place,))}
    )


def _dotted(module: str) -> str:
    return module.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _digest(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    if path.exists():
        yield from map(json.loads, path.read_text(encoding="utf-8").splitlines())


def survivor(root: Path, name: str, status: str, shown: str) -> Survivor:
    """Return a survivor from the tool's name of it and the difference."""
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


def _copy(root: Path, copy: Path) -> None:
    """Bring a copy up to date. A file that is the same stays as it is: compiled code is kept by its time."""
    paths = [root / part for part in _PARTS] + [path for part in _PARTS for path in (root / part).rglob("*")]
    files = (path for path in paths if path.is_file() and path.parent.name != "__pycache__")
    wanted = {path.relative_to(root) for path in files}
    present = {path.relative_to(copy) for path in copy.rglob("*.py") if path.is_file()}
    for path in present - wanted:
        (copy / path).unlink()
    for path in wanted:
        if not (copy / path).exists() or (copy / path).read_bytes() != (root / path).read_bytes():
            (copy / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / path, copy / path)
    project = (root / "pyproject.toml").read_text(encoding="utf-8")
    text = project + '\n[tool.mutmut]\nsource_paths = ["ssm_service"]\n'
    (copy / "pyproject.toml").write_text(text, encoding="utf-8")

"""Tests the mutants of one room, each in a fork of one process that collected the tests once.

A program of its own, started in a copy of the tree: ``mutation_worker.py PLAN`` (JSON, see `work`). mutmut
makes the mutants; starting pytest for each of them, as it does, takes longer here than the tests that notice.
Each test is first run once without a mutant, to see which functions it reaches. Then each mutant is shown to
the tests that reach it, the quick ones first, until one fails; which must pass in a fork without a mutant.
"""

from __future__ import annotations

import difflib
import gc
import json
import math
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import pytest
from mutmut.mutation.data import LineSpan
from mutmut.mutation.file_mutation import mutate_file_contents
from mutmut.mutation.trampoline import set_mutant_under_test
from mutmut.state import state
from mutmut.utils.format_utils import get_mutant_name, mangled_name_from_mutant_name

QUICK_S = 0.1
"""Tests up to here run first, module by module, so that what a module's tests share is made once [s, CPU]."""
LIMIT_S = 10.0, 10.0
"""CPU time that a mutant's tests may take: this, and so many times what they take without it [s, 1]."""
WALL_S = 30.0, 10.0
"""The same by the clock, for those that wait for ever [s, 1]."""


def mutate(module: Path) -> dict[str, str]:
    """Replace a module by one with all its mutants; return each one's name and difference."""
    source = module.read_text(encoding="utf-8")
    made = mutate_file_contents(str(module), source)
    module.write_text(made.code, encoding="utf-8")
    lines = made.code.splitlines()
    shown = {}
    for name in made.mutant_names:
        mangled = mangled_name_from_mutant_name(name)
        old, new = (
            _lines(lines, made.line_span_by_function_name[one], one)
            for one in (f"{mangled}__mutmut_orig", name)
        )
        shown[get_mutant_name(module, name)] = "\n".join(difflib.unified_diff(old, new, lineterm=""))
    return shown


def _lines(lines: Sequence[str], span: LineSpan, name: str) -> list[str]:
    return [line.replace(name, "function") for line in lines[span.start - 1 : span.end]]


@dataclass(slots=True)
class Running:
    """A fork that tests a mutant."""

    mutant: str
    begin: float
    limit: float
    folder: Path

    @property
    def test(self) -> int:
        """Number of the test that it is at, among all that were collected."""
        return int((self.folder / "test").read_text(encoding="utf-8"))


class Tester:
    """Plugin for pytest that replaces its loop over the tests."""

    def __init__(self, plan: dict[str, Any], names: dict[str, list[str]]) -> None:
        self.plan = plan
        self.names = names
        self.seen: dict[str, dict[str, Any]] = plan["seen"]
        self.shared: dict[tuple[str, str], set[str]] = {}
        self.running: dict[int, Running] = {}
        self.passing: set[int] = set()
        self.noticed: dict[str, Counter[str]] = defaultdict(Counter)

    def pytest_sessionstart(self) -> None:
        """Before tests are collected."""
        _hypothesis()

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Any:
        """Note what a fixture reaches: where tests share it, all of them reach that, not the first alone."""
        outer = _taken()
        try:
            return (yield)
        finally:
            reached = _taken()
            self.shared[fixturedef.baseid, fixturedef.argname] = reached
            state()._stats |= outer | reached

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Do everything."""
        if session.testsfailed or not session.items:
            raise pytest.UsageError("the tests cannot be collected")
        unseen = [item for item in session.items if item.nodeid not in self.seen]
        if unseen:
            print(f"{len(unseen)} tests run once to see what they reach", flush=True)
            os.waitpid(os.fork() or self._look(unseen), 0)
            self.seen |= {one["test"]: one for one in _read(Path(self.plan["tests_file"]))}
            failed = [
                item.nodeid for item in unseen if self.seen.get(item.nodeid, {"failed": True})["failed"]
            ]
            if failed:
                raise pytest.UsageError(f"these tests fail without a mutant: {failed[:10]}")
        chosen = {
            module: {name: self._reaching(session, mangled_name_from_mutant_name(name)) for name in names}
            for module, names in self.names.items()
        }
        self._warm(session)
        self.items = session.items
        self.number = {item.nodeid: index for index, item in enumerate(session.items)}
        gc.freeze()  # what is here by now is never freed: forks need not copy it to look through it
        for module, of in chosen.items():
            self._module(module, of)
        return True

    def _look(self, items: Sequence[pytest.Item]) -> NoReturn:
        """Run tests without a mutant, and note what each of them reaches."""
        set_mutant_under_test("stats")
        with _ending(), Path(self.plan["tests_file"]).open("a", encoding="utf-8") as out:
            for item, following in _pairs(items):
                _taken()
                begin, cpu = time.monotonic(), time.process_time()
                failed = _fails(item, following)
                reached = _taken().union(*(self.shared.get(key, ()) for key in _fixtures(item)))
                line = {
                    "test": item.nodeid,
                    "failed": failed,
                    "wall": time.monotonic() - begin,
                    "cpu": time.process_time() - cpu,
                    "reached": sorted(reached),
                    "stamp": self.plan["test_stamps"].get(item.nodeid.partition("::")[0], ""),
                }
                out.write(json.dumps(line) + "\n")
                out.flush()
            os._exit(0)

    def _warm(self, session: pytest.Session) -> None:
        """Run some tests here, so that forks find what they load and compile, and their session's fixtures.

        Such a fixture is then made without the mutant, so that a mutant may only be noticed less.
        """
        names = tuple(self.plan["warm"])
        chosen = [item for item in session.items if names and item.nodeid.startswith(names)]
        others = [item for item in session.items if item not in chosen]
        for item, following in _pairs(chosen):
            _fails(item, following or others[0])
        session.testsfailed = 0
        print(f"{len(chosen)} tests run beforehand; {len(os.listdir('/proc/self/task'))} threads", flush=True)

    def _module(self, module: str, chosen: dict[str, list[pytest.Item]]) -> None:
        worst = sum(self.seen[item.nodeid]["cpu"] for items in chosen.values() for item in items)
        print(f"{module}: {len(chosen)} mutants to test, at most {worst:.0f} s of CPU time", flush=True)
        for name, items in chosen.items():
            if not items:
                self._note(name, "no tests", "")
                continue
            while len(self.running) >= self.plan["jobs"]:
                self._collect()
            self._start(name, self._promising(name, items))
        while self.running:
            self._collect()

    def _control(self, test: int) -> None:
        """Run a test that noticed a mutant in a fork without one: failing there too, it noticed nothing."""
        if test in self.passing:
            return
        self.passing.add(test)
        pid = self._start("", [self.items[test]])
        while pid in self.running:
            self._collect()

    def _reaching(self, session: pytest.Session, function: str) -> list[pytest.Item]:
        return self._ordered(item for item in session.items if function in self.seen[item.nodeid]["reached"])

    def _promising(self, name: str, items: Sequence[pytest.Item]) -> list[pytest.Item]:
        """Put first the tests that noticed other mutants of the function; the rest keeps its order."""
        noticed = self.noticed[mangled_name_from_mutant_name(name)]
        return sorted(items, key=lambda item: -noticed[item.nodeid])

    def _ordered(self, items: Iterable[pytest.Item]) -> list[pytest.Item]:
        def key(item: pytest.Item) -> tuple[float, str]:
            cpu = self.seen[item.nodeid]["cpu"]
            return (0.0, item.nodeid.partition("::")[0]) if cpu < QUICK_S else (cpu, "")

        return sorted(items, key=key)

    def _start(self, name: str, items: Sequence[pytest.Item]) -> int:
        cpu, wall = (sum(self.seen[item.nodeid][kind] for item in items) for kind in ("cpu", "wall"))
        folder = Path(tempfile.mkdtemp(prefix="mutant-"))
        pid = os.fork()
        if pid:
            limit = time.monotonic() + WALL_S[0] + WALL_S[1] * wall
            self.running[pid] = Running(name, time.monotonic(), limit, folder)
            return pid
        with _ending():
            set_mutant_under_test(name)
            os.environ["PYTEST_DEBUG_TEMPROOT"] = str(folder)
            most = math.ceil(LIMIT_S[0] + LIMIT_S[1] * cpu)
            resource.setrlimit(resource.RLIMIT_CPU, (most, most + 5))
            at = os.open(folder / "test", os.O_CREAT | os.O_WRONLY)
            for item, following in _pairs(items):
                os.pwrite(at, f"{self.number[item.nodeid]:9d}".encode(), 0)
                if _fails(item, following):
                    os._exit(1)
            os._exit(0)

    def _collect(self) -> None:
        """Take in the forks that have ended."""
        time.sleep(0.01)
        for pid, one in list(self.running.items()):
            late = time.monotonic() > one.limit
            if late:
                os.kill(pid, signal.SIGKILL)
            ended, status = os.waitpid(pid, 0 if late else os.WNOHANG)
            if ended:
                del self.running[pid]
                self._ended(one, "timeout" if late else _verdict(status))
                return

    def _ended(self, one: Running, verdict: str) -> None:
        noticed = verdict != "survived"
        test = self.items[one.test].nodeid
        if noticed and not one.mutant:
            raise pytest.UsageError(f"without a mutant, in a fork: {verdict} at {test}")
        if noticed:
            self._control(one.test)
        if one.mutant:
            self._note(one.mutant, verdict, test if noticed else "", one.begin)
        shutil.rmtree(one.folder, ignore_errors=True)

    def _note(self, mutant: str, status: str, by: str, begin: float | None = None) -> None:
        if by:
            self.noticed[mangled_name_from_mutant_name(mutant)][by] += 1
        stamp = self.plan["stamps"][mutant.rpartition(".")[0]].get(by.partition("::")[0], "")
        seconds = 0.0 if begin is None else round(time.monotonic() - begin, 2)
        line = {"mutant": mutant, "status": status, "by": by, "stamp": stamp, "seconds": seconds}
        with Path(self.plan["mutants_file"]).open("a", encoding="utf-8") as out:
            out.write(json.dumps(line) + "\n")


class _ending:
    """Ends a fork for certain, whatever is raised in it; what it says goes nowhere."""

    def __enter__(self) -> None:
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, 1)
        os.dup2(sink, 2)

    def __exit__(self, *_: object) -> None:
        os._exit(3)


def _verdict(status: int) -> str:
    code = os.waitstatus_to_exitcode(status)
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        return "timeout"
    return "segfault" if code < 0 else "killed" if code else "survived"


def _taken() -> set[str]:
    """Return the functions reached since the last call."""
    reached = set(state()._stats)
    state()._stats.clear()
    return reached


def _fixtures(item: pytest.Item) -> Iterator[tuple[str, str]]:
    for definitions in item._fixtureinfo.name2fixturedefs.values():  # type: ignore[attr-defined]
        for one in definitions:
            yield one.baseid, one.argname


def _pairs(items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    return zip(items, [*items[1:], None], strict=False)


def _fails(item: pytest.Item, following: pytest.Item | None) -> bool:
    before = item.session.testsfailed
    item.ihook.pytest_runtest_protocol(item=item, nextitem=following)
    return item.session.testsfailed > before


def _read(path: Path) -> list[dict[str, Any]]:
    return (
        [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    )


def _hypothesis() -> None:
    """Have its tests do the same each time: what notices a mutant once notices it again."""
    try:
        from hypothesis import settings
    except ImportError:
        return
    settings.register_profile("mutation", derandomize=True, database=None, deadline=None)
    settings.load_profile("mutation")


def work() -> int:
    """Follow a plan, a JSON object.

    What is read: ``modules`` and ``tests`` (from the root of the tree); ``without`` (beginnings of names of
    tests that are not run), ``warm`` (of those that are run once before all forks); ``files`` (the modules
    whose mutants are tested), ``done`` (names of mutants that need no test any more), ``count`` (no mutant is
    tested); ``seen`` (what is known of tests, by name); ``jobs``; ``stamps`` and ``test_stamps`` (written
    along with what is found). What is written: ``shown_file``, ``tests_file``, ``mutants_file``.
    """
    plan = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    set_mutant_under_test("")
    shown = {module: mutate(Path(module)) for module in plan["modules"]}
    Path(plan["shown_file"]).write_text(json.dumps(shown), encoding="utf-8")
    if plan["count"]:
        return 0
    done = set(plan["done"])
    names = {module: [name for name in shown[module] if name not in done] for module in plan["files"]}
    if not any(names.values()):
        return 0
    os.environ["PYTEST_TIMEOUT"] = "0"
    # What a failure looks like is never seen, and takes longer than most tests.
    options = ["--rootdir=.", "--tb=native", "--assert=plain", "-q", "-s", "-p", "no:cacheprovider"]
    tester = Tester(plan, names)
    options += [f"--deselect={name}" for name in plan["without"]]
    return int(pytest.main([*options, *plan["tests"]], plugins=[tester]))


if __name__ == "__main__":
    sys.exit(work())

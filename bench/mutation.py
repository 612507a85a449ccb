"""Do the tests notice a wrong operator, constant or argument in what decides? Mutants of four rooms.

mutmut changes one place after the other in a copy of the tree; the tests of the room that reach it are run.
What survives must stand in ``mutation_survivors.toml`` with the reason why it may; ends with status 1 if one
does not, or if a listed one is noticed by now. Two limits of the tool: what has a decorator (properties) and
what stands outside of functions (constants, defaults of fields) is not mutated. Files that are not mutated at
all stand in the same list, with their reason; so does nothing else of a room. It also says which files were
never run to the end so far: of these nobody knows what survives.

It takes hours. With ``--keep DIR`` an interrupted run goes on; after a new test only survivors are tested.
"""

from __future__ import annotations

import argparse
import os
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from .common import Report, Row
from .mutation_run import UNTESTED, Outcome, Room, Survivor, run_room

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_name("mutation_survivors.toml")
COLUMNS = {
    "file": "file",
    "mutants": "mutants",
    "untested": "not tested",
    "killed": "killed",
    "timeout": "by time",
    "survivors": "survived",
    "listed": "of these listed",
}
Entry = dict[str, str]


def rooms(listed: dict[str, Any], root: Path = ROOT) -> dict[str, Room]:
    """Return the rooms as the list of survivors defines them: all their files but those left out."""
    left_out = {entry["file"] for entry in listed.get("not_run", [])}
    made = {}
    for name, room in listed["rooms"].items():
        folder = root / "ssm_service" / name
        modules = sorted(path.relative_to(root).as_posix() for path in folder.glob("*.py"))
        kept = tuple(module for module in modules if module not in left_out)
        lists = {key: tuple(room.get(key, ())) for key in ("tests", "without", "warm")}
        made[name] = Room(name=name, modules=kept, **lists)
    return made


def matches(entry: Entry, one: Survivor) -> bool:
    """Tell whether an entry of the list is about a survivor; its ``mutant`` may be a pattern with ``*``."""
    return (
        entry["file"] == one.file
        and entry["function"] == one.function
        and entry["line"] == one.line
        and (entry["mutant"] == one.mutant or fnmatchcase(one.mutant, entry["mutant"]))
    )


def judge(outcome: Outcome, entries: list[Entry]) -> tuple[list[Survivor], list[Entry]]:
    """Return the survivors that no entry is about, and the entries that are about no survivor."""
    new = [one for one in outcome.survivors if not any(matches(entry, one) for entry in entries)]
    stale = [entry for entry in entries if not any(matches(entry, one) for one in outcome.survivors)]
    return new, stale


def _left_out(listed: dict[str, Any]) -> list[str]:
    """Return a note for each file that is not mutated."""
    return [f"not mutated: {entry['file']}: {entry['reason']}" for entry in listed["not_run"]]


def _never_finished(listed: dict[str, Any], files: Iterable[str]) -> list[str]:
    """Return a note for each of these files that was never run to the end."""
    return [
        f"{entry['file']} was never run to the end so far: {entry['reason']}"
        for entry in listed.get("not_finished", [])
        if entry["file"] in files
    ]


def _arguments(every: dict[str, Room]) -> argparse.Namespace:
    options = argparse.ArgumentParser(
        prog="python -m bench.mutation", description=(__doc__ or "").partition("\n")[0]
    )
    options.add_argument("--json", action="store_true", help="machine-readable, on stdout")
    options.add_argument("--out", type=Path, metavar="DIR", help="write the table and the JSON there")
    options.add_argument(
        "--room", action="append", choices=sorted(every), help="only this one; may be repeated"
    )
    options.add_argument(
        "--file",
        action="append",
        choices=sorted(module for room in every.values() for module in room.modules),
        metavar="FILE",
        help="only this one, such as ssm_service/wire/gate.py; may be repeated",
    )
    options.add_argument(
        "--keep", type=Path, metavar="DIR", help="keep there what is known, and test only what is not known"
    )
    options.add_argument("--count", action="store_true", help="make the mutants, but test none")
    options.add_argument(
        "--jobs",
        type=int,
        default=len(os.sched_getaffinity(0)),
        metavar="N",
        help="tests at once (default: %(default)s)",
    )
    return options.parse_args()


def _row(file: str, counts: Counter[str], survivors: list[Survivor], new: list[Survivor]) -> Row:
    survived = sum(one.file == file for one in survivors)
    return {
        "file": file,
        "mutants": counts.total(),
        "untested": counts[UNTESTED],
        "killed": counts["killed"],
        "timeout": counts["timeout"] + counts["segfault"],
        "survivors": survived,
        "listed": survived - sum(one.file == file for one in new),
    }


def main() -> None:
    """Run the benchmark."""
    listed = tomllib.loads(LIST.read_text(encoding="utf-8"))
    every = rooms(listed)
    arguments = _arguments(every)
    wanted = arguments.file or [
        module for name in arguments.room or sorted(every) for module in every[name].modules
    ]
    report = Report(name="mutation", settings={"jobs": arguments.jobs}, columns=COLUMNS, rows=[])
    wrong = 0
    for room in every.values():
        files = [module for module in room.modules if module in wanted]
        if not files:
            continue
        outcome = run_room(
            ROOT, room, arguments.jobs, files=files, keep=arguments.keep, count=arguments.count
        )
        new, stale = judge(outcome, [entry for entry in listed["survivor"] if entry["file"] in files])
        if outcome.counts[UNTESTED]:
            stale = []
        wrong += len(new) + len(stale)
        report.rows += [
            _row(file, counts, outcome.survivors, new)
            | {"new": [asdict(one) for one in new if one.file == file]}
            for file, counts in outcome.by_file.items()
        ]
        report.notes += [
            f"{one.file}:{one.number} {one.function}: `{one.line}` became `{one.mutant}` ({one.status})"
            for one in new
        ]
        report.notes += [
            f"{entry['file']} {entry['function']}: `{entry['mutant']}` is in the list, but noticed"
            for entry in stale
        ]
        report.notes += [f"noticed only so: {one}" for one in outcome.stopped]
    others = {module for room in every.values() for module in room.modules} - set(wanted)
    report.notes += _left_out(listed) + _never_finished(listed, others)
    report.finish(arguments)
    if wrong:
        sys.exit(f"{wrong} differences to {LIST.name}; see the notes")


if __name__ == "__main__":
    main()

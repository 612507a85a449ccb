"""The table of ``bench.faults``."""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

from .common import Report, Row
from .faults_bounds import FORMULAS

Line = dict[str, Any]

COLUMNS = {
    "fault": "fault",
    "injected": "injected",
    "messages": "messages",
    "noticed": "noticed",
    "by": "noticed by",
    "stop_ms": "worst to stop [ms]",
    "bound_ms": "its bound [ms]",
    "spare_ms": "least to spare [ms]",
    "late": "late",
    "wrong": "wrongly relaxed",
    "recovered": "recovered",
}

NOTES = """\
'injected' counts injections, 'messages' the messages in them; 'noticed' counts injections all of whose \
faulty messages were refused or counted, or for which the word that names the fault was said.
'worst to stop' is the longest time from the first faulty message (or the signal) to the consumer's stop, \
where one is due; the bound beside it is the one of that same case, and 'least to spare' is what any case \
had left of its own. A single message less, or a bad one between \
good ones, leaves good ones that are fresh: nobody has to stop.
'wrongly relaxed': a zone milder than the true one, a clear scene believed that is not, a leave to move held \
beyond its validity, or motion in a stop.
`clock` faults shift `time.time_ns` of this bench's own child processes, through a `sitecustomize` module \
on their `PYTHONPATH`; the machine's clock stays as it is.
`latch:full disk` is RLIMIT_FSIZE 0 on the service; `memory` is RLIMIT_AS on the evaluating process; \
`starve` is one process on each processor at SCHED_FIFO 60, above the service's 50.\
"""


def report(arguments: argparse.Namespace, lines: list[Line], *, interrupted: bool) -> Report:
    """Return table and notes of what was injected."""
    groups: dict[tuple[str, str], list[Line]] = {}
    for line in lines:
        groups.setdefault((line["group"], line["fault"]), []).append(line)
    rows = [_row(group, fault, found) for (group, fault), found in groups.items()]
    notes = [*NOTES.splitlines(), *FORMULAS.splitlines()]
    errors = Counter(line["error"].partition("\n")[0] for line in lines if "error" in line)
    notes += [f"not injected, {count} times: {text}" for text, count in errors.items()]
    if interrupted:
        notes.append("interrupted: this is what there was by then")
    return Report(
        name="faults",
        settings={
            "seed": arguments.seed,
            "injections": arguments.injections,
            "processes": arguments.processes,
            "in-process": arguments.in_process,
            "profile": arguments.profile,
        },
        columns=COLUMNS,
        rows=rows,
        notes=notes,
    )


def _row(group: str, fault: str, lines: list[Line]) -> Row:
    """Return one line of the table; its cells are kept beside it."""
    row = _summary(lines)
    row["fault"] = f"{group}: {fault}"
    cells: dict[str, list[Line]] = {}
    for line in lines:
        cells.setdefault(line["cell"], []).append(line)
    row["cells"] = {cell: _summary(found) for cell, found in cells.items()} if len(cells) > 1 else {}
    return row


def _summary(lines: list[Line]) -> Row:
    done = [line for line in lines if not line.get("void")]
    words: Counter[str] = Counter()
    for line in done:
        words.update(line["by"])
    due = [line for line in done if line.get("stop_due") and line.get("stop_ms") is not None]
    worst = max(due, key=lambda line: line["stop_ms"], default=None)
    wrongs = Counter(word for line in done for word in line["wrong"])
    return {
        "injected": sum(line.get("injected", 1) for line in done),
        "messages": sum(line["messages"] for line in done),
        "noticed": sum(_noticed(line) for line in done),
        "by": ", ".join(word for word, _ in words.most_common(4)) or "–",
        "stop_ms": None if worst is None else worst["stop_ms"],
        "bound_ms": None if worst is None else worst["bound_ms"],
        "spare_ms": min((line["bound_ms"] - line["stop_ms"] for line in due), default=None),
        "late": sum(bool(line["late"]) for line in done),
        "wrong": ", ".join(f"{word} ×{count}" for word, count in wrongs.items()) or 0,
        "recovered": sum(int(line["recovered"]) * line.get("injected", 1) for line in done),
    }


def _noticed(line: Line) -> int:
    if "injected" in line:
        return int(line["noticed"])
    return int(line["noticed"] >= (line["messages"] if line["group"] == "wire" else 1))

"""Fuzzes every decoder, every loader and ``evaluate``: guided by coverage with Atheris, else by Hypothesis.

``pip install '.[fuzz]'`` brings Atheris. Each target runs in a process of its own, for its share of the time.
The inputs that reached something new are kept in ``CORPUS/TARGET`` and are where the next run goes on; one
input for each place that broke is kept in ``CORPUS/crashes/TARGET``, with its traceback. ``--replay FILE``
runs such an input again. Ends with status 1 where anything broke.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from .common import Report, Row, parser, progress
from .fuzz_targets import targets

ROOT = Path(__file__).resolve().parents[1]
GRACE_S = 120.0
"""Beyond its time, for a target's start and its last input."""

NOTES = """\
A refusal is an `SsmError`. A finding is anything else that is raised, a number that is not finite, a zone \
other than stop for what was refused, an attachment opened by a wrong checksum, an input that takes seconds.
'accepted' are those that passed the door.\
"""


def run(name: str, seconds: float, seed: int, folder: Path, engine: str) -> Row:
    """Fuzz one target and return its row."""
    corpus, crashes = folder / name, folder / "crashes" / name
    crashes.mkdir(parents=True, exist_ok=True)
    arguments = [name, str(seconds), str(seed), str(corpus), str(crashes), engine]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "bench.fuzz_worker", *arguments],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
            timeout=seconds + GRACE_S,
        )
        words, status = done.stderr, done.returncode
        lines = done.stdout.splitlines()
    except subprocess.TimeoutExpired as error:
        words, status, lines = f"it hangs: {error}", -1, []
    counts: dict[str, Any] = json.loads(lines[-1]) if status == 0 and lines else {}
    if not counts:
        (crashes / "process.txt").write_text(f"status {status}\n{words}", encoding="utf-8")
    return {
        "target": name,
        "ended": "well" if counts else f"status {status}",
        "runs": counts.get("runs", 0),
        "accepted": counts.get("accepted", 0),
        "worst_ms": 1e3 * counts.get("worst_s", 0.0),
        "corpus": len(list(corpus.glob("*"))) if corpus.is_dir() else 0,
        "findings": counts.get("crashes", 1),
        "files": sorted(str(path) for path in crashes.iterdir()),
    }


def replay(files: list[Path]) -> int:
    """Run inputs again; return how many still break something. The target is the folder's name."""
    broken = 0
    for path in files:
        parts = path.resolve().parts
        name = "/".join(parts[parts.index("crashes") + 1 : -1]) if "crashes" in parts else path.parent.name
        try:
            accepted = targets()[name].run(path.read_bytes())
        except Exception as error:
            broken += 1
            print(f"{path}: {type(error).__name__}: {error}")
        else:
            print(f"{path}: {'accepted' if accepted else 'refused'}, as it must be")
    return broken


def _arguments() -> argparse.Namespace:
    options = parser("fuzz", __doc__, "seconds", 600.0, "s, all targets together")
    options.add_argument(
        "--corpus", type=Path, default=Path("fuzz-corpus"), metavar="DIR", help="kept between runs"
    )
    options.add_argument(
        "--target", action="append", choices=sorted(targets()), help="only this one; repeatable"
    )
    options.add_argument(
        "--engine", choices=("atheris", "hypothesis"), help="by default the first that is there"
    )
    options.add_argument(
        "--replay", type=Path, nargs="+", metavar="FILE", help="run kept inputs again, and no more"
    )
    return options.parse_args()


def main() -> None:
    """Run the benchmark."""
    arguments = _arguments()
    if arguments.replay:
        sys.exit(1 if replay(arguments.replay) else 0)
    engine = arguments.engine or "atheris"
    if engine == "atheris" and importlib.util.find_spec("atheris") is None:
        if arguments.engine:
            sys.exit("Atheris is not installed: pip install '.[fuzz]'")
        engine = "hypothesis"
        print(
            "Atheris is not installed (pip install '.[fuzz]'): Hypothesis, without coverage", file=sys.stderr
        )
    names = arguments.target or sorted(targets())
    rows = []
    with progress() as bar:
        task = bar.add_task("targets", total=len(names))
        for name in names:
            folder = arguments.corpus.resolve()
            rows.append(run(name, arguments.seconds / len(names), arguments.seed, folder, engine))
            bar.advance(task)
    broken = [row["target"] for row in rows if row["findings"]]
    Report(
        name="fuzz",
        settings={"seed": arguments.seed, "seconds": arguments.seconds, "engine": engine},
        columns={
            "target": "target",
            "runs": "inputs",
            "accepted": "accepted",
            "corpus": "corpus",
            "worst_ms": "longest [ms]",
            "findings": "findings",
            "ended": "ended",
        },
        rows=rows,
        notes=[*NOTES.splitlines(), f"{sum(row['runs'] for row in rows)} inputs in all."],
    ).finish(arguments)
    if broken:
        sys.exit(f"findings in {', '.join(broken)}: see {arguments.corpus}/crashes")


if __name__ == "__main__":
    main()

"""What every benchmark needs: arguments, the machine, percentiles, tables, reports."""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

PACKAGES = ("pin", "coal", "eclipse-zenoh", "numpy", "ssm-service")
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}

Row = dict[str, Any]
Draw = Callable[[Path], None]


def parser(
    name: str, description: str | None, size: str, default: float, unit: str
) -> argparse.ArgumentParser:
    """Return the arguments that all benchmarks share.

    Args:
        name: The benchmark's name.
        description: Its docstring; the first line is shown.
        size: The size flag without dashes, e.g. ``ticks``; a whole number if ``default`` is one.
        default: Its default.
        unit: What it counts.
    """
    result = argparse.ArgumentParser(
        prog=f"python -m bench.{name}", description=(description or "").partition("\n")[0]
    )
    result.add_argument("--json", action="store_true", help="machine-readable, on stdout")
    result.add_argument(
        "--out", type=Path, metavar="DIR", help="write the table, the JSON and a figure there"
    )
    result.add_argument("--seed", type=int, default=1, help="of everything drawn (default: %(default)s)")
    result.add_argument(
        f"--{size}", type=_positive(type(default)), default=default, help=f"{unit} (default: %(default)s)"
    )
    return result


def _positive(kind: type) -> Callable[[str], Any]:
    def number(text: str) -> Any:
        value = kind(text)
        if not 0 < value < float("inf"):
            raise ValueError(text)
        return value

    number.__name__ = f"positive {kind.__name__}"
    return number


def machine() -> dict[str, Any]:
    """Return what the numbers depend on: processor, cores, kernel, Python."""
    return {
        "cpu": _cpu_model(),
        "cores": len(os.sched_getaffinity(0)),
        "kernel": platform.release(),
        "python": platform.python_version(),
    }


def _cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "model name" and value.strip():
            return value.strip()
    return platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """Return the versions of the packages that the numbers depend on."""
    return {name: version(name) for name in PACKAGES}


def percentiles(nanoseconds: ArrayLike) -> dict[str, float]:
    """Return p50, p99, p99.9 and max of durations [ns] in µs."""
    values = np.asarray(nanoseconds, dtype=np.float64) / 1e3
    return dict(zip(PERCENTILES, np.percentile(values, list(PERCENTILES.values())).tolist(), strict=True))


@dataclass(kw_only=True)
class Report:
    """The results of one benchmark.

    Attributes:
        name: The benchmark's name.
        settings: Seed, size and whatever else was chosen.
        columns: Keys of ``rows`` that the table shows, and their headings.
        rows: One for each line of the table; more keys than columns are welcome.
        notes: What one must know to read the numbers.
        draw: Draws a figure into the file that it is given.
    """

    name: str
    settings: dict[str, Any]
    columns: Mapping[str, str]
    rows: list[Row]
    notes: list[str] = field(default_factory=list)
    draw: Draw | None = None

    def to_builtins(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {
            "benchmark": self.name,
            "machine": machine(),
            "versions": versions(),
            "settings": self.settings,
            "rows": self.rows,
            "notes": self.notes,
        }

    def markdown(self) -> str:
        """Return machine, versions, table and notes as Markdown."""
        here = machine()
        lines = [
            f"`python -m bench.{self.name}` with {_pairs(self.settings)}",
            "",
            f"{here['cpu']}, {here['cores']} cores, Linux {here['kernel']}, Python {here['python']}; "
            + ", ".join(f"{name} {number}" for name, number in versions().items()),
            "",
            markdown_table(self.columns, self.rows),
        ]
        if self.notes:
            lines += ["", *(f"- {note}" for note in self.notes)]
        return "\n".join(lines)

    def finish(self, arguments: argparse.Namespace) -> None:
        """Print to stdout, as JSON if asked to, and write the files of ``--out``."""
        document = json.dumps(self.to_builtins(), indent=1)
        if arguments.out is not None:
            folder: Path = arguments.out
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{self.name}.md").write_text(self.markdown() + "\n", encoding="utf-8")
            (folder / f"{self.name}.json").write_text(document + "\n", encoding="utf-8")
            if self.draw is not None:
                self.draw(folder / f"{self.name}.png")
        print(document if arguments.json else self.markdown())


def markdown_table(columns: Mapping[str, str], rows: Sequence[Row]) -> str:
    """Return rows as an aligned Markdown table; numbers stand at the right."""
    heads = list(columns.values())
    cells = [[_cell(row.get(key)) for key in columns] for row in rows]
    numeric = [all(not isinstance(row.get(key), str) for row in rows) for key in columns]
    widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]
    rule = [("-" * (w - 1) + ":" if right else "-" * w) for w, right in zip(widths, numeric, strict=True)]
    lines = [heads, rule, *cells]
    return "\n".join(
        "| "
        + " | ".join(
            cell.rjust(w) if right else cell.ljust(w)
            for cell, w, right in zip(line, widths, numeric, strict=True)
        )
        + " |"
        for line in lines
    )


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
    return str(value)


def _pairs(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in settings.items())


def progress() -> Progress:
    """Return a progress bar on stderr; used as a context manager."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )


def figure(path: Path, width: float, height: float, draw: Callable[[Any], None]) -> None:
    """Draw one pair of axes and write it to ``path``."""
    from matplotlib.figure import Figure

    shown = Figure(figsize=(width, height), layout="constrained")
    draw(shown.subplots())
    shown.savefig(path, dpi=150)

"""``ssm check``: what is wrong or weak in a robot file or a Zenoh configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import ConfigError, listed
from .findings import Level, Report
from .options import JsonOption
from .output import FAILED, emit, emit_json
from .words import counted

ZENOH_SUFFIXES = (".json5", ".json", ".yaml", ".yml")
STYLES: dict[Level, str] = {"fault": "bold red", "weak": "yellow", "note": "cyan", "ok": "green"}


def check(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="A robot file, by name or path, or a Zenoh configuration (.json5, .json, .yaml).",
        ),
    ] = "ur3",
    json: JsonOption = False,
) -> None:
    """Say what is wrong or weak in a robot file or a Zenoh configuration.

    Exit status 1: a fault was found; 2: the file cannot be read.
    """
    if Path(file).suffix.lower() in ZENOH_SUFFIXES:
        from .check_zenoh import check_zenoh

        report = check_zenoh(Path(file))
    else:
        from .check_robot import check_robot

        try:
            report = check_robot(file)
        except ConfigError as error:
            if error.file != "FILE":
                raise
            allowed = f"{error.allowed}, or of a Zenoh configuration ({listed(ZENOH_SUFFIXES)})"
            raise ConfigError("FILE", "", error.found, allowed) from error
    if json:
        emit_json(report.to_builtins(), indent=2)
    else:
        _print(report)
    if report.count("fault"):
        raise typer.Exit(FAILED)


def _print(report: Report) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(soft_wrap=True)
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    emit(report.file)
    for finding in report.findings:
        what = f"{finding.key}: {finding.text}" if finding.key else finding.text
        if console.is_terminal:
            words = Text(what)
            words.stylize("bold", 0, len(finding.key))
            table.add_row(Text(finding.level, STYLES[finding.level]), words)
        else:  # one line each, for grep
            emit(f"{finding.level:6}{what}")
    if console.is_terminal:
        console.print(table)
    faults, weak = report.count("fault"), report.count("weak")
    emit(f"{counted(faults, 'fault')}, {counted(weak, 'weak point')}")

"""The command line as a whole: which commands there are, and how errors end them."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from .._version import __version__
from ..errors import SsmError
from .check import check
from .coverage import coverage
from .demo import demo
from .evaluate import evaluate
from .keys import keys
from .output import FAILED, abandon_stdout, emit, log, status_of
from .reset import reset
from .run import run
from .schema import schema
from .sim import sim
from .watch import watch
from .zone import zone

app = typer.Typer(
    name="ssm",
    help="Speed and separation monitoring for robot arms. Not a certified safety device.",
    epilog="Start with: ssm demo. Each command explains itself: ssm demo --help. "
    "Exit status: 0 done; 1 it could not be done; 2 wrong usage or configuration.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

for command in (demo, run, sim, zone, watch, reset, evaluate, coverage, check, schema):
    app.command()(command)
app.add_typer(keys)


def _version(wanted: bool) -> None:
    if wanted:
        emit(f"ssm {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Take the options that stand before the command."""


def run_app() -> None:
    """Run the command line; errors that we raise on purpose are one line, never a traceback."""
    try:
        app(prog_name="ssm")
    except SsmError as error:
        log(f"ssm: {error}")
        sys.exit(status_of(error))
    except BrokenPipeError:
        abandon_stdout()
        sys.exit(FAILED)
    except KeyboardInterrupt:
        sys.exit(130)

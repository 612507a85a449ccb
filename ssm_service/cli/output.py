"""Where words go: results to stdout, everything else to stderr."""

from __future__ import annotations

import os
import sys
from typing import Any

import msgspec

from ..errors import ConfigError, InputError, SsmError

DONE, FAILED, MISUSED = 0, 1, 2
"""Exit status: it was done; it could not be done; wrong usage or configuration."""


def log(text: str) -> None:
    """Write one line of progress for people."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def emit(text: str) -> None:
    """Write one line of the result."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def emit_json(value: Any, *, indent: int = 0) -> None:
    """Write a value as JSON, on one line unless indented."""
    data = msgspec.json.encode(value)
    emit((msgspec.json.format(data, indent=indent) if indent else data).decode())


def status_of(error: SsmError) -> int:
    """Return the exit status that belongs to an error."""
    return MISUSED if isinstance(error, ConfigError | InputError) else FAILED


def abandon_stdout() -> None:
    """Let what is still buffered go nowhere: the reader has left, and that is no error of ours to print."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

"""Fixtures of the command's tests."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_kit import COMMAND, Marked, Run, free_endpoint, wait_for_line


@pytest.fixture
def ssm(tmp_path: Path) -> Run:
    """Run ``ssm`` with arguments from an empty folder; what it returns has text streams."""

    def run(*arguments: str, stdin: str = "", timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*COMMAND, *arguments],
            input=stdin,
            capture_output=True,
            text=True,
            timeout=timeout,
            cwd=tmp_path,
            env={**os.environ, "COLUMNS": "200", "NO_COLOR": "1"},
        )

    return run


@pytest.fixture
def marked() -> Iterator[Marked]:
    processes = Marked()
    yield processes
    processes.close()


@pytest.fixture(scope="module")
def service() -> Iterator[str]:
    """A running service; its endpoint."""
    processes, endpoint = Marked(), free_endpoint()
    try:
        wait_for_line(processes.start("run", "--listen", endpoint, "--rate", "100"), "ready")
        yield endpoint
    finally:
        processes.close()

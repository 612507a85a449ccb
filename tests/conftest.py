"""Says which tests need the machine to themselves.

They have processes that must answer within a bounded time, or measure time themselves. All others may run
several at once: ``pytest -n 2 -m "not alone"``, and then ``pytest -m alone``. Plain ``pytest`` runs all of
them one after the other.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ALONE = (
    "bench/test_bench_runs.py",
    "bench/test_bench_scenes.py",
    # Compares bits with those of processes of its own; once they differed after other folders' tests.
    "bench/test_bench_triangulation.py",
    "cli/test_cli_demo.py",
    "cli/test_cli_service.py",
    "client/test_client_queries.py",
    "client/test_client_stream.py",
    "docker/test_docker_layout.py",
    "security",
    "service",
    "simulation/test_simulation_newcomer.py",
    "simulation/test_simulation_process.py",
    "test_readme.py",
    "wire/test_wire_refusals.py",
)
"""Folders and files, here."""


QUESTION = '{"position": [0, 0, 0, 0, 0, 0], "ranges": [0.5, null, null, null, null, null, null, null]}'


def pytest_configure(config: pytest.Config) -> None:
    """Have the inner loops compiled once before several processes would all do it at the same time."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        command = [sys.executable, "-m", "ssm_service.cli", "evaluate"]
        subprocess.run(command, input=QUESTION, text=True, capture_output=True, check=False)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark them ``alone``."""
    places = [HERE / name for name in ALONE]
    for item in items:
        if any(item.path.is_relative_to(place) for place in places):
            item.add_marker("alone")

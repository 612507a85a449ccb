from __future__ import annotations

from collections.abc import Iterator

import pytest
from security_kit import Robot, Watch, guarded


@pytest.fixture(scope="session")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A service that listens behind mutual TLS, with its good driver."""
    with guarded(tmp_path_factory.mktemp("direct") / "keys") as robot:
        yield robot


@pytest.fixture
def watch(robot: Robot) -> Iterator[Watch]:
    watch = Watch(robot, f"viewer-{robot.name}")
    try:
        yield watch
    finally:
        watch.close()

from __future__ import annotations

import pytest

from ssm_service.model import Robot


@pytest.fixture(scope="session")
def ur3() -> Robot:
    return Robot.load("ur3")

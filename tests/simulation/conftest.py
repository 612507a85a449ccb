from __future__ import annotations

import re
from pathlib import Path

import pytest

from ssm_service.model import Robot

README = Path(__file__).resolve().parents[2] / "README.md"


@pytest.fixture(scope="session")
def ur3() -> Robot:
    return Robot.load("ur3")


@pytest.fixture(scope="session")
def my_arm_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The robot file that the README shows to owners of another arm."""
    found = re.search(
        r"<!-- own-robot -->\n```toml\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    assert found, "README.md has no block marked own-robot"
    path = tmp_path_factory.mktemp("arm") / "my_arm.toml"
    path.write_text(found[1], encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def my_arm(my_arm_file: Path) -> Robot:
    return Robot.load(my_arm_file)

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssm_service.config import RobotFile, load_toml
from ssm_service.errors import ConfigError

VALID = """\
urdf = "arm.urdf"
end_effector_frame = "tool"
default_profile = "near"

[joints.locked]
wrist = 0.5

[hull_pieces]
forearm = 3

[[rings]]
name = "upper"
parent_frame = "upper_arm"
origin_m = [0.0, 0.0, 0.1]
count = 8
radius_m = 0.03
field_of_view_deg = 20.0
range_max_m = 1.2
period_s = 0.16

[[rings]]
name = "fore"
parent_frame = "forearm"
origin_m = [0.0, 0.0, 0.1]
count = 6
radius_m = 0.04
field_of_view_deg = 15
range_max_m = 2.0
period_s = 0.1

[profiles.near]
red = { distance_m = 0.2, joint_speed_rad_s = 0.2, speed_scaling = 0.25 }
yellow = { distance_m = 0.4, joint_speed_rad_s = 0.4, speed_scaling = 0.5 }
"""


@pytest.fixture
def text() -> str:
    """A valid robot file."""
    return VALID


@pytest.fixture
def load(tmp_path: Path) -> Callable[[str | bytes], RobotFile]:
    """Write a robot file and load it."""

    def load(content: str | bytes) -> RobotFile:
        path = tmp_path / "arm.toml"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return load_toml(path, RobotFile)

    return load


@pytest.fixture
def refused(load: Callable[[str | bytes], RobotFile], tmp_path: Path) -> Callable[[str | bytes], ConfigError]:
    """Load a robot file that must be refused, and return the error, which names the file."""

    def refused(content: str | bytes) -> ConfigError:
        with pytest.raises(ConfigError) as caught:
            load(content)
        error = caught.value
        assert error.file == str(tmp_path / "arm.toml")
        assert str(error).startswith(f"{error.file}: {error.key}")
        return error

    return refused


@pytest.fixture
def changed(text: str) -> Callable[..., str]:
    """Return the valid file with passages replaced, each of which stands in it."""

    def changed(*replacements: tuple[str, str]) -> str:
        result = text
        for old, new in replacements:
            assert old in result
            result = result.replace(old, new, 1)
        return result

    return changed


def pytest_make_parametrize_id(val: Any) -> str | None:
    """Keep long file contents out of test names."""
    return val[:40] if isinstance(val, str) else None

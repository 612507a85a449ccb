"""Scenario files: what is read, and what is refused with file, key, found and allowed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ssm_service.errors import ConfigError
from ssm_service.model import Robot
from ssm_service.simulation import list_scenarios, load_scenario

GOOD = """\
description = "A ball."
duration_s = 10.0

[start]
elbow_joint = 1.0
shoulder_lift_joint = -0.5

[[targets]]
t_s = 0.0
kind = "position"
value = [0.3, 0.1, 0.3]

[[targets]]
t_s = 4.0
kind = "joint_velocity"
value = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]

[[obstacles]]
shapes = [
  { id = "ball", shape = "sphere", size_m = [0.05] },
  { id = "stick", shape = "capsule", size_m = [0.02, 0.3], offset_m = [0.0, 0.0, 0.2] },
]
path = [
  { t_s = 0.0, position_m = [1.0, 0.0, 0.5] },
  { t_s = 2.0, position_m = [0.0, 1.0, 0.5] },
  { t_s = 3.0, position_m = [1.0, 0.0, 0.5] },
]
"""

Writer = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Writer:
    def writer(text: str) -> Path:
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return path

    return writer


def test_names() -> None:
    assert list_scenarios() == ["crossing", "empty", "hand", "static", "walk"]


def test_reads_a_file(ur3: Robot, write: Writer) -> None:
    scenario = load_scenario(write(GOOD), ur3)
    assert (scenario.name, scenario.description, scenario.duration_s) == ("scene", "A ball.", 10.0)
    np.testing.assert_array_equal(scenario.start, [0.0, -0.5, 1.0, 0.0, 0.0, 0.0])
    ball, stick = scenario.obstacles_at(1.0)
    assert ball.position == pytest.approx((0.5, 0.5, 0.5))
    assert stick.position == pytest.approx((0.5, 0.5, 0.7))
    assert ball.velocity == stick.velocity == pytest.approx((-0.5, 0.5, 0.0))
    assert (ball.shape, ball.size, stick.size) == ("sphere", (0.05,), (0.02, 0.3))
    kinds = [
        (t, target.kind) for t in (0.0, 3.99, 4.0, 9.99, 10.0, 14.5) if (target := scenario.target_at(t))
    ]
    assert [kind for _, kind in kinds] == [
        "position",
        "position",
        "joint_velocity",
        "joint_velocity",
        "position",
        "joint_velocity",
    ]


def test_no_target_and_nothing_there(ur3: Robot, write: Writer) -> None:
    scenario = load_scenario(write('description = "Still."\nduration_s = 1.0\n'), ur3)
    assert scenario.target_at(0.5) is None
    assert scenario.obstacles_at(0.5) == ()


@pytest.mark.parametrize(
    ("old", "new", "key", "allowed"),
    [
        ("duration_s = 10.0", "", "duration_s", "number"),
        ("duration_s = 10.0", "duration_s = -1.0", "duration_s", "> 0"),
        ("duration_s = 10.0", "duration = 10.0", "duration", "did you mean 'duration_s'"),
        ("elbow_joint = 1.0", "elbow = 1.0", "start.elbow", "did you mean 'elbow_joint'"),
        ("elbow_joint = 1.0", "elbow_joint = 4.0", "start.elbow_joint", "-3.14159 to 3.14159"),
        ('"position"', '"pose"', "targets[0].kind", "'position'"),
        ("[0.3, 0.1, 0.3]", "[0.3, 0.1]", "targets[0].value", "3 values"),
        ("[0.3, 0.1, 0.3]", "[0.3, 0.1, nan]", "targets[0].value[2]", "finite"),
        ("t_s = 4.0", "t_s = 0.0", "", "rising times"),
        ("t_s = 4.0", "t_s = 10.0", "", "before `duration_s`"),
        ('"stick"', '"ball"', "", "same id"),
        ('"sphere"', '"ball"', "obstacles[0].shapes[0].shape", "'sphere'"),
        ("[0.05]", "[0.05, 0.1]", "obstacles[0].shapes[0].size_m", "1 number"),
        ("[0.05]", "[-0.05]", "obstacles[0].shapes[0].size_m", "above 0"),
        ("[0.05]", "[inf]", "obstacles[0].shapes[0].size_m[0]", "finite"),
        ("t_s = 2.0", "t_s = 3.0", "obstacles[0]", "rising times"),
        (
            "{ t_s = 0.0, position_m",
            "{ t_s = 0.5, position_m",
            "obstacles[0]",
            "begin at t_s = 0",
        ),
        ("{ t_s = 3.0, position_m = [1.0,", "{ t_s = 3.0, position_m = [1.1,", "obstacles[0]", "'hold'"),
        ("position_m = [0.0, 1.0, 0.5]", "position_m = [0.0, 1e4, 0.5]", "obstacles[0].path[1]", "≤ 100"),
        (
            "offset_m = [0.0, 0.0, 0.2]",
            "quaternion_xyzw = [0.0, 0.0, 0.0, 0.5]",
            "obstacles[0].shapes[1].quaternion_xyzw",
            "norm 1",
        ),
        ("shapes = [", "colour = 1\nshapes = [", "obstacles[0].colour", "shapes"),
        ("[start]", "[start", "", "valid TOML"),
    ],
)
def test_refuses(ur3: Robot, write: Writer, old: str, new: str, key: str, allowed: str) -> None:
    assert old in GOOD
    path = write(GOOD.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, ur3)
    error = caught.value
    assert error.file == str(path)
    assert error.key.startswith(key)
    assert bool(error.key) == bool(key)
    assert allowed in error.allowed
    assert str(error.found)


def test_unknown_name_lists_the_valid_ones(ur3: Robot) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scenario("crosing", ur3)
    assert "did you mean 'crossing'" in caught.value.allowed
    for name in list_scenarios():
        assert name in caught.value.allowed


def test_missing_file(ur3: Robot, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scenario(tmp_path / "none.toml", ur3)
    assert caught.value.file.endswith("none.toml")


def test_too_many_shapes(ur3: Robot, write: Writer) -> None:
    shape = '{{ id = "s{0}", shape = "sphere", size_m = [0.1] }}'
    shapes = ", ".join(shape.format(index) for index in range(129))
    text = f'description = "x"\nduration_s = 1.0\n[[obstacles]]\nshapes = [{shapes}]\n'
    text += "path = [{ t_s = 0.0, position_m = [1.0, 0.0, 0.0] }]\n"
    with pytest.raises(ConfigError) as caught:
        load_scenario(write(text), ur3)
    assert caught.value.key == "obstacles"
    assert "at most 128" in caught.value.allowed

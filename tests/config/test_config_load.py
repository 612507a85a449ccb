"""Finding and reading robot files, and agreement of our check with msgspec's."""

from __future__ import annotations

import copy
import math
import tomllib
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import inspect

from ssm_service.config import (
    MotionConfig,
    RobotFile,
    load_robot_config,
    load_toml,
    robot_names,
    robots_directory,
)
from ssm_service.config.check import DocumentCheck
from ssm_service.config.describe import Place
from ssm_service.errors import ConfigError

SHIPPED = sorted(robots_directory().glob("*.toml"))
DOCUMENT = tomllib.loads((robots_directory() / "ur3.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_robot_loads_by_name_and_by_path(path):
    by_name, by_path = load_robot_config(path.stem), load_robot_config(path)
    assert by_name == by_path
    assert by_name.name == path.stem
    assert Path(by_name.path) == path.resolve()
    assert msgspec.convert(msgspec.to_builtins(by_name.file), RobotFile) == by_name.file


def test_the_names_are_those_of_the_files():
    assert robot_names() == [path.stem for path in SHIPPED]
    assert "ur3" in robot_names()


def test_the_paper_robot_is_as_the_paper_says():
    file = load_robot_config("ur3").file
    assert set(file.joints.locked) == {"wrist_1_joint", "wrist_2_joint", "wrist_3_joint"}
    assert [ring.count for ring in file.rings] == [8]
    profile = file.profiles["kang2022"]
    assert (profile.red.distance_m, profile.yellow.distance_m) == (0.1775, 0.355)
    assert (profile.red.joint_speed_rad_s, profile.yellow.joint_speed_rad_s) == (0.18, 0.24)


def test_the_configuration_in_force_is_plain_values_with_all_defaults():
    plain = load_robot_config("ur3").to_builtins()
    assert plain["name"] == "ur3"
    assert set(plain) == {"name", *RobotFile.__struct_fields__}
    assert set(plain["motion"]) == set(MotionConfig.__struct_fields__)
    assert msgspec.json.decode(msgspec.json.encode(plain))["rings"][0]["count"] == 8


def test_an_unknown_name_suggests_the_nearest():
    with pytest.raises(ConfigError, match=r"--robot: found 'ur33', allowed: did you mean 'ur3'\?") as caught:
        load_robot_config("ur33")
    assert "the path of a .toml file" in caught.value.allowed


@pytest.mark.parametrize("name", ["", "UR3", "ur3 ", "..", "*", "\0"])
def test_odd_names_are_refused(name):
    with pytest.raises(ConfigError, match="--robot"):
        load_robot_config(name)


@pytest.mark.parametrize("name", ["no/such.toml", "missing.toml", "a\0b.toml", "/" + "x" * 5000, "./"])
def test_paths_without_a_file_are_refused(name):
    with pytest.raises(ConfigError) as caught:
        load_robot_config(name)
    assert str(caught.value.found) in ("no such file", "a folder")


def test_a_folder_is_no_file(tmp_path):
    for path in (tmp_path, tmp_path / "arm.toml"):
        path.mkdir(exist_ok=True)
        with pytest.raises(ConfigError, match="found a folder, allowed: a TOML file"):
            load_robot_config(str(path))


def test_a_path_is_kept_absolute_so_that_the_urdf_is_found_beside_it(tmp_path, monkeypatch, text):
    (tmp_path / "arm.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    config = load_robot_config("arm.toml")
    assert config.path == str(tmp_path.resolve() / "arm.toml")


@pytest.mark.parametrize("content", ["", "# nothing but a remark\n", "\n\n"])
def test_an_empty_file_lists_the_required_keys(content, refused):
    error = refused(content)
    assert error.key == ""
    assert "urdf, end_effector_frame, default_profile, profiles" in error.allowed


@pytest.mark.parametrize("content", ["urdf", "urdf = ", "<robot/>", '{"urdf": "x"}', "a = [1,", "a = 1\0"])
def test_what_is_no_toml_is_refused(content, refused):
    assert "valid TOML" in refused(content).allowed


def test_a_toml_fault_shows_its_line(text, refused):
    message = str(refused(text.replace("count = 8", "count == 8")))
    assert "line 15" in message
    assert "count == 8" in message


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("count = 8", "count = 8\ncount = 9"),
        ("[hull_pieces]", "[joints.locked]\n[hull_pieces]"),
        ("[hull_pieces]", "[profiles.near]\n[hull_pieces]"),
        ("distance_m = 0.2", "distance_m = 0.2, distance_m = 0.3"),
    ],
)
def test_a_key_that_stands_twice_is_refused(old, new, changed, refused):
    assert "only once" in refused(changed((old, new))).allowed


def test_bytes_that_are_no_utf8_are_refused_with_their_line(text, refused):
    message = str(refused(text.encode() + b"# caf\xe9\n"))
    assert "0xe9" in message
    assert f"line {text.count(chr(10)) + 1}" in message
    assert "UTF-8" in message


def test_utf16_is_refused(text, refused):
    assert "UTF-8" in refused(text.encode("utf-16")).allowed


def test_a_byte_order_mark_and_windows_line_ends_are_read(text, load):
    assert load(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()) == load(text)


@pytest.mark.parametrize(
    "content", ["a = " + "[" * 20000, "a = " + "9" * 5000, ".".join("a" * 3000) + " = 1"]
)
def test_absurd_files_end_in_an_error_and_not_in_a_crash(content, refused):
    assert len(str(refused(content))) < 600


class Ball(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="ball", tag_field="shape"):
    radius: float


class Brick(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="brick", tag_field="shape"):
    size: tuple[float, float, float]


class Scene(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    things: list[Ball | Brick] = []
    mode: Literal["a", "b"] | None = None
    either: int | str = 0
    free: Any = None
    levels: list[Literal[1, 2]] = []


@pytest.mark.parametrize(
    ("content", "key", "words"),
    [
        ("things = [{ shape = 'ball' }]", "things[0].radius", "number"),
        ("things = [{ shape = 'ball', radius = 1 }, { radius = 1 }]", "things[1].shape", "ball, brick"),
        ("things = [{ shape = 'bal', radius = 1 }]", "things[0].shape", "did you mean 'ball'?"),
        ("things = [{ shape = 'ball', size = 1 }]", "things[0].size", "shape, radius"),
        ("things = [7]", "things[0]", "a table"),
        ("mode = 'c'", "mode", "'a' or 'b'"),
        ("either = 1.5", "either", "int"),
        ("free = { deep = [1.0, nan] }", "free.deep[1]", "finite"),
        ("levels = [1, 3]", "levels[1]", "'1' or '2'"),
    ],
)
def test_other_files_are_read_with_the_same_care(content, key, words, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(content)
    with pytest.raises(ConfigError) as caught:
        load_toml(path, Scene)
    assert caught.value.key == key
    assert words in caught.value.allowed


def test_a_file_without_required_keys_may_be_empty(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("")
    assert load_toml(path, Scene) == Scene()


def slots(value: Any) -> list[tuple[Any, Any]]:
    """Return every (container, key) of a document, so that a test can put something else there."""
    found = []
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        found.append((value, key))
        if isinstance(inner, dict | list):
            found += slots(inner)
    return found


VALUES = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.integers(-3, 100),
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([0.0, -0.0, 1e-9, 0.5, 1.0, 2.0, 180.0, 1000.0, "", "field", "field3d", "kang2022"]),
    st.text(max_size=3),
    st.lists(st.sampled_from([0, 1, 0.5, "a", True]), max_size=4),
    st.dictionaries(
        st.sampled_from(["required", "timeout_s", "x"]), st.sampled_from([True, 0.1, 1]), max_size=2
    ),
)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(data=st.data())
def test_our_check_and_msgspec_agree_on_what_is_valid(data):
    document = copy.deepcopy(DOCUMENT)
    for _ in range(data.draw(st.integers(1, 2))):
        places = slots(document)
        container, key = places[data.draw(st.integers(0, len(places) - 1))]
        if isinstance(container, dict) and data.draw(st.integers(0, 5)) == 0:
            del container[key]
        else:
            container[key] = data.draw(VALUES)
    try:
        msgspec.convert(document, RobotFile, strict=True)
        valid = True
    except msgspec.ValidationError:
        valid = False
    check = DocumentCheck(Path("arm.toml"))
    if valid:
        check.check(document, inspect.type_info(RobotFile), Place())
    else:
        with pytest.raises(ConfigError) as caught:
            check.check(document, inspect.type_info(RobotFile), Place())
        assert caught.value.allowed


@settings(max_examples=50, deadline=None, derandomize=True)
@given(data=st.data(), bad=st.sampled_from([math.nan, math.inf, -math.inf]))
def test_no_number_that_is_not_finite_gets_in_anywhere(data, bad):
    document = copy.deepcopy(DOCUMENT)
    places = slots(document)
    container, key = places[data.draw(st.integers(0, len(places) - 1))]
    container[key] = bad
    with pytest.raises(ConfigError):
        DocumentCheck(Path("arm.toml")).check(document, inspect.type_info(RobotFile), Place())

"""Every wrong value of a robot file is refused with its file, its key, what was found and what is allowed."""

from __future__ import annotations

import pytest

RADIUS = "radius_m = 0.03"
COUNT = "count = 6"  # of the second ring
LOCKED = "wrist = 0.5"
ORIGIN = "origin_m = [0.0, 0.0, 0.1]"

WRONG_VALUES = [
    # old, new, key, found, words of what is allowed
    (RADIUS, "radius_m = -1", "rings[0].radius_m", -1, ["number", "> 0", "≤ 2 m", "radius of the link"]),
    (RADIUS, "radius_m = 0.0", "rings[0].radius_m", 0.0, ["> 0"]),
    (RADIUS, "radius_m = 2.001", "rings[0].radius_m", 2.001, ["≤ 2 m"]),
    (RADIUS, "radius_m = true", "rings[0].radius_m", True, ["number"]),
    (RADIUS, "radius_m = '3 cm'", "rings[0].radius_m", "3 cm", ["number"]),
    (RADIUS, "radius_m = 2020-01-01", "rings[0].radius_m", None, ["number"]),
    (RADIUS, "radius_m = inf", "rings[0].radius_m", float("inf"), ["finite", "≤ 2 m"]),
    (RADIUS, "radius_m = 1e999", "rings[0].radius_m", float("inf"), ["finite"]),
    (RADIUS, "radius_m = [0.03]", "rings[0].radius_m", [0.03], ["number"]),
    (COUNT, "count = 0", "rings[1].count", 0, ["whole number", "≥ 1", "≤ 64"]),
    (COUNT, "count = 65", "rings[1].count", 65, ["whole number", "≤ 64"]),
    (COUNT, "count = 6.0", "rings[1].count", 6.0, ["whole number"]),
    (COUNT, "count = true", "rings[1].count", True, ["whole number"]),
    (LOCKED, "wrist = 'half'", "joints.locked.wrist", "half", ["number", "rad or m"]),
    (LOCKED, "wrist = true", "joints.locked.wrist", True, ["number"]),
    (LOCKED, "wrist = -inf", "joints.locked.wrist", float("-inf"), ["finite"]),
    (LOCKED, "'odd name' = 'x'", 'joints.locked."odd name"', "x", ["number"]),
    ("forearm = 3", "forearm = 33", "hull_pieces.forearm", 33, ["whole number", "≤ 32"]),
    (ORIGIN, "origin_m = [0.0, 0.1]", "rings[0].origin_m", [0.0, 0.1], ["array of 3 numbers", "m"]),
    (ORIGIN, "origin_m = [0, 0, 0, 0]", "rings[0].origin_m", [0, 0, 0, 0], ["array of 3 numbers"]),
    (ORIGIN, "origin_m = 0.1", "rings[0].origin_m", 0.1, ["array of 3 numbers"]),
    (ORIGIN, "origin_m = [0, 0, '0']", "rings[0].origin_m[2]", "0", ["number"]),
    (ORIGIN, "origin_m = [0, 1e300, 0]", "rings[0].origin_m[1]", 1e300, ["≤ 1000 m"]),
    ("urdf = 'arm.urdf'", "urdf = ''", "urdf", "", ["text", "at least 1 character"]),
    ("urdf = 'arm.urdf'", "urdf = 7", "urdf", 7, ["text", "path of the URDF"]),
    ("default_profile", "links = 'all'\ndefault_profile", "links", "all", ["array of text"]),
    ("default_profile", "links = ['a', 7]\ndefault_profile", "links[1]", 7, ["text"]),
    ("distance_m = 0.2", "distance_m = -0.2", "profiles.near.red.distance_m", -0.2, ["> 0", "≤ 100 m"]),
]


@pytest.mark.parametrize(("old", "new", "key", "found", "words"), WRONG_VALUES)
def test_a_wrong_value_is_shown_with_its_key_and_what_is_allowed(
    old, new, key, found, words, text, changed, refused
):
    error = refused(changed((old.replace("'", '"'), new)))
    assert error.key == key
    if found is not None:
        assert error.found == found
        assert type(error.found) is type(found)
    for word in words:
        assert word in error.allowed


def test_nan_is_not_a_number_here(changed, refused):
    error = refused(changed((RADIUS, "radius_m = nan")))
    assert error.key == "rings[0].radius_m"
    assert "found nan" in str(error)
    assert "finite" in error.allowed


def test_booleans_are_shown_as_toml_writes_them(changed, refused):
    assert "found true," in str(refused(changed((RADIUS, "radius_m = true"))))


def test_a_whole_number_may_stand_for_a_number(changed, load):
    file = load(changed((RADIUS, "radius_m = 1"), (LOCKED, "wrist = -2")))
    assert file.rings[0].radius_m == 1.0
    assert isinstance(file.rings[0].radius_m, float)
    assert isinstance(file.joints.locked["wrist"], float)


@pytest.mark.parametrize("huge", ["9223372036854775808", "-9223372036854775809", "0x" + "f" * 5000])
@pytest.mark.parametrize("old", [RADIUS, COUNT, LOCKED])
def test_an_integer_beyond_64_bits_is_refused_in_a_short_message(huge, old, changed, refused):
    error = refused(changed((old, f"{old.split(' = ')[0]} = {huge}")))
    assert error.key.endswith(old.split(" = ")[0])
    assert "bits" in str(error)
    assert len(str(error)) < 400


@pytest.mark.parametrize(
    ("old", "new", "key", "hint"),
    [
        (RADIUS, "radus_m = 0.03", "rings[0].radus_m", "did you mean 'radius_m'?"),
        ("default_profile", "default_profil", "default_profil", "did you mean 'default_profile'?"),
        ("[joints.locked]", "[joints.lokced]", "joints.lokced", "the keys here are locked, fixed"),
        ("[hull_pieces]", "[limits]\nfast = 1\n[hull_pieces]", "limits.fast", "acceleration_rad_s2"),
        ("red = {", "blue = 1\nred = {", "profiles.near.blue", "red, yellow, separation"),
        ("red = { ", "red = { x = 1, ", "profiles.near.red.x", "distance_m, joint_speed_rad_s"),
    ],
)
def test_an_unknown_key_lists_the_known_ones(old, new, key, hint, changed, refused):
    error = refused(changed((old, new)))
    assert error.key == key
    assert "unknown" in str(error)
    assert hint in error.allowed


@pytest.mark.parametrize(
    ("line", "key", "words"),
    [
        ('urdf = "arm.urdf"\n', "urdf", ["text", "path of the URDF"]),
        ("radius_m = 0.04\n", "rings[1].radius_m", ["number", "≤ 2 m", "radius of the link"]),
        ("distance_m = 0.4, ", "profiles.near.yellow.distance_m", ["number", "≤ 100 m"]),
        ('default_profile = "near"\n', "default_profile", ["text", "--profile"]),
    ],
)
def test_a_missing_key_is_named_with_its_meaning(line, key, words, changed, refused):
    error = refused(changed((line, "")))
    assert error.key == key
    assert "nothing" in str(error.found)
    assert "required" in str(error.found)
    for word in words:
        assert word in error.allowed


def test_a_wrong_word_lists_the_valid_ones(text, refused):
    error = refused(text + '\n[motion]\ncontroller = "feild"\n')
    assert error.key == "motion.controller"
    assert error.found == "feild"
    assert "did you mean 'field'?" in error.allowed
    assert "'field' or 'field3d'" in error.allowed


@pytest.mark.parametrize("value", ["3", "true", '["field"]', "{ a = 1 }"])
def test_a_word_must_be_text(value, text, refused):
    error = refused(text + f"\n[motion]\ncontroller = {value}\n")
    assert error.key == "motion.controller"
    assert "'field' or 'field3d'" in error.allowed


@pytest.mark.parametrize("value", ["0", "1", '"yes"', "1.0"])
def test_a_switch_is_true_or_false(value, text, refused):
    error = refused(text + f"\n[sources]\nranges = {{ required = {value}, timeout_s = 0.4 }}\n")
    assert error.key == "sources.ranges.required"
    assert "true or false" in error.allowed


def test_a_table_where_an_array_of_tables_belongs(text, refused):
    first, second, _ = text.split("[[rings]]")
    error = refused(first + "[rings]" + second + text[text.index("[profiles.near]") :])
    assert error.key == "rings"
    assert "a table with the keys name, parent_frame" in str(error)
    assert "array of tables" in error.allowed


def test_a_value_where_a_table_belongs(text, refused):
    error = refused(
        'joints = "none"\n'
        + text.replace("[joints.locked]", "[hull_pieces]").replace("[hull_pieces]\nforearm = 3", "")
    )
    assert error.key == "joints"
    assert error.found == "none"
    assert "a table" in error.allowed


def test_profiles_may_not_be_empty(text, refused):
    error = refused(text.split("[profiles.near]")[0] + "[profiles]\n")
    assert error.key == "profiles"
    assert "an empty table" in str(error)
    assert "at least 1 entry" in error.allowed


def test_the_first_wrong_place_is_the_one_that_is_named(changed, refused):
    error = refused(
        changed((COUNT, "count = 0"), (RADIUS, "radius_m = 'a'"), ("distance_m = 0.2", "distance_m = 0"))
    )
    assert error.key == "rings[0].radius_m"

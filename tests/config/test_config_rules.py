"""Rules that join several keys of a robot file: the table, the values in question and the rule are named."""

from __future__ import annotations

import msgspec
import pytest

from ssm_service.config import ProfileConfig, RingConfig, RobotFile, SourcesConfig, load_robot_config

RADIUS = "radius_m = 0.04"  # of the second ring
RANGES_OFF = "\n[sources]\nranges = { required = false, timeout_s = 0.4 }\n"
OBSTACLES_ON = "obstacles = { required = true, timeout_s = 0.25 }\n"


def without_rings(text: str) -> str:
    """Return the robot file without its ``[[rings]]``."""
    return text.split("[[rings]]")[0] + text[text.index("[profiles.near]") :]


@pytest.mark.parametrize(
    ("added", "words"),
    [
        ("range_min_m = 2.0", ["range_min_m = 2.0", "range_max_m = 2.0"]),
        ("range_min_m = 3.0", ["range_min_m = 3.0", "must be below"]),
        ("axis = [0, 0, 0]", ["axis = [0, 0, 0]", "must not be zero"]),
        ("first_direction = [0.0, 0.0, 0.0]", ["first_direction = [0.0, 0.0, 0.0]", "must not be zero"]),
        (
            "first_direction = [0, 0, 1]",
            ["first_direction = [0, 0, 1]", "axis = [0.0, 0.0, 1.0]", "perpendicular"],
        ),
        ("axis = [1, 0, 1]", ["axis = [1, 0, 1]", "first_direction = [1.0, 0.0, 0.0]", "perpendicular"]),
    ],
)
def test_rules_of_a_ring(added, words, changed, refused):
    error = refused(changed((RADIUS, f"{RADIUS}\n{added}")))
    assert error.key == "rings[1]"
    for word in words:
        assert word in str(error)


def test_axis_and_first_direction_need_not_be_of_unit_length(changed, load):
    ring = load(changed((RADIUS, f"{RADIUS}\naxis = [0, 5, 0]\nfirst_direction = [0, 0, -0.1]"))).rings[1]
    assert ring.axis == (0.0, 5.0, 0.0)
    assert ring.first_direction == (0.0, 0.0, -0.1)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("distance_m = 0.2", "distance_m = 0.5", "distance_m"),
        ("distance_m = 0.2", "distance_m = 0.4", "distance_m"),
        ("joint_speed_rad_s = 0.2", "joint_speed_rad_s = 0.41", "joint_speed_rad_s"),
        ("speed_scaling = 0.25", "speed_scaling = 0.51", "speed_scaling"),
    ],
)
def test_nearer_is_never_faster(old, new, key, changed, refused):
    error = refused(changed((old, new)))
    assert error.key == "profiles.near"
    assert f"red.{key} = {new.split(' = ')[1]}" in str(error)
    assert f"yellow.{key} = " in str(error)


def test_equal_speeds_in_both_zones_are_allowed(changed, load):
    file = load(changed(("joint_speed_rad_s = 0.2", "joint_speed_rad_s = 0.4")))
    profile = file.profiles["near"]
    assert profile.red.joint_speed_rad_s == profile.yellow.joint_speed_rad_s


def test_the_default_profile_must_exist(changed, refused):
    error = refused(changed(('default_profile = "near"', 'default_profile = "far"')))
    assert "default_profile = 'far'" in str(error)
    assert "near" in error.allowed


def test_a_joint_is_locked_or_fixed_but_not_both(text, refused):
    error = refused(text + "\n[joints.fixed]\nwrist = 0\n")
    assert "both name wrist" in error.allowed


def test_ring_names_differ(changed, refused):
    assert "different names" in refused(changed(('"fore"', '"upper"'))).allowed


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("joints = { required = false, timeout_s = 0.1 }", "joints.required = false"),
        ("target = { required = true, timeout_s = 0.1 }", "target.required = true"),
    ],
)
def test_rules_of_the_sources(line, words, text, refused):
    error = refused(f"{text}\n[sources]\n{line}\n")
    assert error.key == "sources"
    assert words in str(error)


def test_some_distance_source_is_required(text, refused):
    error = refused(text + RANGES_OFF)
    assert "sources.ranges.required = false, sources.obstacles.required = false" in str(error)


def test_without_rings_no_ranges_can_be_required(text, refused, load):
    error = refused(without_rings(text))
    assert "sources.ranges.required = true, rings = []" in str(error)
    assert load(without_rings(text) + RANGES_OFF + OBSTACLES_ON).rings == []


def test_the_3d_field_needs_rings(text, refused):
    bare = without_rings(text) + RANGES_OFF + OBSTACLES_ON
    error = refused(bare + '\n[motion]\ncontroller = "field3d"\n')
    assert "motion.controller = 'field3d', rings = []" in str(error)


def test_rules_hold_for_values_built_in_python_too():
    file = load_robot_config("ur3").file
    ring, profile = msgspec.structs.asdict(file.rings[0]), file.profiles["kang2022"]
    ring["range_min_m"] = ring["range_max_m"]
    with pytest.raises(ValueError, match="range_min_m"):
        RingConfig(**ring)
    with pytest.raises(ValueError, match=r"red\.distance_m"):
        ProfileConfig(red=profile.yellow, yellow=profile.red)
    with pytest.raises(ValueError, match=r"joints\.required"):
        SourcesConfig(joints=file.sources.target)


def test_values_are_frozen():
    file = load_robot_config("ur3").file
    assert isinstance(file, RobotFile)
    for part, key in ((file, "urdf"), (file.rings[0], "count"), (file.limits, "position_margin_rad")):
        with pytest.raises(AttributeError):
            setattr(part, key, getattr(part, key))


ASSUMED = "\n[assumptions]\nreading_error_m = 0.02\n"


@pytest.mark.parametrize(
    ("added", "words"),
    [
        ("radius_min_m = 0.2", ["radius_min_m = 0.2", "radius_max_m = 0.15", "must not be above"]),
        ("assumed_radius_m = 0.01", ["assumed_radius_m = 0.01", "radius_min_m = 0.05", "between"]),
        ("assumed_radius_m = 0.16", ["assumed_radius_m = 0.16", "radius_max_m = 0.15", "between"]),
    ],
)
def test_rules_of_the_assumptions(added, words, changed, refused):
    error = refused(changed(("\n[profiles.near]", f"{ASSUMED}{added}\n[profiles.near]")))
    assert error.key == "assumptions"
    for word in words:
        assert word in str(error)


def test_the_lower_bound_needs_assumptions_and_assumptions_need_rings(changed, refused, load):
    bound = ("[profiles.near]", '[profiles.near]\nrange_estimator = "lower_bound"')
    assert "needs `assumptions`" in str(refused(changed(bound)))
    assumed = ("[profiles.near]", f"{ASSUMED}\n[profiles.near]")
    both = changed((assumed[0], f'{ASSUMED}\n[profiles.near]\nrange_estimator = "lower_bound"'))
    assert load(both).profiles["near"].range_estimator == "lower_bound"
    text = without_rings(changed((RADIUS, f"{RADIUS}\n{RANGES_OFF}{OBSTACLES_ON}{ASSUMED}")))
    assert "[assumptions]" not in text
    error = refused(f"{text}{RANGES_OFF}{OBSTACLES_ON}{ASSUMED}")
    assert "the file has none" in str(error)


EQUATION = "intrusion_m = 0.0\nhuman_uncertainty_m = 0.05\nrobot_uncertainty_m = 0.0\n"
RED = "red = { distance_m = 0.2, joint_speed_rad_s = 0.2, speed_scaling = 0.25 }\n"
YELLOW = "yellow = { distance_m = 0.4, joint_speed_rad_s = 0.4, speed_scaling = 0.5 }\n"


def test_red_and_yellow_come_together_or_not_at_all(changed, refused, load):
    for one in (RED, YELLOW):
        error = refused(changed((one, "")))
        assert error.key == "profiles.near"
        assert "together or not at all" in str(error)
    error = refused(changed((RED + YELLOW, "")))
    assert "or `separation`" in str(error)
    equation = changed((RED + YELLOW, f"[profiles.near.separation]\n{EQUATION}"))
    profile = load(equation).profiles["near"]
    assert (profile.red, profile.yellow, profile.edges) == (None, None, ())
    assert load(changed()).profiles["near"].edges == (0.2, 0.4)


def test_the_floor_of_a_persons_speed_is_not_above_the_speed(changed, refused):
    added = f"[profiles.near.separation]\n{EQUATION}human_speed_m_s = 0.2\n"
    error = refused(changed((YELLOW, f"{YELLOW}{added}")))
    assert error.key == "profiles.near.separation"
    assert "human_speed_floor_m_s" in str(error)


@pytest.mark.parametrize("speed", ["0", "0.0", "-1", "11", "nan", "inf"])
def test_a_person_who_does_not_move_is_refused(speed, changed, refused):
    added = f"[profiles.near.separation]\n{EQUATION}human_speed_m_s = {speed}\n"
    assert refused(changed((YELLOW, f"{YELLOW}{added}"))).key == "profiles.near.separation.human_speed_m_s"


TWICE = "{ speed_rad_s = 2.0, time_s = 0.1, distance_rad = 0.1 }"
ONCE = "{ speed_rad_s = 1.0, time_s = 0.1, distance_rad = 0.05 }"


@pytest.mark.parametrize(
    ("slower", "words"),
    [
        ("{ speed_rad_s = 3.0, time_s = 0.1, distance_rad = 0.1 }", "rising order"),
        ("{ speed_rad_s = 1.0, time_s = 0.3, distance_rad = 0.1 }", "time_s"),
        ("{ speed_rad_s = 1.0, time_s = 0.1, distance_rad = 0.3 }", "distance_rad"),
        (
            f"{TWICE}, {ONCE}",
            "rising order",
        ),
    ],
)
def test_rules_of_the_stopping_data(slower, words, text, refused, load):
    table = "speed_rad_s = 3.0, time_s = 0.2, distance_rad = 0.4"
    error = refused(f"{text}\n[stopping]\nelbow = {{ {table}, slower = [{slower}] }}\n")
    assert error.key == "stopping.elbow"
    assert words in str(error)
    good = "{ speed_rad_s = 1.0, time_s = 0.1, distance_rad = 0.1 }"
    file = load(f"{text}\n[stopping]\nelbow = {{ {table}, slower = [{good}] }}\n")
    assert file.stopping["elbow"].slower[0].time_s == 0.1

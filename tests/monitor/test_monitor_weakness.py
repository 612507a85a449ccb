"""What is said to be weak: recomputed by hand from the numbers of the files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from ssm_service.errors import ConfigError
from ssm_service.model import Robot
from ssm_service.monitor import weaknesses
from ssm_service.monitor.reach import greatest_speed, lever_arms
from ssm_service.monitor.weakness import best_law, stopping

UR3 = Path(__file__).resolve().parents[2] / "robots" / "ur3.toml"
V_H = 1.6
REACTION = "robot_s = 0.1\ntransport_s = 0.02"
OBSTACLES = "obstacles = { required = false, timeout_s = 0.25 }"

ISO = """
[profiles.iso.separation]
human_speed_m_s = 1.6
intrusion_m = 0.1
human_uncertainty_m = 0.05
robot_uncertainty_m = 0.01
"""

ARM = """<robot name="arm"><link name="base"/>
<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/>
  <origin xyz="0 0 0.5"/><axis xyz="1 0 0"/><limit lower="-1" upper="2" effort="1" velocity="3"/></joint>
<link name="cart"/>
<joint name="swing" type="revolute"><parent link="cart"/><child link="arm"/>
  <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="2"/></joint>
<link name="arm"/>
<joint name="held" type="revolute"><parent link="arm"/><child link="hand"/>
  <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="5"/></joint>
<link name="hand"><collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.05"/></geometry></collision>
</link>
<joint name="out" type="prismatic"><parent link="hand"/><child link="tool"/>
  <origin xyz="0.2 0 0"/><axis xyz="1 0 0"/><limit lower="0" upper="0.25" effort="1" velocity="1"/></joint>
<link name="tool"><collision><geometry><sphere radius="0.01"/></geometry></collision></link></robot>
"""

ARM_FILE = """
urdf = "arm.urdf"
end_effector_frame = "tool"
default_profile = "steps"
[joints.locked]
held = 1.5707963267948966
[reaction]
robot_s = 0.05
transport_s = 0.01
[sources]
ranges = { required = false, timeout_s = 0.4 }
obstacles = { required = true, timeout_s = 0.25, period_s = 0.03 }
[profiles.steps]
red = { distance_m = 5.0, joint_speed_rad_s = 0.5, speed_scaling = 0.25 }
yellow = { distance_m = 90.0, joint_speed_rad_s = 1.5, speed_scaling = 0.5 }
"""


def base() -> str:
    """Return the UR3's file with reaction times of this test, and only the paper's profile."""
    text = UR3.read_text(encoding="utf-8").partition("# S_p of")[0]
    text, count = re.subn(r"robot_s = [\d.]+\ntransport_s = [\d.]+", REACTION, text)
    assert count == 1
    text, count = re.subn(r"obstacles = .*", OBSTACLES, text)
    assert count == 2  # of the assumptions, and of the sources
    return text.replace(OBSTACLES, 'obstacles = "one"', 1)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return changed(tmp_path_factory.mktemp("ur3"))


def changed(folder: Path, *changes: tuple[str, str], more: str = "") -> Robot:
    text = base()
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    file = folder / "arm.toml"
    file.write_text(text + more, encoding="utf-8")
    return Robot.load(file)


@pytest.fixture
def sliding(tmp_path: Path) -> Robot:
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "arm.toml").write_text(ARM_FILE)
    return Robot.load(tmp_path / "arm.toml")


def said(robot: Robot, profile: str = "kang2022") -> dict[str, str]:
    found = weaknesses(robot, profile)
    assert len({weakness.key for weakness in found}) == len(found)
    assert [str(weakness) for weakness in found] == [f"{weakness.key}: {weakness.text}" for weakness in found]
    return dict(found)


def numbers(pattern: str, text: str) -> list[float]:
    found = re.search(pattern, text)
    assert found is not None, (pattern, text)
    return [float(word) for word in found.groups()]


ZONE = r"at ([\d.]+) rad/s from ([\d.]+) m on,.*than ([\d.]+) m/s;.*demands ([\d.]+) m .*to ([\d.]+) m then"


@pytest.mark.parametrize(
    ("key", "speed", "distance"),
    [
        ("profiles.kang2022.red", 0.18, 0.0),
        ("profiles.kang2022.yellow", 0.24, 0.1775),
        ("profiles.kang2022", 3.15, 0.355),
    ],
)
def test_the_papers_zones_are_held_against_the_equation(robot, key, speed, distance):
    text = said(robot)[key]
    T_r, T_s, stopping_gain, Z_d = 0.16 + 0.002 + 0.02 + 0.1, 0.159, 0.20 / 3.194, 0.06
    fastest = lever_arms(robot)[:3] @ np.minimum([2.16, 2.16, 3.15], speed)
    standing = V_H * (T_r + T_s) + Z_d
    moving = standing + fastest * (T_r + stopping_gain)
    assert numbers(ZONE, text) == [
        speed,
        distance,
        pytest.approx(fastest, abs=0.006),
        pytest.approx(standing, abs=6e-4),
        pytest.approx(moving, abs=6e-4),
    ]
    assert "v_h = 1.6 m/s, T_r = 0.282 s, T_s = 0.159 s, Z_d = 0.06 m" in text


def test_no_point_of_the_arm_is_faster_than_the_lever_arms_say(robot):
    rng = np.random.default_rng(5)
    fastest = 0.0
    for _ in range(300):
        position = rng.uniform(-np.pi, np.pi, 6)
        position[3:] = 0.0
        velocity = np.zeros(6)
        velocity[:3] = rng.choice([-1.0, 1.0], 3)
        transforms = robot.link_transforms(position)
        for link in robot.monitored_links[1:]:
            index = robot.geometry_of_link[link][0]
            item = robot.collision.geometryObjects[index]
            corner = transforms[link] @ np.append(item.geometry.aabb_center, 1.0)
            speed = np.linalg.norm(robot.point_velocity(position, velocity, link, corner[:3]))
            fastest = max(fastest, speed)
    assert 0.5 * greatest_speed(robot, 1.0) < fastest <= greatest_speed(robot, 1.0)


def test_sliding_and_locked_joints_have_their_own_arms(sliding):
    # From the swing: 0.4 to the locked joint, beyond it 0.2 in a straight line down, where `out` slides.
    swing = 0.01 + 0.25 + np.hypot(0.4, 0.2)
    np.testing.assert_allclose(lever_arms(sliding), [1.0, swing, 0.0, 1.0], atol=1e-9)
    assert greatest_speed(sliding, np.inf) == pytest.approx(3.0 + 2.0 * swing + 1.0)


def test_without_stopping_data_the_least_is_said_and_what_is_missing(sliding):
    found = said(sliding, "steps")
    assert set(found) == {"profiles.steps.red"}  # the other zones begin farther away than anything demands
    _, _, _, standing, moving = numbers(ZONE, found["profiles.steps.red"])
    T_r = 0.03 + 0.002 + 0.01 + 0.05
    fastest = 0.5 + 0.5 * lever_arms(sliding)[1] + 0.5
    assert standing == pytest.approx(V_H * T_r, abs=6e-4)
    assert moving == pytest.approx(V_H * T_r + fastest * T_r, abs=6e-4)
    assert found["profiles.steps.red"].endswith("stopping data that are not there: slide, swing, out")


def test_slower_joints_stop_by_the_next_listed_speed(tmp_path):
    slower = "slower = [{ speed_rad_s = 0.2, time_s = 0.02, distance_rad = 0.002 }, "
    slower += "{ speed_rad_s = 1.0, time_s = 0.05, distance_rad = 0.02 }], "
    robot = changed(
        tmp_path,
        ("shoulder_pan_joint = { speed", f"shoulder_pan_joint = {{ {slower}speed"),
        ("shoulder_lift_joint = { speed", f"shoulder_lift_joint = {{ {slower}speed"),
        ("elbow_joint = { speed", f"elbow_joint = {{ {slower}speed"),
    )
    found = said(robot)
    for key, speed, T_s, stopping_gain in (
        ("profiles.kang2022.red", 0.18, 0.02, 0.01),
        ("profiles.kang2022.yellow", 0.24, 0.05, 0.02),
    ):
        standing = V_H * (0.282 + T_s) + 0.06
        moving = standing + speed * lever_arms(robot).sum() * (0.282 + stopping_gain)
        assert numbers(ZONE, found[key])[3:] == pytest.approx([standing, moving], abs=6e-4)


def test_of_two_required_sources_the_better_counts(tmp_path):
    robot = changed(tmp_path, (OBSTACLES, OBSTACLES.replace("false", "true")))
    assert "T_r = 0.122 s, T_s = 0.159 s)" in said(robot)["profiles.kang2022.red"]


def test_silence_is_held_against_the_range(robot, tmp_path):
    text = said(robot)["rings[0]"]
    spare = 1.2 - V_H * (0.282 + 0.159) - 0.06
    justified, fastest = numbers(r"speed of ([\d.]+) m/s at most.* below ([\d.]+) m/s only", text)
    assert justified == pytest.approx(spare / (0.282 + 0.20 / 3.194), abs=0.006)
    assert fastest == pytest.approx(greatest_speed(robot, 3.15), abs=0.006)
    assert "see 160° of 360°, and in the 200° between them silence promises nothing" in text
    far = changed(tmp_path, ("range_max_m = 1.2", "range_max_m = 5.0"))
    assert said(far)["rings[0]"].startswith("forearm_link: its cones see 160°")
    whole = changed(
        tmp_path,
        ("range_max_m = 1.2", "range_max_m = 5.0"),
        ("field_of_view_deg = 20.0", "field_of_view_deg = 45.0"),
    )
    assert "rings[0]" not in said(whole)


def test_nothing_is_said_of_blind_spots_that_the_zone_itself_answers_for(tmp_path):
    robot = changed(tmp_path, ('uncovered = "off"', 'uncovered = "yellow"'))
    assert "silence promises" not in said(robot)["rings[0]"]
    bare = base().partition("# The paper's scene")[2].partition("# Category 0")[0]
    robot = changed(tmp_path, ('uncovered = "off"', 'uncovered = "yellow"'), (bare, "\n"))
    assert "silence promises" in said(robot)["rings[0]"]


def test_sources_that_nobody_requires_or_checks_are_named(robot, tmp_path):
    assert "nobody misses it" in said(robot)["sources.obstacles.required"]
    assert not any(key.endswith("integrity") for key in said(robot))
    robot = changed(
        tmp_path,
        ("ranges = { required = true,", 'ranges = { integrity = "none", required = false,'),
        ("obstacles = { required = false,", "obstacles = { required = true,"),
        ("target = { required = false,", 'target = { integrity = "none", required = false,'),
    )
    found = said(robot)
    assert "zones come from obstacles alone" in found["sources.ranges.required"]
    assert {key for key in found if key.endswith("integrity")} == {
        "sources.ranges.integrity",
        "sources.target.integrity",
    }


def test_the_equation_itself_may_be_told_too_little(tmp_path):
    assert not any(key.startswith("profiles") for key in said(changed(tmp_path, more=ISO), "iso"))
    slow = ISO.replace("1.6", "1.0") + "tracked_velocity = true\nhuman_speed_floor_m_s = 0.3\n"
    found = said(changed(tmp_path, more=slow), "iso")
    assert "1 m/s: people walk at 1.6 m/s" in found["profiles.iso.separation.human_speed_m_s"]
    assert "coming at 0.3 m/s" in found["profiles.iso.separation.tracked_velocity"]


@pytest.mark.parametrize("key", ["human_speed_m_s", "human_speed_floor_m_s"])
def test_people_who_never_come_near_are_refused(tmp_path, key):
    text = ISO.replace("human_speed_m_s = 1.6", f"{key} = 0.0")
    with pytest.raises(ConfigError) as caught:
        changed(tmp_path, more=text)
    assert caught.value.key == f"profiles.iso.separation.{key}"


def test_what_a_profile_by_distance_and_equation_says_is_about_the_equation(tmp_path):
    both = ISO + "[profiles.iso.red]\ndistance_m = 0.1\njoint_speed_rad_s = 3.0\nspeed_scaling = 0.5\n"
    both += "[profiles.iso.yellow]\ndistance_m = 0.2\njoint_speed_rad_s = 3.1\nspeed_scaling = 0.6\n"
    assert not any(key.startswith("profiles") for key in said(changed(tmp_path, more=both), "iso"))


def test_a_zone_that_is_strong_enough_does_not_hide_the_next(tmp_path):
    robot = changed(
        tmp_path,
        ("red = { distance_m = 0.1775", "red = { distance_m = 0.9"),
        ("yellow = { distance_m = 0.355", "yellow = { distance_m = 1.0"),
    )
    found = {key for key in said(robot) if key.startswith("profiles")}
    assert found == {"profiles.kang2022.red", "profiles.kang2022"}


def test_what_is_known_of_all_joints_ends_with_the_terms(robot):
    for key, text in said(robot).items():
        if key.startswith("profiles"):
            assert re.search(
                r" then \(v_h = 1\.6 m/s, T_r = 0\.282 s, T_s = 0\.\d+ s, Z_d = 0\.06 m\)$", text
            )


def test_a_joints_own_limit_and_its_fastest_data_both_count(tmp_path):
    """The slower data of a joint that is limited to them; the fastest of one that may be faster."""
    joints = "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"
    slower = "slower = [{ speed_rad_s = 0.5, time_s = 0.04, distance_rad = 0.01 }], "
    changes = [
        (f"{joint} = {{ speed_rad_s = 3.194", f"{joint} = {{ {slower}speed_rad_s = {speed}")
        for joint, speed in zip(joints, (2.0, 3.194, 3.194), strict=True)
    ]
    time, gain, unknown = stopping(changed(tmp_path, *changes), np.inf)
    assert (time, gain, unknown) == (0.159, pytest.approx(0.09), [])
    limits = ", ".join(f"{joint} = 0.5" for joint in joints)
    limited = ("[limits]\n", f"[limits]\nvelocity_rad_s = {{ {limits} }}\n")
    time, gain, unknown = stopping(changed(tmp_path, *changes, limited), np.inf)
    assert (time, gain, unknown) == (0.04, pytest.approx(0.02), [])


def test_of_several_rings_the_slowest_and_of_the_sources_the_best_at_rest(tmp_path):
    ring = base().partition("[[rings]]")[2].partition("# The paper's scene")[0]
    second = "[[rings]]" + ring.replace("period_s = 0.16", "period_s = 0.2").replace('"forearm"', '"second"')
    slower = changed(tmp_path, more=second)
    assert best_law(slower, 0.5, 0.002).reaction_time == pytest.approx(0.2 + 0.002 + 0.12)
    # At rest the tracker demands less, at 1 m/s the ring would.
    tracked = "obstacles = { required = true, timeout_s = 0.25, period_s = 0.19 }"
    robot = changed(tmp_path, (OBSTACLES, tracked))
    law = best_law(robot, 0.5, 0.002)
    assert law.reaction_time == pytest.approx(0.19 + 0.122)
    assert law.human_uncertainty == 0.0
    ring_at = [1.6 * (0.282 + 0.159) + 0.06 + speed * (0.282 + 0.0626) for speed in (0.0, 1.0)]
    ours_at = [law.terms(speed).S_p for speed in (0.0, 1.0)]
    assert ours_at[0] < ring_at[0]
    assert ours_at[1] > ring_at[1]


def test_silence_of_cones_that_nearly_meet_is_said_beside_the_speed(tmp_path):
    robot = changed(tmp_path, ("field_of_view_deg = 20.0", "field_of_view_deg = 44.95"))
    text = said(robot)["rings[0]"]
    first, second = text.split("; its cones")
    assert first.endswith("m/s only")
    assert second == (
        " see 359.6° of 360°, and in the 0.4° between them silence promises nothing and counts as free: "
        "`ssm coverage`"
    )


def test_every_source_without_a_checksum_is_named_in_full(tmp_path):
    none = 'integrity = "none", '
    robot = changed(
        tmp_path,
        ("joints = { required", f"joints = {{ {none}required"),
        ("ranges = { required = true", f"ranges = {{ {none}required = false"),
        (OBSTACLES, OBSTACLES.replace("{ required = false", f"{{ {none}required = true")),
        ("target = { required", f"target = {{ {none}required"),
    )
    found = said(robot)
    text = "none: messages without a checksum are taken, and nobody notices one that was altered"
    unchecked = {key: value for key, value in found.items() if key.endswith("integrity")}
    assert unchecked == {
        f"sources.{name}.integrity": text for name in ("joints", "ranges", "obstacles", "target")
    }


def test_nothing_is_said_of_rings_that_are_not_there(sliding, tmp_path):
    unchecked = ARM_FILE.replace("ranges = { ", 'ranges = { integrity = "none", ')
    (tmp_path / "arm.toml").write_text(
        unchecked.replace("obstacles = { ", 'obstacles = { integrity = "none", ')
    )
    found = said(Robot.load(tmp_path / "arm.toml"), "steps")
    assert {key for key in found if key.startswith("sources")} == {"sources.obstacles.integrity"}


@pytest.mark.parametrize(("here", "other"), [("ranges", "obstacles"), ("obstacles", "ranges")])
def test_a_source_that_is_not_required_is_named_with_the_other(tmp_path, here, other):
    required = {name: str(name != here).lower() for name in ("ranges", "obstacles")}
    robot = changed(
        tmp_path,
        ("ranges = { required = true", f"ranges = {{ required = {required['ranges']}"),
        (OBSTACLES, OBSTACLES.replace("false", required["obstacles"])),
    )
    text = f"false: until its first message nobody misses it, and zones come from {other} alone"
    assert said(robot)[f"sources.{here}.required"] == text
    assert f"sources.{other}.required" not in said(robot)

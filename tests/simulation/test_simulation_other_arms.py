"""The scenarios with arms that they were not written for: the README's own arm, the UR5 and the UR10."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulation_witness import order, watch

from ssm_service.errors import ConfigError
from ssm_service.model import Robot
from ssm_service.safety import Zone
from ssm_service.simulation import MemoryRun, World, list_scenarios, load_scenario
from ssm_service.simulation.sway import AMPLITUDE_M, AMPLITUDE_RAD, GAIN, PERIOD_S, sway_for

AXES = """\
<robot name="axes">
  <link name="base"/>
  {joints}
  <link name="tool"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
</robot>
"""

JOINT = """\
<joint name="{name}" type="{type}">
  <parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/><origin xyz="0 0 0.3"/>
  <limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="1"/>
</joint>
"""

FILE = """\
urdf = "axes.urdf"
end_effector_frame = "tool"
default_profile = "a"
[sources]
ranges = { required = false, timeout_s = 0.4 }
obstacles = { required = true, timeout_s = 0.25 }
[profiles.a]
red = { distance_m = 0.2, joint_speed_rad_s = 0.1, speed_scaling = 0.1 }
yellow = { distance_m = 0.4, joint_speed_rad_s = 0.3, speed_scaling = 0.4 }
"""


def arm(folder: Path, *joints: tuple[str, float, float, float]) -> Robot:
    """Return an arm of joints (type, lower, upper, velocity) named axis1, axis2, …, one upon the other."""
    links = ["base", *(f"link{i}" for i in range(1, len(joints))), "tool"]
    text = "".join(f'<link name="{name}"/>' for name in links[1:-1])
    for i, (kind, lower, upper, velocity) in enumerate(joints):
        text += JOINT.format(
            name=f"axis{i + 1}",
            type=kind,
            parent=links[i],
            child=links[i + 1],
            lower=lower,
            upper=upper,
            velocity=velocity,
        )
    (folder / "axes.urdf").write_text(AXES.format(joints=text))
    (folder / "axes.toml").write_text(FILE)
    return Robot.load(folder / "axes.toml")


@pytest.mark.parametrize("name", list_scenarios())
def test_the_arm_of_the_readme_can_have_every_scenario(my_arm: Robot, ur3: Robot, name: str) -> None:
    scenario, original = load_scenario(name, my_arm), load_scenario(name, ur3)
    assert scenario.remark == (
        f"scenario '{name}' is written for the joints shoulder_pan_joint, shoulder_lift_joint, elbow_joint; "
        "my_arm starts at rest and sways its first free joint, panda_joint1"
    )
    assert original.remark == ""
    assert original.sway is None
    np.testing.assert_array_equal(scenario.start, my_arm.rest_position)
    assert scenario.obstacles_at(3.3) == original.obstacles_at(3.3)
    for time_s in np.arange(0.0, 30.0, 0.7):
        target = scenario.target_at(float(time_s))
        assert target is not None
        assert target.kind == "joint_velocity"
        assert not target.value[1:].any()


def test_empty_with_the_arm_of_the_readme(my_arm: Robot) -> None:
    seen = watch(my_arm, "empty", seconds=13.0)
    assert order(seen.zones) == [Zone.GREEN]
    assert seen.scans == 0
    assert seen.moved == pytest.approx(4 * AMPLITUDE_RAD * 13.0 / PERIOD_S, rel=0.15)


def test_crossing_with_the_arm_of_the_readme(my_arm: Robot) -> None:
    seen = watch(my_arm, "crossing", seconds=13.0)
    assert {Zone.YELLOW, Zone.RED} <= set(order(seen.zones))
    assert seen.nearest < 0.3
    assert seen.scans == 0
    assert seen.moved > 0.8


@pytest.mark.parametrize("robot", ["ur5", "ur10"])
def test_every_scenario_with_the_larger_arms_of_the_same_joints(robot: str) -> None:
    loaded = Robot.load(robot)
    for name in list_scenarios():
        assert load_scenario(name, loaded).remark == ""
        seen = watch(loaded, name, seconds=8.0)
        assert Zone.GREEN in seen.zones
        assert (set(seen.zones[200:]) > {Zone.GREEN}) == (name != "empty")
        assert seen.moved > 1.0
        assert seen.scans == 50


def test_without_rings_there_are_no_readings(my_arm: Robot) -> None:
    world = World(my_arm, load_scenario("crossing", my_arm))
    zeros = np.zeros(7)
    for _ in range(600):
        emitted = world.emit()
        assert emitted.ranges is None
        world.step(zeros, 0.002)


def test_the_same_run_twice(my_arm: Robot) -> None:
    def record() -> list[bytes]:
        run = MemoryRun(my_arm, load_scenario("crossing", my_arm), seed=3)
        return [run.tick().decision.velocity.tobytes() for _ in range(700)]

    assert record() == record()


@pytest.mark.parametrize(
    ("start", "key", "hint"),
    [
        ("panda_joint1 = 0.0\nelbow_joint = 1.0", "start.elbow_joint", ""),
        ("panda_joint1 = 0.0\npanda_finger_joint1 = 0.0", "start.panda_finger_joint1", ""),
        ("shoulder_pan_joint = 0.0\nshoulder_lift_joint = 0.0\npanda_joint7 = 0.0", "start.shoulder", ""),
        ("panda_joint1 = 0.0\npanda_jiont2 = 0.0", "start.panda_jiont2", "did you mean 'panda_joint2'? "),
    ],
)
def test_a_start_for_two_arms_is_refused(
    my_arm: Robot, tmp_path: Path, start: str, key: str, hint: str
) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(f'description = "x"\nduration_s = 1.0\n[start]\n{start}\n')
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, my_arm)
    assert caught.value.key.startswith(key)
    assert caught.value.allowed.startswith(hint + "joints of my_arm alone")
    assert ("did you mean" in str(caught.value)) == bool(hint)
    assert "panda_joint1, panda_joint2" in caught.value.allowed


def test_without_targets_it_stays_at_rest(my_arm: Robot, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text('description = "x"\nduration_s = 1.0\nstart = { elbow_joint = 1.0 }\n')
    scenario = load_scenario(path, my_arm)
    assert scenario.target_at(0.5) is None
    assert scenario.remark.endswith("elbow_joint; my_arm starts at rest and stays there")


@pytest.mark.parametrize("lower", [-0.35, 0.0, 1.5, -9.0])
@pytest.mark.parametrize("held", [False, True])
def test_a_sway_keeps_well_within_the_limits(tmp_path: Path, lower: float, held: bool) -> None:
    robot = arm(tmp_path, ("revolute", lower, lower + 0.9, 2.0))
    scenario = load_scenario("empty", robot)
    sway = scenario.sway
    assert sway is not None
    world = World(robot, scenario)
    command, places, speeds = np.zeros(1), [], []
    generator = np.random.default_rng(7)
    for _ in range(4500):
        target = world.emit().target
        if target is not None:  # a service that slows the arm, or stops it, as it likes
            command = target.value * (generator.uniform(0.0, 1.0) ** 3 if held else 1.0)
        world.step(command, 0.01)
        places.append(float(world.plant.position[0]))
        speeds.append(abs(float(world.plant.velocity[0])))
    assert world.plant.limit_hits == 0
    assert max(speeds) <= sway.speed <= 1.0
    settled = np.array(places[1500:])
    assert settled.min() > robot.position_lower[0] + 0.1
    assert settled.max() < robot.position_upper[0] - 0.1
    assert np.abs(settled - sway.centre).max() <= sway.amplitude + 0.005
    if not held:
        follows = GAIN / np.hypot(GAIN, 2.0 * np.pi / PERIOD_S)
        assert np.ptp(settled) == pytest.approx(2 * sway.amplitude * follows, rel=0.03)


def test_a_sway_fits_the_joint(tmp_path: Path) -> None:
    slide = sway_for(arm(tmp_path, ("prismatic", -0.5, 0.5, 0.3), ("revolute", -1.0, 1.0, 1.0)))
    assert slide is not None
    assert (slide.joint, slide.centre, slide.amplitude) == ("axis1", 0.0, AMPLITUDE_M)
    slow = sway_for(arm(tmp_path, ("continuous", 0.0, 0.0, 0.02)))
    assert slow is not None
    assert slow.speed == pytest.approx(0.01)
    stiff = arm(tmp_path, ("revolute", 0.1, 0.13, 1.0), ("revolute", -1.0, 1.0, 1.0))
    other = load_scenario("empty", stiff)
    assert other.remark.endswith("axes starts at rest and sways axis2, its first free joint with room for it")
    assert sway_for(arm(tmp_path, ("revolute", 0.1, 0.13, 1.0))) is None
    assert load_scenario("empty", arm(tmp_path, ("revolute", 0.1, 0.13, 1.0))).target_at(1.0) is None

"""A joint that slides between two others lengthens the chain by all of its travel, wherever that begins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssm_service.model import Robot
from ssm_service.monitor.reach import lever_arms

URDF = """<robot name="arm"><link name="base"/>
<joint name="swing" type="revolute"><parent link="base"/><child link="arm"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="2"/></joint>
<link name="arm"/>
<joint name="out" type="prismatic"><parent link="arm"/><child link="tool"/>
  <origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>
  <limit lower="-0.125" upper="0.25" effort="1" velocity="1"/></joint>
<link name="tool">
  <collision><origin xyz="0.25 0 0"/><geometry><sphere radius="0.0625"/></geometry></collision>
</link></robot>
"""
FILE = """
urdf = "arm.urdf"
end_effector_frame = "tool"
default_profile = "steps"
[sources]
ranges = { required = false, timeout_s = 0.4 }
obstacles = { required = true, timeout_s = 0.25 }
[profiles.steps]
red = { distance_m = 0.1, joint_speed_rad_s = 0.1, speed_scaling = 0.1 }
yellow = { distance_m = 0.2, joint_speed_rad_s = 0.2, speed_scaling = 0.2 }
"""


def test_a_slide_between_two_joints_counts_with_its_whole_travel(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF, encoding="utf-8")
    (tmp_path / "arm.toml").write_text(FILE, encoding="utf-8")
    arms = lever_arms(Robot.load(tmp_path / "arm.toml"))
    np.testing.assert_allclose(arms, [0.5 + 0.25 + 0.0625 + 0.375, 1.0], atol=1e-9)
    # No position of the slide puts any point farther from the swing's axis.
    farthest = max(0.5 + place + 0.25 + 0.0625 for place in (-0.125, 0.25))
    assert arms[0] >= farthest
    assert arms[0] == pytest.approx(farthest + 0.125)

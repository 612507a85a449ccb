"""What the equation demands at rest of an arm without rings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ssm_service.model import Robot
from ssm_service.monitor.reaction import standstill_distance
from ssm_service.safety import ZoneProfile


def test_without_rings_the_trackers_uncertainty_counts(robot: Robot) -> None:
    bare: Any = SimpleNamespace(
        config=robot.config,
        rings=(),
        joint_names=robot.joint_names,
        free=robot.free,
        velocity_limit=robot.velocity_limit,
    )
    file = robot.config.file
    config = file.profiles["iso"].separation
    assert config is not None
    reaction = file.sources.ranges.period_s + 0.004 + file.reaction.transport_s + file.reaction.robot_s
    stop = max(entry.time_s for entry in file.stopping.values())
    fixed = config.intrusion_m + config.robot_uncertainty_m + config.human_uncertainty_m
    found = standstill_distance(bare, ZoneProfile(name="iso", config=file.profiles["iso"]), 0.004)
    assert found == pytest.approx(fixed + config.human_speed_m_s * (reaction + stop), abs=1e-12)

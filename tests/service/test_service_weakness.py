"""One list of weak points, in the same words wherever it is said."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ssm_service.cli.check_robot import check_robot
from ssm_service.model import Robot
from ssm_service.monitor import weaknesses
from ssm_service.service import Service, ServiceOptions
from ssm_service.wire.session import open_session, zenoh_config


@pytest.mark.parametrize("name", ["ur3", "ur3_covered"])
def test_the_start_health_and_check_say_the_same(name):
    robot, said = Robot.load(name), []
    worker = SimpleNamespace(restart_if_dead=lambda: False)
    with open_session(zenoh_config("router")) as session:
        service = Service(robot, session, ServiceOptions(), said.append, worker)  # type: ignore[arg-type]
        health = service._health().warnings
    expected = [str(weakness) for weakness in weaknesses(robot, robot.config.file.default_profile)]
    assert expected
    assert said[: len(expected)] == health[: len(expected)] == expected
    checked = [f"{f.key}: {f.text}" for f in check_robot(name).findings if f.level == "weak"]
    assert set(expected) <= set(checked)
    assert len(checked) == len(set(checked))

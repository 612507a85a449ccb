from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from wire_samples import JOINTS, VALID

from ssm_service.monitor import Inputs, Monitor, Received
from ssm_service.wire import obstacles_from
from ssm_service.wire.messages import INPUTS, Obstacles

POSITION = dict(zip(JOINTS, [0.31, -1.2, 1.1, 0.4, -0.5, 0.6], strict=True))
VELOCITY = dict(zip(JOINTS, [0.01, -0.02, 0.03, -0.04, 0.05, -0.06], strict=True))


def payload(order: tuple[str, ...]) -> bytes:
    return json.dumps(
        {
            **VALID["joints"],
            "name": list(order),
            "position": [POSITION[name] for name in order],
            "velocity": [VELOCITY[name] for name in order],
        }
    ).encode()


def test_all_720_orders_of_the_joints_give_the_same_sample(accept):
    orders = list(itertools.permutations(JOINTS))
    assert len(orders) == 720
    for order in orders:
        sample = accept("joints", payload(order))
        assert sample.position.tolist() == list(POSITION.values())
        assert sample.velocity.tolist() == list(VELOCITY.values())


@pytest.fixture(scope="module")
def obstacles():
    import msgspec

    message = msgspec.json.decode(json.dumps(VALID["obstacles"]), type=Obstacles)
    assert INPUTS["obstacles"] is Obstacles
    return obstacles_from(message.obstacles)


def test_all_720_orders_give_the_same_decision(robot, accept, obstacles):
    """Every order goes through a monitor of its own history: 25 ticks let the zone leave the first stop."""
    monitor = Monitor(robot)
    target = accept("target", json.dumps(VALID["target"]).encode())
    scan = np.full(robot.sensor_count, np.inf)

    def decide(order: tuple[str, ...]):
        return monitor.step(
            Inputs(
                joints=Received(value=accept("joints", payload(order)), age_s=0.001),
                ranges=Received(value=scan, age_s=0.001),
                obstacles=Received(value=obstacles, age_s=0.001),
                target=Received(value=target, age_s=0.001),
            )
        )

    for _ in range(1000):  # until zone and command are steady
        first = decide(JOINTS)
    assert first.zone < 3
    for order in itertools.permutations(JOINTS):
        decision = decide(order)
        assert decision.zone is first.zone
        assert decision.distance == first.distance
        assert decision.reasons == first.reasons
        assert np.array_equal(decision.speed_limit, first.speed_limit)
        assert np.array_equal(decision.velocity, first.velocity)

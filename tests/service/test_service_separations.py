"""The separation message: some pairs between two ticks, ten times a second."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import Decision, Inputs, JointSample, Monitor, Received
from ssm_service.service.separations import PAIRS_AT_ONCE, PERIOD_NS, SeparationOutput
from ssm_service.wire import Keys, opened
from ssm_service.wire import messages as m


class Pretended:
    """A session and its publisher."""

    def __init__(self) -> None:
        self.sent: list[tuple[bytes, bytes]] = []

    def declare_publisher(self, key: str, **_more: object) -> Pretended:
        assert key == "ssm/arm/separation"
        return self

    def put(self, payload: bytes, *, attachment: bytes) -> None:
        self.sent.append((payload, attachment))


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    return Monitor(Robot.load("ur3"), profile="iso")


def decide(monitor: Monitor, balls: int | None) -> Decision:
    things = tuple(
        Obstacle(id=str(k), shape="sphere", size=(0.05,), position=(1.0, 0.1 * k, 0.3))
        for k in range(balls or 0)
    )
    joints = JointSample(position=np.array([0.4, -1.1, 1.0, 0.0, 0.0, 0.0]), velocity=np.zeros(6))
    return monitor.step(
        Inputs(
            joints=Received() if balls is None else Received(value=joints, age_s=0.0),
            obstacles=Received(value=things, age_s=0.0),
        )
    )


def test_a_message_is_written_bit_by_bit_and_speaks_of_one_tick(monitor: Monitor) -> None:
    session = Pretended()
    output = SeparationOutput(session, Keys("arm"), producer="p", profile="iso")  # type: ignore[arg-type]
    first = decide(monitor, 3)
    needed = -(-24 // PAIRS_AT_ONCE)
    for tick in range(needed):
        assert not session.sent
        output.work(first if tick == 0 else decide(monitor, 1), tick)
    ((payload, attachment),) = session.sent
    message = msgspec.json.decode(payload, type=m.Separation)
    assert (message.seq, len(message.pairs)) == (first.tick, 24)
    assert len({(pair.link, pair.obstacle) for pair in message.pairs}) == 24
    opened("ssm/arm/separation", "p", message.seq, payload, attachment, required=True)
    assert (output.reply.payload, output.reply.attachment) == (payload, attachment)


def test_it_is_published_ten_times_a_second_and_no_tick_twice(monitor: Monitor) -> None:
    session = Pretended()
    output = SeparationOutput(session, Keys("arm"), producer="p", profile="iso")  # type: ignore[arg-type]
    output.work(None, 0)
    assert not session.sent
    decision = decide(monitor, 1)
    for now_ns in (0, 1, PERIOD_NS - 1, PERIOD_NS, 5 * PERIOD_NS):
        output.work(decision, now_ns)
    assert len(session.sent) == 1
    for step in range(20):
        output.work(decide(monitor, 1), (6 + step) * PERIOD_NS // 2)
    assert len(session.sent) == 1 + 10


def test_without_joints_there_are_no_pairs(monitor: Monitor) -> None:
    session = Pretended()
    output = SeparationOutput(session, Keys("arm"), producer="p", profile="iso")  # type: ignore[arg-type]
    output.work(decide(monitor, None), 0)
    assert msgspec.json.decode(output.reply.payload, type=m.Separation).pairs == []

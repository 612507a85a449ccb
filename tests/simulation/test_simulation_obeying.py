"""The plant's own watchdog, and the messages of its drivers, without a network."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from ssm_service.client import Followed
from ssm_service.model import Robot
from ssm_service.safety import Zone
from ssm_service.simulation import World, load_scenario
from ssm_service.simulation.drivers import Drivers
from ssm_service.simulation.obeying import Obeying
from ssm_service.wire import VALUES, Decoder, Heard, Keys, opened
from ssm_service.wire import messages as m

DT = 0.002


class Script:
    """Commands as a test wants them; it counts the polls."""

    def __init__(self, followed: Followed) -> None:
        self.now, self.polls = followed, 0

    def poll(self, now_ns: int | None = None) -> Followed:
        self.polls += 1
        return self.now


def followed(
    robot: Robot, velocity: list[float], *, expires_ns: int, names: list[str] | None = None
) -> Followed:
    return Followed(
        zone=Zone.GREEN,
        name=tuple(names or robot.joint_names),
        velocity=tuple(velocity),
        speed_limit=tuple([1.0] * len(velocity)),
        reasons=(),
        expires_ns=expires_ns,
    )


STOPPED = Followed(
    zone=Zone.STOP, name=(), velocity=(), speed_limit=(), reasons=("stale:service",), stopped_by_consumer=True
)


def world_of(robot: Robot, time_constant_s: float = 0.0) -> World:
    return World(robot, load_scenario("empty", robot), time_constant_s=time_constant_s)


def test_obeys_by_name(ur3: Robot) -> None:
    world = world_of(ur3)
    names = sorted(ur3.joint_names)
    wanted = dict(zip(names, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], strict=True))
    obeying = Obeying(world, Script(followed(ur3, list(wanted.values()), expires_ns=10**9, names=names)))
    start = world.plant.position.copy()
    obeying.step(DT, 0)
    np.testing.assert_array_equal(world.plant.position, start)
    obeying.step(DT, 2_000_000)
    expected = [wanted[name] * DT for name in ur3.joint_names]
    np.testing.assert_allclose(world.plant.position - start, expected, rtol=1e-9)
    assert (obeying.obeyed, obeying.watchdog_stops) == (2, 0)


def test_a_command_moves_no_longer_than_it_is_valid(ur3: Robot) -> None:
    """This process was held up for 2 s; the command had 20 ms to go."""
    world = world_of(ur3)
    obeying = Obeying(world, Script(followed(ur3, [0.5] * 6, expires_ns=20_000_000)))
    start = world.plant.position.copy()
    obeying.step(DT, 0)
    obeying.step(2.0, 2_000_000_000)
    np.testing.assert_allclose(world.plant.position - start, np.full(6, 0.5 * 0.020), rtol=1e-9)
    np.testing.assert_array_equal(world.plant.velocity, np.zeros(6))
    assert world.time_s == pytest.approx(DT + 2.0)


def test_an_expired_command_moves_nothing(ur3: Robot) -> None:
    world = world_of(ur3)
    obeying = Obeying(world, Script(followed(ur3, [0.5] * 6, expires_ns=1)))
    start = world.plant.position.copy()
    for step in range(5):
        obeying.step(DT, 10 + step)
    np.testing.assert_array_equal(world.plant.position, start)


def test_a_watchdog_stop_stops_the_plant_through_its_lag(ur3: Robot) -> None:
    tau = 0.02
    world = world_of(ur3, tau)
    script = Script(followed(ur3, [0.3] * 6, expires_ns=10**12))
    obeying = Obeying(world, script)
    for step in range(200):
        obeying.step(DT, step * 2_000_000)
    assert world.plant.velocity == pytest.approx([0.3] * 6, rel=1e-6)
    script.now = STOPPED
    obeying.step(DT, 400_000_000)
    assert not obeying.command.any()
    before = world.plant.velocity.copy()
    obeying.step(0.05, 450_000_000)
    np.testing.assert_allclose(world.plant.velocity, before * math.exp(-0.05 / tau), rtol=1e-9)
    assert obeying.watchdog_stops == 1
    obeying.step(DT, 460_000_000)
    assert obeying.watchdog_stops == 1
    script.now = followed(ur3, [0.3] * 6, expires_ns=10**12)
    obeying.step(DT, 470_000_000)
    script.now = STOPPED
    obeying.step(DT, 480_000_000)
    assert obeying.watchdog_stops == 2


def test_another_robots_joints_move_nothing(ur3: Robot) -> None:
    world = world_of(ur3)
    names = [*ur3.joint_names[:5], "gripper"]
    obeying = Obeying(world, Script(followed(ur3, [0.5] * 6, expires_ns=10**12, names=names)))
    start = world.plant.position.copy()
    for step in range(5):
        obeying.step(DT, step * 2_000_000)
    assert obeying.misfit
    np.testing.assert_array_equal(world.plant.position, start)


class FakeSession:
    """Takes what is put, by key."""

    def __init__(self) -> None:
        self.put: list[tuple[str, str, bytes]] = []
        self.attachments: list[bytes] = []

    def declare_publisher(self, key: str, *, encoding: str, **_qos: Any) -> Any:
        session = self

        class Publisher:
            def put(self, payload: bytes, *, attachment: bytes) -> None:
                session.put.append((key, encoding, payload))
                session.attachments.append(attachment)

        return Publisher()


def test_messages_say_what_the_world_emits(ur3: Robot) -> None:
    session = FakeSession()
    world = World(ur3, load_scenario("walk", ur3))
    drivers = Drivers(session, Keys("ur3"), ur3)  # type: ignore[arg-type]
    generator = np.random.default_rng(11)
    counts = dict.fromkeys(m.INPUTS, 0)
    for step in range(500):
        emitted = world.emit()
        session.put.clear()
        session.attachments.clear()
        after = Heard("service", step) if step % 2 else None
        drivers.send(emitted, after)
        for (key, encoding, payload), attachment in zip(session.put, session.attachments, strict=True):
            source = key.removeprefix("ssm/ur3/in/")
            assert encoding == f"application/json;ssm.{m.INPUTS[source].__name__}/1"
            message: Any = Decoder(m.INPUTS[source]).decode(payload)
            assert (message.producer, message.seq) == (drivers.producer, counts[source])
            heard = opened(key, message.producer, message.seq, payload, attachment, required=True)
            assert heard == after
            counts[source] += 1
            value, sent = VALUES[source](ur3, message), getattr(emitted, source)
            assert same(value, sent)
            if source == "joints":
                assert message.name == sorted(ur3.joint_names)
        sent_sources = {key.rpartition("/")[2] for key, _, _ in session.put}
        assert sent_sources == {source for source in m.INPUTS if getattr(emitted, source) is not None}
        world.step(generator.uniform(-1.0, 1.0, 6), DT)
    assert counts == {"joints": 125, "ranges": 7, "obstacles": 30, "target": 20}


def same(value: Any, sent: Any) -> bool:
    if isinstance(sent, np.ndarray):
        return np.array_equal(value, sent)
    if isinstance(sent, tuple):
        return value == sent
    return all(same_field(getattr(value, name), getattr(sent, name)) for name in sent.__slots__)


def same_field(a: Any, b: Any) -> bool:
    return np.array_equal(a, b) if isinstance(b, np.ndarray) else bool(a == b)


def test_no_tracker_sends_no_obstacles(ur3: Robot) -> None:
    world = World(ur3, load_scenario("walk", ur3), track_obstacles=False)
    for _ in range(100):
        assert world.emit().obstacles is None
        world.step(np.zeros(6), DT)

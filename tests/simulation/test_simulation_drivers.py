"""Drivers go on through the session that takes the place of one that reached nobody any more."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

import msgspec
import pytest
import zenoh

from ssm_service.client import Connection
from ssm_service.client import connection as module
from ssm_service.model import Robot
from ssm_service.simulation import World
from ssm_service.simulation.drivers import Drivers
from ssm_service.simulation.load import load_scenario
from ssm_service.wire import Keys
from ssm_service.wire.session import close_session, open_session, zenoh_config

DEADLINE_S = 20.0


def newest(heard: list[zenoh.Sample]) -> int:
    return int(msgspec.json.decode(heard[-1].payload.to_bytes())["seq"])


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + DEADLINE_S
    while not true():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_publishers_follow_a_connection_and_nothing_is_raised_while_it_has_no_session(
    ur3: Robot, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "DOUBT_S", 0.0)
    emitted = World(ur3, load_scenario("walk", ur3)).emit()
    heard: list[zenoh.Sample] = []
    router = open_session(zenoh_config("router", listen=[endpoint]))
    try:
        keys = Keys("ur3")
        subscriber = router.declare_subscriber(keys.input("joints"), heard.append)
        connection = Connection((endpoint,))
        try:
            drivers = Drivers(connection, keys, ur3)
            drivers.send(emitted)  # nobody yet
            first = connection.wait(DEADLINE_S)
            until(lambda: drivers.send(emitted) is None and len(heard) > 0)
            connection.unanswered(first)
            until(first.is_closed)
            sent = drivers.messages(emitted)[0].seq  # whatever is newer was not sent through the first one
            until(lambda: drivers.send(emitted) is None and newest(heard) > sent)
            assert connection.session is not first
        finally:
            connection.close()
        drivers.send(emitted)  # closed for good
        subscriber.undeclare()
    finally:
        close_session(router)

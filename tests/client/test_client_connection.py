"""A session that reaches nobody any more is replaced, and whoever follows through it goes on by itself."""

from __future__ import annotations

import time
from contextlib import suppress

import pytest

from ssm_service.client import Client, Connection
from ssm_service.client import connection as module
from ssm_service.errors import NoServiceError
from ssm_service.wire.session import open_session, zenoh_config

NOBODY = "tcp/127.0.0.1:1"
DEADLINE_S = 20.0


class Session:
    def __init__(self):
        self.closed = False

    def close(self):
        self.closed = True


@pytest.fixture
def clock(monkeypatch):
    """A clock in the test's hands, and sessions that open at once."""
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(module, "open_session", lambda _config: Session())
    return now


def opened(connection):
    """Wait for a session."""
    for _ in range(1000):
        if (session := connection.session) is not None:
            return session
        time.sleep(0.005)
    raise AssertionError("no session")


def test_it_is_replaced_after_three_seconds_without_an_answer_and_then_after_twice_as_long(clock):
    connection = Connection((NOBODY,))
    for patience in (3.0, 6.0, 12.0, 24.0, 48.0, 60.0, 60.0):
        session = opened(connection)
        connection.unanswered(session)
        clock[0] += 0.99 * patience
        connection.unanswered(session)
        assert connection.session is session
        clock[0] += 0.02 * patience
        connection.unanswered(session)
        assert opened(connection) is not session
    connection.answered()
    session = opened(connection)
    connection.unanswered(session)
    clock[0] += 3.01
    connection.unanswered(session)
    assert opened(connection) is not session
    connection.close()


def test_an_answer_ends_the_doubt_and_an_old_session_raises_none(clock):
    connection = Connection((NOBODY,))
    session = opened(connection)
    connection.unanswered(session)
    connection.answered()
    clock[0] += 5.0
    connection.unanswered(session)
    connection.unanswered(Session())
    assert connection.session is session
    connection.close()
    assert session.closed


def test_client_and_follower_go_on_through_the_session_that_takes_its_place(endpoint, pretended, monkeypatch):
    monkeypatch.setattr(module, "DOUBT_S", 0.4)
    with (
        open_session(zenoh_config("router", listen=[endpoint])),
        Client("arm", connect=(endpoint,), timeout_s=0.2) as client,
    ):
        follower = client.follower()
        first = client.connection.wait(10.0)
        end = time.monotonic() + DEADLINE_S
        while client.connection.session in (first, None):
            assert follower.poll().stopped_by_consumer
            with suppress(NoServiceError):
                client.zone()
            assert time.monotonic() < end
        assert first.is_closed()
        pretended(listen=False)
        while follower.poll().stopped_by_consumer:
            time.sleep(0.001)
            assert time.monotonic() < end
        assert client.zone().producer == "first"
        follower.close()


def test_a_follower_by_itself_doubts_a_session_on_which_nobody_proves_an_age(
    endpoint, pretended, monkeypatch
):
    monkeypatch.setattr(module, "DOUBT_S", 0.4)
    pretended(mute=True)
    with Client("arm", connect=(endpoint,)) as client:
        follower, first = client.follower(), client.connection.wait(10.0)
        end = time.monotonic() + DEADLINE_S
        while client.connection.session in (first, None):
            assert follower.poll().stopped_by_consumer
            time.sleep(0.001)
            assert time.monotonic() < end
        follower.close()

"""What Zenoh refuses, how a session dials, and how it is closed."""

from __future__ import annotations

import json
import threading

import pytest

from ssm_service.errors import ConfigError
from ssm_service.wire.session import close_session, still_closing, zenoh_config


@pytest.mark.parametrize("endpoint", ["tcp/a:1?", "tcp/a:1#", "unixsock-stream/#"])
def test_an_endpoint_that_only_zenoh_refuses_is_named_with_what_it_says(endpoint):
    with pytest.raises(ConfigError) as caught:
        zenoh_config("router", listen=[endpoint])
    error = caught.value
    assert (str(error.file), error.key, error.found) == ("Zenoh", "listen/endpoints", [endpoint])
    assert "<protocol>/<address>" in error.allowed


@pytest.mark.parametrize("mode", ["router", "peer"])
@pytest.mark.parametrize("patient", [True, False])
def test_who_listens_may_wait_for_whom_it_dials(mode, patient):
    config = zenoh_config(mode, connect=["tcp/127.0.0.1:1"], patient=patient)
    assert json.loads(config.get_json("connect/exit_on_failure")) is not patient
    assert json.loads(config.get_json("connect/timeout_ms")) == (-1 if patient else 1000)
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/127.0.0.1:1"]


def test_a_client_keeps_zenohs_own_patience():
    given, usual = (
        json.loads(config.get_json("connect/exit_on_failure"))
        for config in (zenoh_config("client", connect=["tcp/127.0.0.1:1"]), zenoh_config("client"))
    )
    assert given == usual


class SlowSession:
    """Closes when it is let to."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.closed = threading.Event()

    def close(self) -> None:
        assert self.go.wait(10.0)
        self.closed.set()


def test_closing_waits_no_longer_than_it_may_and_is_known_to_go_on():
    session = SlowSession()
    close_session(session, 0.01)
    assert still_closing()
    session.go.set()
    assert session.closed.wait(10.0)
    quick = SlowSession()
    quick.go.set()
    close_session(quick, 10.0)
    assert quick.closed.is_set()
    for thread in threading.enumerate():
        if thread.name == "ssm-closing":
            thread.join(10.0)
    assert not still_closing()

"""Endpoints that are written to look like this machine's own, or as if they asked for a certificate."""

from __future__ import annotations

import json
from typing import Any

import pytest
import zenoh

from ssm_service.errors import InputError
from ssm_service.wire import Decoder
from ssm_service.wire import messages as m
from ssm_service.wire.exposure import _weakness, exposures, is_local, protocol_of


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/10.0.0.1/127.0.0.1:7447",
        "tcp/router/localhost",
        "tcp/localhostX:7447",
        "tcp/XlocalhostX:7447",
        "tcp/10.0.0.1:7447?127.0.0.1",
        "tcp/10.0.0.1:7447#127.0.0.1",
    ],
)
def test_nothing_that_follows_the_host_makes_it_this_machine(endpoint: str) -> None:
    assert not is_local(endpoint)


@pytest.mark.parametrize(
    "endpoint", ["TCP/127.0.0.1:7447", "tcp/[::1]", "tcp/localhost", "UnixSock-Stream/x"]
)
def test_this_machine_however_it_is_written(endpoint: str) -> None:
    assert is_local(endpoint)


def test_a_protocol_is_what_stands_before_the_first_stroke() -> None:
    assert protocol_of("TLS/router/tcp/x") == "tls"
    assert protocol_of("tcp") == "tcp"


@pytest.mark.parametrize("own", ["#enable_mtls=true;iface=eth0", "#iface=eth0;enable_mtls=true"])
def test_an_endpoints_own_setting_counts_wherever_it_stands(own: str) -> None:
    made = zenoh.Config()
    for key, value in {"mode": "router", "listen/endpoints": [f"tls/0.0.0.0:7447{own}"]}.items():
        made.insert_json5(key, json.dumps(value))
    assert exposures(made) == ()


MUTUAL: dict[str, Any] = {"enable_mtls": True}
NOT_ASKED = "with TLS, but enable_mtls is not true"
NOT_VERIFIED = "with TLS, but verify_name_on_connect is false"


@pytest.mark.parametrize(
    ("endpoint", "tls", "listens", "why"),
    [
        ("tls/0.0.0.0:1#enable_mtls=false=true", MUTUAL, True, NOT_ASKED),
        ("tls/0.0.0.0:1#enable_mtls=false#enable_mtls=true", MUTUAL, True, NOT_ASKED),
        ("tls/0.0.0.0:1#enable_mtls=TRUE", MUTUAL, True, NOT_ASKED),
        ("tls/0.0.0.0:1", {"enable_mtls": "true"}, True, NOT_ASKED),
        ("tls/0.0.0.0:1", {"enable_mtls": None}, True, NOT_ASKED),
        ("tls/0.0.0.0:1", MUTUAL, True, None),
        ("quic/0.0.0.0:1", {}, True, NOT_ASKED),
        ("tls/router:1", {}, False, None),
        ("tls/router:1", {"verify_name_on_connect": None}, False, None),
        ("tls/router:1", {"verify_name_on_connect": False}, False, NOT_VERIFIED),
        ("tls/router:1#verify_name_on_connect=no", {}, False, NOT_VERIFIED),
        ("tcp/router:1", MUTUAL, True, "without TLS"),
        ("tcp/router:1#enable_mtls=true", MUTUAL, False, "without TLS"),
        ("tcp/127.0.0.1:1", {}, True, None),
    ],
)
def test_what_an_endpoint_lacks(endpoint: str, tls: dict[str, Any], listens: bool, why: str | None) -> None:
    assert _weakness(endpoint, tls, listens=listens) == why


@pytest.mark.parametrize(("length", "cut"), [(80, False), (81, True)])
def test_a_message_is_shown_by_its_first_80_bytes(length: int, cut: bool) -> None:
    payload = b'{"x":"' + b"y" * (length - 8) + b'"}'
    assert len(payload) == length
    with pytest.raises(InputError) as caught:
        Decoder(m.Ranges).decode(payload)
    assert caught.value.found == payload[:80].decode() + ("…" if cut else "")

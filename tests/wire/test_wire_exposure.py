"""Which endpoints count as this machine's own, and which let strangers in."""

from __future__ import annotations

import json
from typing import Any

import pytest
import zenoh

from ssm_service.wire.exposure import endpoints, exposures, is_local, unchecked_rights

MUTUAL = {"transport/link/tls/enable_mtls": True}
DENYING = {"access_control": {"enabled": True, "default_permission": "deny", "rules": []}}


def config(**settings: Any) -> zenoh.Config:
    made = zenoh.Config()
    for key, value in {"mode": "router", "listen/endpoints": [], **settings}.items():
        made.insert_json5(key, json.dumps(value))
    return made


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tcp/127.8.9.10:7447", True),
        ("tls/[::1]:7447", True),
        ("udp/localhost:1", True),
        ("quic/127.0.0.1:7447#iface=lo", True),
        ("unixsock-stream//tmp/a.sock", True),
        ("unixpipe//tmp/a.pipe", True),
        ("tcp/0.0.0.0:7447", False),
        ("tcp/[::]:7447", False),
        ("tcp/10.1.2.3:7447", False),
        ("tcp/router:7447", False),
        ("tcp/127.example.org:7447", False),
        ("tcp/127.0.0.1.example.org:7447", False),
        ("tcp/localhost.example.org:7447", False),
        ("ws/0.0.0.0:80?x=127.0.0.1", False),
        ("tcp/0.0.0.0:7447#iface=lo", False),
        ("tcp/[::ffff:10.0.0.1]:7447", False),
        ("nonsense", False),
    ],
)
def test_only_loopback_and_unix_sockets_are_this_machine(endpoint, local):
    assert is_local(endpoint) is local


@pytest.mark.parametrize("key", ["listen/endpoints", "connect/endpoints"])
@pytest.mark.parametrize("protocol", ["tcp", "udp", "ws"])
def test_what_has_no_tls_is_exposed_in_both_directions(key, protocol):
    (found,) = exposures(config(**{key: [f"{protocol}/0.0.0.0:7447", "tcp/127.0.0.1:1"]}, **MUTUAL))
    assert (found.key, found.endpoint, found.why) == (key, f"{protocol}/0.0.0.0:7447", "without TLS")
    assert str(found).startswith("listens at" if key.startswith("listen") else "dials")


@pytest.mark.parametrize("protocol", ["tls", "quic"])
@pytest.mark.parametrize(
    ("settings", "own", "exposed"),
    [
        ({}, "", True),
        ({"transport/link/tls/enable_mtls": False}, "", True),
        (MUTUAL, "", False),
        (MUTUAL, "#enable_mtls=false", True),
        (MUTUAL, "#iface=eth0;enable_mtls=false", True),
        ({}, "#enable_mtls=true", False),
    ],
)
def test_a_listener_must_ask_for_a_certificate(protocol, settings, own, exposed):
    found = exposures(config(**{"listen/endpoints": [f"{protocol}/0.0.0.0:7447{own}"]}, **settings))
    assert bool(found) is exposed
    assert all("enable_mtls" in one.why for one in found)


@pytest.mark.parametrize(
    ("settings", "own", "exposed"),
    [
        ({}, "", False),
        ({"transport/link/tls/verify_name_on_connect": True}, "", False),
        ({"transport/link/tls/verify_name_on_connect": False}, "", True),
        ({}, "#verify_name_on_connect=false", True),
    ],
)
def test_who_dials_must_verify_who_answers(settings, own, exposed):
    found = exposures(config(**{"connect/endpoints": [f"tls/router:7447{own}"]}, **settings))
    assert bool(found) is exposed
    assert all("verify_name" in one.why for one in found)


def test_endpoints_are_read_however_they_are_written():
    both = {"router": ["tcp/0.0.0.0:1"], "peer": ["tcp/0.0.0.0:2"]}
    assert endpoints(config(**{"listen/endpoints": both}), "listen/endpoints") == ["tcp/0.0.0.0:1"]
    assert endpoints(zenoh.Config(), "listen/endpoints") == ["tcp/[::]:0"]  # Zenoh's own default, as a peer
    assert len(exposures(zenoh.Config())) == 1


@pytest.mark.parametrize(
    ("settings", "unchecked"),
    [
        ({"listen/endpoints": ["tcp/127.0.0.1:1"]}, False),
        ({"listen/endpoints": ["tls/0.0.0.0:1"]}, True),
        ({"connect/endpoints": ["tls/router:1"]}, True),
        ({"listen/endpoints": ["tls/0.0.0.0:1"], **DENYING}, False),
        (
            {
                "listen/endpoints": ["tls/0.0.0.0:1"],
                "access_control": {"enabled": True, "default_permission": "allow"},
            },
            True,
        ),
    ],
)
def test_certificates_without_rules_are_no_rights(settings, unchecked):
    assert unchecked_rights(config(**settings)) is unchecked

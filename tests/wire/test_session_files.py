"""A Zenoh configuration file beside endpoints of our own."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ssm_service.errors import ConfigError
from ssm_service.wire.session import open_session, zenoh_config

WORKER = "unixsock-stream//tmp/evaluate.sock"


def read(config, key: str):
    return json.loads(config.get_json(key))


@pytest.fixture
def file(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "zenoh.json5"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(
    "endpoints", ['["tcp/127.0.0.1:7001"]', '{router: ["tcp/127.0.0.1:7001"], peer: ["tcp/127.0.0.1:7002"]}']
)
def test_an_endpoint_of_ours_joins_those_of_the_file(file, endpoints):
    path = file(f'{{ mode: "router", listen: {{ endpoints: {endpoints} }} }}')
    config = zenoh_config("router", listen=[WORKER], file=path)
    assert read(config, "listen/endpoints") == ["tcp/127.0.0.1:7001", WORKER]


def test_a_file_that_says_nothing_of_listening_opens_no_port(file):
    path = file('{ mode: "router", connect: { endpoints: ["tcp/router:7447"] } }')
    config = zenoh_config("router", listen=[WORKER], file=path)
    assert read(config, "listen/endpoints") == [WORKER]
    assert read(config, "connect/endpoints") == ["tcp/router:7447"]


def test_an_empty_list_of_the_file_stays_empty_but_for_ours(file):
    path = file('{ mode: "router", listen: { endpoints: [] } }')
    assert read(zenoh_config("router", listen=[WORKER], file=path), "listen/endpoints") == [WORKER]


def test_the_mode_is_the_programs_where_the_file_names_none(file):
    assert read(zenoh_config("router", listen=[WORKER], file=file("{}")), "mode") == "router"
    assert read(zenoh_config("router", file=file('{ mode: "client" }')), "mode") == "client"


def test_given_endpoints_to_dial_replace_those_of_the_file(file):
    path = file('{ mode: "client", connect: { endpoints: ["tcp/router:7447"] } }')
    assert read(zenoh_config("client", file=path), "connect/endpoints") == ["tcp/router:7447"]
    config = zenoh_config("client", connect=["tcp/127.0.0.1:7003"], file=path)
    assert read(config, "connect/endpoints") == ["tcp/127.0.0.1:7003"]


def test_everything_else_of_the_file_stands(file):
    path = file("{ transport: { link: { tx: { lease: 777 } } } }")
    assert read(zenoh_config("client", file=path), "transport/link/tx/lease") == 777


def test_a_session_listens_at_both(file, tmp_path):
    of_file, ours = (f"unixsock-stream/{tmp_path / name}" for name in ("a.sock", "b.sock"))
    path = file(
        f'{{ mode: "router", listen: {{ endpoints: ["{of_file}"] }},'
        " scouting: { multicast: { enabled: false }, gossip: { enabled: false } } }"
    )
    with open_session(zenoh_config("router", listen=[ours], file=path)):
        for endpoint in (of_file, ours):
            with open_session(zenoh_config("client", connect=[endpoint])) as session:
                assert len(session.info.routers_zid()) == 1


def test_an_unknown_key_in_the_file_is_refused_with_its_path(file):
    path = file("{ no_such_key: 1 }")
    with pytest.raises(ConfigError) as error:
        zenoh_config("client", file=path)
    assert str(path) in str(error.value)

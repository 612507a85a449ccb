"""Keys and Zenoh configurations."""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from ssm_service.errors import ConfigError, ServiceError
from ssm_service.wire import Keys, robot_of
from ssm_service.wire.session import NETWORK_NICE, open_session, zenoh_config

CAP_SYS_NICE = 23


def test_keys_are_those_of_the_contract():
    keys = Keys("ur3")
    assert keys.input("joints") == "ssm/ur3/in/joints"
    assert keys.output("zone") == "ssm/ur3/zone"
    assert keys.alive == "ssm/ur3/alive"
    assert robot_of(keys.alive) == "ur3"


@pytest.mark.parametrize(
    "name", ["", "a/b", "*", "**", "a*", "$*", "a b", "ü", "-a", ".", "a" * 65, "a#", "a?b"]
)
def test_a_name_that_could_mean_other_keys_is_refused(name):
    with pytest.raises(ConfigError) as caught:
        Keys(name)
    error = caught.value
    assert (error.file, error.key, error.found) == ("--name", "", name)
    assert error.allowed == "1 to 64 letters, digits, '_', '-' or '.'"


def test_every_key_of_a_robot_says_whose_it_is():
    keys = Keys("a.b-c_9")
    for key in (keys.input("joints"), keys.output("zone"), keys.alive):
        assert robot_of(key) == "a.b-c_9"


def test_the_configuration_is_closed_and_quick():
    config = zenoh_config("router", listen=["tcp/127.0.0.1:7447"])
    assert json.loads(config.get_json("scouting/multicast/enabled")) is False
    assert json.loads(config.get_json("scouting/gossip/enabled")) is False
    assert json.loads(config.get_json("mode")) == "router"
    assert json.loads(config.get_json("transport/link/tx/lease")) == 100
    assert json.loads(config.get_json("transport/shared_memory/enabled")) is False


def test_a_file_holds_where_nothing_else_is_said(tmp_path):
    file = tmp_path / "zenoh.json5"
    file.write_text(
        '{mode: "peer", listen: {endpoints: ["tcp/127.0.0.1:1"]}, transport: {link: {tx: {lease: 777}}}}'
    )
    config = zenoh_config("router", file=file)
    assert json.loads(config.get_json("mode")) == "peer"
    assert json.loads(config.get_json("transport/link/tx/lease")) == 777
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:1"]


@pytest.mark.parametrize("content", ["", "{", "{modee: 1}", '{mode: "boss"}', "\x00"])
def test_a_wrong_file_is_named(tmp_path, content):
    file = tmp_path / "zenoh.json5"
    file.write_text(content)
    with pytest.raises(ConfigError) as caught:
        zenoh_config("router", file=file)
    assert caught.value.file == str(file)


@pytest.mark.parametrize("endpoint", ["7447", "tcp", "tcp/", "http//x", ""])
def test_a_wrong_endpoint_is_an_error_of_ours(endpoint):
    with pytest.raises((ConfigError, ServiceError)):
        open_session(zenoh_config("router", listen=[endpoint])).close()


def test_a_client_says_at_once_that_nobody_listens():
    with pytest.raises(ServiceError):
        open_session(zenoh_config("client", connect=["tcp/127.0.0.1:1"]))


OPEN_ONE = """
import json, os
from ssm_service.wire.session import open_session, zenoh_config
def threads(): return {int(name) for name in os.listdir("/proc/self/task")}
before = threads()
with open_session(zenoh_config("router", listen=["tcp/127.0.0.1:0"])):
    made = [os.getpriority(os.PRIO_PROCESS, thread) for thread in threads() - before]
    print(json.dumps([made, os.getpriority(os.PRIO_PROCESS, 0)]), flush=True)
os._exit(0)
"""


def test_zenohs_threads_are_favoured_where_that_is_permitted_and_nobody_else():
    before = os.getpriority(os.PRIO_PROCESS, 0)
    # In a process of its own: Zenoh's threads are those of a process's first session.
    done = subprocess.run(
        [sys.executable, "-c", OPEN_ONE], capture_output=True, text=True, check=True, timeout=60
    )
    made, own = json.loads(done.stdout)
    status = Path("/proc/self/status").read_text()
    effective = int(re.search(r"CapEff:\s*(\w+)", status)[1], 16)
    allowed = (
        effective >> CAP_SYS_NICE & 1 or 20 - resource.getrlimit(resource.RLIMIT_NICE)[0] <= NETWORK_NICE
    )
    assert set(made) == {NETWORK_NICE if allowed else before}
    assert own == before

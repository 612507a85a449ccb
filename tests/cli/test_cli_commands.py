"""Every command's wrong use: exit status and what is said."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest

from ssm_service import __version__

COMMANDS = {
    *("demo", "run", "sim", "zone", "watch", "reset"),
    *("evaluate", "coverage", "check", "schema", "keys"),
}
NOBODY = "tcp/127.0.0.1:1"


def test_version(ssm):
    done = ssm("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"ssm {__version__}\n", "")


def test_help_lists_exactly_the_commands_that_exist(ssm):
    done = ssm("--help")
    assert done.returncode == 0
    assert set(re.findall(r"^│ ([a-z]+) ", done.stdout, flags=re.MULTILINE)) == COMMANDS


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_explains_itself(ssm, command):
    done = ssm(command, "--help")
    assert done.returncode == 0
    assert f"ssm {command}" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["frob"], ["No such command 'frob'"]),
        (["run", "--rate", "2000"], ["--rate", "2000", "50 to 1000 Hz"]),
        (["run", "--rate", "nan"], ["--rate", "nan", "50 to 1000 Hz"]),
        (["run", "--rate", "fast"], ["--rate", "fast"]),
        (["run", "--seconds", "-1"], ["--seconds", "-1.0", "above 0"]),
        (["run", "--robot", "ur33"], ["'ur33'", "did you mean 'ur3'"]),
        (["run", "--robot", "no/such.toml"], ["no/such.toml", "no such file"]),
        (["run", "--name", "a/b"], ["--name", "'a/b'", "letters"]),
        (["run", "--profile", "kang"], ["ur3.toml", "profiles", "'kang'", "kang2022"]),
        (["run", "--zenoh-config", "no.json5"], ["no.json5"]),
        (["sim", "--scenario", "cross"], ["--scenario", "'cross'", "did you mean 'crossing'"]),
        (["sim", "--seconds", "inf"], ["--seconds", "inf"]),
        (["zone", "--name", "a/b"], ["--name", "'a/b'"]),
        (["zone", "--timeout", "-1"], ["--timeout", "-1.0", "above 0, at most 3600"]),
        (["zone", "--timeout", "nan"], ["--timeout", "nan", "above 0"]),
        (["evaluate", "--timeout", "0"], ["--timeout", "0.0", "above 0"]),
        (["zone", "--connect", "http//x"], ["--connect", "'http//x'", "PROTOCOL/HOST:PORT", "tcp"]),
        (["zone", "--connect", "tcp/127.0.0.1"], ["--connect", "'tcp/127.0.0.1'", "PROTOCOL/HOST:PORT"]),
        (["zone", "--connect", "tcp/[::1]:70000"], ["--connect", "'tcp/[::1]:70000'"]),
        (["run", "--listen", "localhost:7447"], ["--listen", "'localhost:7447'", "tcp/127.0.0.1:7447"]),
        (["watch", "--all", "--name", "ur3"], ["--name", "'ur3'", "--all"]),
        (["watch", "--seconds", "0"], ["--seconds", "0.0", "above 0"]),
        (["evaluate", "no.jsonl"], ["no.jsonl", "No such file"]),
        (["evaluate", "--robot", "ur33"], ["did you mean 'ur3'"]),
        (["evaluate", "--profile", "kang"], ["profiles", "'kang'"]),
        (["evaluate", "--connect", NOBODY], ["--remote"]),
        (["evaluate", "--remote", "--profile", "kang2022"], ["--profile", "--remote"]),
        (["check", "ur33"], ["FILE", "did you mean 'ur3'"]),
        (["check", "README.md"], ["FILE", "'README.md'", ".toml", ".json5"]),
        (["check", "no.json5"], ["no.json5", "no such file"]),
        (["demo", "--rate", "20"], ["--rate", "20.0", "50 to 1000 Hz"]),
        (["demo", "--scenario", "nix"], ["--scenario", "'nix'", "crossing"]),
        (["demo", "--out", "/proc/report"], ["--out", "/proc/report"]),
    ],
)
def test_wrong_use_is_status_2_and_names_the_place_what_was_found_and_what_is_allowed(ssm, arguments, words):
    done = ssm(*arguments)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["zone", "--timeout", "0.3"],
        ["reset", "--timeout", "0.3"],
        ["watch", "--seconds", "0.3", "--json"],
        ["sim", "--seconds", "0.5"],
        ["evaluate", "--remote", "--timeout", "0.3"],
    ],
)
def test_without_a_service_the_status_is_1_and_the_endpoint_is_named(ssm, arguments):
    done = ssm(*arguments, "--connect", NOBODY, stdin='{"position": [0, 0, 0, 0, 0, 0]}\n')
    assert done.returncode == 1
    assert NOBODY in done.stderr
    assert "Traceback" not in done.stderr


def test_the_package_is_imported_cheaply_and_its_names_are_there():
    code = (
        "import sys, ssm_service\n"
        "assert not {'numpy', 'pinocchio', 'zenoh'} & set(sys.modules), 'not cheap'\n"
        "from ssm_service import Client, Monitor, Robot\n"
        "print(Client.__name__, Monitor.__name__, Robot.__name__, ssm_service.__version__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stderr == ""
    assert done.stdout.split() == ["Client", "Monitor", "Robot", __version__]


def test_schemas_are_whole(ssm):
    done = ssm("schema")
    assert done.returncode == 0
    document = json.loads(done.stdout)
    definitions = document["$defs"]
    assert {"Zone", "VelocityCommand", "JointState", "Ranges", "Obstacles", "Target"} <= set(definitions)
    seen = 0
    stack = [document]
    while stack:
        value = stack.pop()
        if isinstance(value, list):
            stack.extend(value)
        if not isinstance(value, dict):
            continue
        stack.extend(value.values())
        if isinstance(value.get("$ref"), str):
            seen += 1
            assert value["$ref"].removeprefix("#/$defs/") in definitions
        if value.get("type") == "object" and "properties" in value:
            assert set(value.get("required", [])) <= set(value["properties"])
            assert value["additionalProperties"] is False
        if isinstance(value.get("type"), str):
            assert value["type"] in {
                "object", "array", "string", "number", "integer", "boolean", "null",
            }  # fmt: skip
    assert seen > 5

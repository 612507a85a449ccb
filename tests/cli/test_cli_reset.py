"""``ssm reset`` and ``ssm run --state``: a latched stop, acknowledged from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import zenoh
from cli_kit import free_endpoint, wait_for_line

UR3 = Path(__file__).parents[2] / "robots" / "ur3.toml"


def disturb(endpoint: str, count: int) -> None:
    """Send messages with a wrong checksum, as a stranger would."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:
        for _ in range(count):
            session.put("ssm/ur3/in/joints", b"{}", attachment=b"crc32=00000000")
        list(session.get("ssm/ur3/zone"))  # they have arrived


def test_reset_says_what_was_latched(ssm, marked, tmp_path):
    robot, state, address = tmp_path / "ur3.toml", tmp_path / "state", free_endpoint()
    robot.write_text(UR3.read_text(encoding="utf-8") + "\n[profiles.kang2022.latch]\ninterval_s = 600.0\n")
    run = marked.start(
        "run", "--robot", str(robot), "--state", str(state), "--listen", address, "--rate", "50"
    )
    wait_for_line(run, "ready")
    where = ["--connect", address]
    nothing = ssm("reset", *where)
    assert (nothing.returncode, nothing.stdout) == (0, "ur3: nothing was latched\n")

    disturb(address, 2)
    assert "latched" in json.loads(ssm("zone", *where, "--json").stdout)["reasons"]
    said = wait_for_line(run, "latched until")
    assert "`ssm reset`" in said
    done = ssm("reset", *where)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("ur3: cleared: corruption on in/joints, ")
    assert "latched" not in json.loads(ssm("zone", *where, "--json").stdout)["reasons"]

    disturb(address, 1)
    reply = json.loads(ssm("reset", *where, "--json").stdout)
    assert (reply["robot"], reply["cleared"]) == ("ur3", "corruption on in/joints")
    assert [path.name for path in state.iterdir()] == ["ur3.json"]

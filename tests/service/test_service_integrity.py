"""A latched stop on real processes: across kill -9, until somebody resets it."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from service_kit import (
    HEALTHY,
    HERE,
    JOINT_FIELDS,
    OBSTACLE_FIELDS,
    RANGE_FIELDS,
    RECOVERY_TICKS,
    Ear,
    ServiceUnderTest,
    driving,
    driving_in_process,
    listening,
    running,
    wait_for,
)

ROBOT = (HERE.parents[1] / "robots" / "ur3.toml").read_text(encoding="utf-8")
LATCHING = f"{ROBOT}\n[profiles.kang2022.latch]\ninterval_s = 600.0\n"


@pytest.fixture
def options(tmp_path: Path) -> dict[str, Any]:
    """A service whose profile latches, with a folder of its own."""
    robot = tmp_path / "ur3.toml"
    robot.write_text(LATCHING)
    return {"robot": str(robot), "state": str(tmp_path / "state")}


@pytest.fixture
def kept(options: dict[str, Any]) -> Path:
    return Path(options["state"]) / "ur3.json"


@pytest.fixture
def healthy(options: dict[str, Any]) -> Iterator[tuple[ServiceUnderTest, Ear]]:
    """A latching service with a good driver, and who listens."""
    with running(**options) as service, driving(service.endpoint), listening(service.endpoint) as ear:
        ear.until(lambda zone: zone["reasons"] == ["distance"])
        ear.forget()
        yield service, ear


def corrupt(ear: Ear) -> None:
    """Send one message with a wrong checksum; the driver's next good message follows it soon."""
    ear.put("in/target", json.dumps({"producer": "x", "seq": 1}), attachment=b"crc32=00000000")


def test_the_second_error_latches_and_a_reset_lets_the_zone_recover(healthy, kept):
    _, ear = healthy
    corrupt(ear)
    wait_for(lambda: ear.health()["integrity_errors"] == {"corruption": 1})
    assert ear.health()["latched"] is None
    assert ear.next_zone()["zone"] == "yellow"
    corrupt(ear)
    zone = ear.until(lambda zone: "latched" in zone["reasons"])
    assert (zone["zone"], set(zone["speed_limit"])) == ("stop", {0.0})
    latched = ear.health()["latched"]
    assert latched.startswith("corruption on in/target, ")
    wait_for(lambda: json.loads(kept.read_text())["latched"] == latched)
    time.sleep(0.5)  # good messages alone never undo it
    assert "latched" in ear.next_zone()["reasons"]

    ear.forget()
    kind, encoding, reply = ear.ask("reset")
    assert (kind, encoding) == ("ok", "application/json;ssm.ResetReply/1")
    assert (reply["cleared"], reply["robot"]) == (latched, "ur3")
    ear.until(lambda zone: zone["reasons"] == ["distance"])
    zones = ear.zones()
    last = max(zone["seq"] for zone in zones if "latched" in zone["reasons"])
    first = min(zone["seq"] for zone in zones if zone["zone"] != "stop" and zone["seq"] > last)
    assert first - last >= RECOVERY_TICKS
    assert ear.health()["latched"] is None
    assert ear.ask("reset")[2]["cleared"] is None
    wait_for(
        lambda: json.loads(kept.read_text()) == {"latched": None, "fault": None, "where": "", "at_ns": 0}
    )


def test_a_query_for_everything_resets_nothing(healthy):
    _, ear = healthy
    corrupt(ear)
    wait_for(lambda: ear.health()["integrity_errors"])
    for wider in ("ssm/ur3/*", "ssm/**", "ssm/*/reset"):
        replies = list(ear.session.get(wider))
        assert not [reply for reply in replies if reply.ok is not None and "reset" in str(reply.ok.key_expr)]
    corrupt(ear)
    ear.until(lambda zone: "latched" in zone["reasons"])
    for wider in ("ssm/ur3/*", "ssm/**", "ssm/*/reset"):
        list(ear.session.get(wider))
    assert "latched" in ear.next_zone()["reasons"]


def test_a_latched_stop_outlives_kill_9(options, kept):
    with running(**options) as service, listening(service.endpoint) as ear:
        for _ in range(2):
            corrupt(ear)
        ear.until(lambda zone: "latched" in zone["reasons"])
        wait_for(lambda: kept.exists() and json.loads(kept.read_text())["latched"])
        os.kill(service.pid, signal.SIGKILL)
        service.popen.wait(10)
    with running(**options) as service, listening(service.endpoint) as ear, driving(service.endpoint):
        assert "from before" in service.output()
        assert ear.health()["latched"].startswith("corruption on in/target, ")
        zone = ear.until(lambda zone: zone["reasons"] == ["distance", "latched"])
        assert zone["zone"] == "stop"
        ear.ask("reset")
        ear.until(lambda zone: zone["reasons"] == ["distance"])


def test_a_file_that_cannot_be_read_is_latched_and_a_folder_that_cannot_be_written_is_said(options, kept):
    kept.parent.mkdir()
    kept.write_text("{")
    with running(**options) as service, listening(service.endpoint) as ear:
        assert "cannot be read" in ear.health()["latched"]
        ear.ask("reset")
        assert ear.health()["latched"] is None
        wait_for(lambda: kept.read_text() != "{")
    blocked = kept.parent / "ur3.json" / "below"
    with running(**{**options, "state": str(blocked)}) as service, listening(service.endpoint) as ear:
        wait_for(lambda: any("would not outlive" in text for text in ear.health()["warnings"]))
        for _ in range(2):
            corrupt(ear)
        ear.until(lambda zone: "latched" in zone["reasons"])


def test_health_says_what_is_checked_and_what_is_not(tmp_path):
    robot = tmp_path / "ur3.toml"
    text = ROBOT.replace("target = { required = false,", 'target = { integrity = "none", required = false,')
    assert text != ROBOT
    robot.write_text(text)
    with running(robot=str(robot)) as service, listening(service.endpoint) as ear:
        checked = {"joints": "crc", "ranges": "crc", "obstacles": "crc", "target": "none"}
        assert ear.health()["integrity"] == checked
        sources = {"joints": JOINT_FIELDS, "ranges": RANGE_FIELDS, "obstacles": OBSTACLE_FIELDS}
        target = json.dumps({"producer": "simple", "seq": 1, "stamp_ns": 0, **HEALTHY["target"][1]})
        with driving_in_process(ear, **sources):
            ear.until(
                lambda zone: zone["reasons"] == ["distance", "waiting:target"] or zone["zone"] == "yellow"
            )
            ear.put("in/target", target, attachment=None)
            wait_for(lambda: ear.health()["accepted"]["target"] == 1)
        assert ear.health()["integrity_errors"] == {}


def test_an_echo_shows_the_transport(shared_service, ear):
    zone = ear.next_zone()
    fields = {"producer": "slow", "seq": 0, "stamp_ns": 0, "service": zone["producer"], "tick": zone["seq"]}
    time.sleep(0.3)
    ear.put("in/echo", json.dumps({**fields, "held_ns": 0}))
    found = wait_for(lambda: ear.health()["transport_s"], 2.0)
    assert set(found) == {"slow"}
    assert 0.3 <= found["slow"] < 5.0
    wait_for(lambda: not ear.health()["transport_s"], 4.0)  # it is forgotten, too

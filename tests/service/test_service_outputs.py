"""What a plain Zenoh program gets: publications, queries, errors, the token."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time

import pytest
import zenoh
from service_kit import HERE, JOINTS, POSITION, RECOVERY_TICKS, Ear, crc, strictly, wait_for, without_gaps


def test_a_program_that_knows_nothing_of_us_asks_for_the_zone(shared_service, ear):
    script = HERE / "foreign_client.py"
    done = subprocess.run(
        [sys.executable, str(script), shared_service.endpoint], capture_output=True, text=True, timeout=30
    )
    assert done.returncode == 0, done.stderr
    answers = strictly(done.stdout)
    assert answers.pop("modules") == []
    assert answers.pop("alive") == ["ssm/ur3/alive"]
    assert {key: encoding for key, (encoding, _) in answers.items()} == {
        "zone": "application/json;ssm.Zone/1",
        "command": "application/json;ssm.VelocityCommand/1",
        "config": "application/json",
        "health": "application/json;ssm.Health/1",
    }
    zone = answers["zone"][1]
    assert set(zone) == {
        "producer", "seq", "stamp_ns", "valid_for_ns", "robot", "profile", "zone", "distance", "name",
        "speed_limit", "speed_scaling", "nearest", "sources", "comparison", "limiting", "reaction", "reasons",
    }  # fmt: skip
    assert set(answers["command"][1]) == {
        "producer", "seq", "stamp_ns", "valid_for_ns", "robot", "zone", "name", "velocity",
    }  # fmt: skip
    assert (zone["robot"], zone["zone"], zone["reasons"]) == ("ur3", "yellow", ["distance"])
    assert zone["nearest"]["obstacle"] == "ball"


def test_zone_and_command_of_a_tick_share_their_number(ear):
    time.sleep(1.0)
    zones, commands = ear.zones(), [one.value for one in ear.heard("command")]
    assert len(zones) > 400
    assert without_gaps(zones)
    assert without_gaps(commands)
    by_seq = {command["seq"]: command for command in commands}
    pairs = [(zone, by_seq[zone["seq"]]) for zone in zones if zone["seq"] in by_seq]
    assert len(pairs) > 400
    for zone, command in pairs:
        for field in ("producer", "stamp_ns", "valid_for_ns", "robot", "zone", "name"):
            assert zone[field] == command[field]
        assert zone["valid_for_ns"] == 20_000_000
        assert tuple(zone["name"]) == JOINTS
        for speed, limit in zip(command["velocity"], zone["speed_limit"], strict=True):
            assert abs(speed) <= limit
    assert {one.encoding for one in ear.heard("zone")} == {"application/json;ssm.Zone/1"}
    assert {one.encoding for one in ear.heard("command")} == {"application/json;ssm.VelocityCommand/1"}


def test_every_message_has_its_checksum(ear):
    wait_for(lambda: len(ear.heard("zone")) > 100 and len(ear.heard("command")) > 100)
    for key in ("zone", "command"):
        for one in ear.heard(key):
            assert one.attachment == crc(f"ssm/ur3/{key}", one.text)


def test_the_target_moves_the_arm_within_the_zones_limit(ear):
    command = wait_for(lambda: ear.heard("command"), 2.0)[-1].value
    assert command["velocity"] == [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_config_says_what_is_in_force(ear):
    kind, encoding, config = ear.ask("config")
    assert (kind, encoding) == ("ok", "application/json")
    assert config["robot"] == "ur3"
    assert config["profile"] == "kang2022"
    assert config["rate_hz"] == 500.0
    assert tuple(config["joint_names"]) == JOINTS
    assert config["sensor_count"] == 8
    assert config["robot_file"]["profiles"]["kang2022"]["recovery_ticks"] == RECOVERY_TICKS


def test_health_counts(ear):
    first = ear.health()
    time.sleep(0.5)
    second = ear.health()
    assert second["ticks"] > first["ticks"] + 150
    for source, fewest in (("joints", 30), ("ranges", 5), ("obstacles", 8), ("target", 5)):
        assert second["accepted"][source] >= first["accepted"][source] + fewest
        assert 0.0 <= second["age_s"][source] < 1.0
    assert second["queries"]["health"] == first["queries"]["health"] + 1
    assert set(second["tick_us"]) == set(second["lateness_us"]) == {"p50", "p99", "max"}
    assert second["seq"] == second["ticks"]


def test_frames_now_and_as_asked_are_the_same(ear):
    kind, encoding, now = ear.ask("frames")
    assert (kind, encoding) == ("ok", "application/json;ssm.FramesReply/1")
    _, _, asked = ear.ask("frames", json.dumps({"position": POSITION}))
    assert now == asked
    assert now["position"] == POSITION
    assert len(now["sensors"]) == 8
    assert {len(row) for frame in now["sensors"] for row in frame} == {4}
    assert len(now["jacobian"]) == 3
    assert {len(row) for row in now["jacobian"]} == {3}
    assert "forearm_link" in now["links"]


def test_all_720_orders_of_the_joints_mean_the_same_configuration(ear):
    position = dict(zip(JOINTS, [0.3, -1.2, 1.1, 0.4, -0.5, 0.6], strict=True))
    replies = set()
    for order in itertools.permutations(JOINTS):
        payload = json.dumps({"position": [position[name] for name in order], "name": order})
        replies.add(json.dumps(ear.ask("frames", payload)))
    assert len(replies) == 1


def test_evaluate_answers_line_by_line(ear):
    ball = {"id": "b", "shape": "sphere", "size": [0.1], "position": [0.75, 0.0, 0.3]}
    questions = [
        {"position": POSITION},
        {"position": POSITION, "obstacles": [ball], "velocity": [0.1] * 6},
        {"position": POSITION, "ranges": [0.3, 0.35, None, None, None, None, None, None]},
        {"position": [0.0]},
        {"position": POSITION, "obstacles": [{**ball, "shape": "cone"}]},
        {"position": POSITION, "obstacles": [], "target": {"kind": "position", "value": [0.3, 0.1, 0.4]}},
        17,
    ]
    kind, encoding, answers = ear.ask("evaluate", json.dumps(questions))
    assert (kind, encoding) == ("ok", "application/json;ssm.EvaluateOutput/1")
    assert len(answers) == len(questions)
    assert answers[0]["zone"] == "stop"
    assert answers[0]["reasons"] == ["waiting:ranges"]
    assert answers[1]["zone"] == "yellow"
    assert answers[1]["distance"] == ear.next_zone()["distance"]
    assert answers[2]["estimates"]["nearest"]["distance"] == 0.3
    assert "error" in answers[3]
    assert "obstacles[0].shape" in answers[4]["error"]
    assert len(answers[5]["command"]["velocity"]) == 6
    assert "error" in answers[6]


@pytest.mark.parametrize("key", ["evaluate", "frames"])
@pytest.mark.parametrize(
    "payload",
    [
        b"nonsense",
        b"\xff\xff",
        b"{",
        b'{"pos": [0]}',
        b'{"position": [0]}',
        b'{"position": [NaN,0,0,0,0,0]}',
        b'{"position": [1e999,0,0,0,0,0]}',
        b"[" * 100_000,
        b"[" * 100_000 + b"]" * 100_000,
        b'{"position": ' + b"9" * 4000 + b"}",
        b"x" * 3_900_000,
    ],
    ids=lambda value: value[:20] if isinstance(value, bytes) else value,
)
def test_a_query_that_makes_no_sense_is_told_what_was_wrong(ear, key, payload):
    kind, encoding, value = ear.ask(key, payload)
    assert (kind, encoding) == ("error", "application/json;ssm.EvaluateError/1")
    assert list(value) == ["error"]
    assert "allowed" in value["error"]
    assert len(value["error"]) < 600


def test_evaluate_without_a_payload_is_told_so(ear):
    kind, _, value = ear.ask("evaluate")
    assert kind == "error"
    assert "payload" in value["error"]


def test_a_reply_that_zenoh_would_not_carry_is_an_error_not_a_silence(ear):
    kind, _, value = ear.ask("evaluate", json.dumps([{"position": POSITION}] * 5000), seconds=20.0)
    assert kind == "error"
    assert "fewer inputs" in value["error"]
    assert ear.ask("evaluate", json.dumps([{"position": POSITION}]))[0] == "ok"


def test_the_token_is_there(shared_service, ear):
    keys = [str(reply.ok.key_expr) for reply in ear.session.liveliness().get("ssm/**")]
    assert keys == ["ssm/ur3/alive"]


def test_a_query_for_everything_is_answered_by_every_key(ear):
    keys = {str(reply.ok.key_expr) for reply in ear.session.get("ssm/ur3/*") if reply.ok is not None}
    assert keys == {
        f"ssm/ur3/{key}" for key in ("zone", "command", "separation", "config", "health", "frames")
    }


def test_payloads_and_parameters_of_plain_queries_do_not_matter(ear):
    for payload in (None, b"", b"x" * 100_000):
        assert ear.ask("zone", payload)[0] == "ok"
    replies = list(ear.session.get(zenoh.Selector("ssm/ur3/zone", "a=b;c=d")))
    assert [reply.ok is not None for reply in replies] == [True]


def test_other_robots_are_not_ours(ear: Ear):
    assert list(ear.session.get("ssm/ur5/zone", timeout=1.0)) == []

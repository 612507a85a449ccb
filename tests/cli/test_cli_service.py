"""Service, simulation and consumers as processes of their own."""

from __future__ import annotations

import json
import signal
import time

from cli_kit import free_endpoint, wait_for_line


def test_the_commands_talk_to_each_other(ssm, marked, service):
    where = ["--connect", service]

    waiting = ssm("zone", *where)
    assert waiting.returncode == 0
    assert waiting.stdout.startswith(
        "ur3: stop · nothing seen · limit 0.00 rad/s · waiting:joints, waiting:ranges"
    )

    sim = marked.start("sim", *where, "--scenario", "static", "--json")
    wait_for_line(sim, "obeys the service")
    deadline = time.monotonic() + 20.0
    zone = "stop"
    while zone == "stop" and time.monotonic() < deadline:
        done = ssm("zone", *where, "--json")
        assert (done.returncode, done.stderr) == (0, "")
        message = json.loads(done.stdout)
        zone = message["zone"]
    assert zone in {"green", "yellow", "red"}
    assert message["robot"] == "ur3"
    assert message["distance"] > 0.0

    sim.send_signal(signal.SIGINT)
    out, err = sim.communicate(timeout=20)
    assert sim.returncode == 0, err
    assert json.loads(out)["connected"] is True


def test_watch_streams_every_decision_as_json(ssm, service):
    done = ssm("watch", "--connect", service, "--seconds", "1.5", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    decided = [row for row in rows if not row["stopped_by_consumer"]]
    assert len(decided) > 50
    numbers = [row["seq"] for row in decided]
    assert numbers == sorted(set(numbers))
    assert {row["zone"] for row in rows} == {"stop"}
    assert rows[0]["reasons"] == ["waiting:service"]
    assert "waiting:joints" in decided[-1]["reasons"] or "stale:joints" in decided[-1]["reasons"]


def test_watch_all_finds_the_robots_by_themselves(ssm, service):
    done = ssm("watch", "--all", "--connect", service, "--seconds", "1.5", "--json")
    assert done.returncode == 0
    assert {json.loads(line)["robot"] for line in done.stdout.splitlines()} == {"ur3"}


def test_watch_survives_a_restart_of_the_service(marked):
    address = free_endpoint()
    watch = marked.start("watch", "--connect", address, "--json")
    assert watch.stdout is not None

    def until(wanted: bool) -> None:
        for line in watch.stdout:
            if json.loads(line)["stopped_by_consumer"] is wanted:
                return
        raise AssertionError("watch ended")

    until(True)
    for number in (signal.SIGTERM, signal.SIGKILL):
        run = marked.start("run", "--listen", address, "--rate", "50")
        until(False)
        run.send_signal(number)
        until(True)
        run.communicate(timeout=20)
    watch.send_signal(signal.SIGINT)
    _, err = watch.communicate(timeout=20)
    assert (watch.returncode, err) == (0, "")


def test_a_name_that_nobody_has_is_answered_with_those_that_are_there(ssm, service):
    done = ssm("zone", "--connect", service, "--name", "ur33", "--timeout", "0.5")
    assert done.returncode == 1
    assert "nobody answered ssm/ur33/zone within 0.5 s; there: ur3;" in done.stderr
    assert "'ready'" in done.stderr


def test_an_endpoint_in_use_is_said_without_zenohs_own_notation(ssm, service):
    done = ssm("run", "--listen", service)
    assert done.returncode == 1
    assert "another `ssm run`" in done.stderr
    assert "--listen" in done.stderr
    for notation in ("so_rcvbuf", "Single(", "Traceback"):
        assert notation not in done.stderr


def test_a_second_service_of_the_same_name_is_refused(ssm, service):
    done = ssm("run", "--connect", service, "--listen", "tcp/127.0.0.1:0", "--seconds", "5")
    assert done.returncode == 1
    assert "ur3" in done.stderr
    assert "Traceback" not in done.stderr

"""Who gets in: nobody without a certificate of this network's authority that is valid now."""

from __future__ import annotations

import json
import time

import pytest
import zenoh
from security_kit import (
    Robot,
    Watch,
    answers,
    certified,
    free_port,
    new_pair,
    refused_at_the_door,
    send_milder,
    wait_for,
)

from ssm_service.cli.keys_certificates import make_authority, make_certificate

NO_CERTIFICATE = {
    "transport__link__tls__connect_certificate": None,
    "transport__link__tls__connect_private_key": None,
    "transport__link__tls__enable_mtls": False,
}


@pytest.mark.parametrize("kind", ["none", "plain", "authority", "self", "expired", "name"])
def test_a_stranger_is_not_let_in(robot: Robot, watch: Watch, tmp_path, kind):
    driver = f"driver-{robot.name}"
    other = make_authority(30)
    settings = {
        "none": NO_CERTIFICATE,
        "plain": {
            "connect__endpoints": [f"tcp/127.0.0.1:{robot.port}"],
            "transport__link__protocols": ["tcp"],
        },
        "authority": new_pair(tmp_path / "other", make_certificate(other, driver, days=1)),
        "self": new_pair(tmp_path / "self", other),
        "expired": certified(robot, tmp_path / "expired", driver, days=-0.001),
        "name": {"connect__endpoints": [f"tls/localhost:{robot.port}"]},
    }[kind]
    with watch.unmoved():
        assert "Unable to connect" in refused_at_the_door(robot.config(driver, **settings))


def test_a_certificate_of_an_unknown_name_gets_in_and_nothing_else(robot: Robot, watch: Watch, tmp_path):
    settings = certified(robot, tmp_path / "nobody", "nobody", days=1)
    before = watch.health()
    with watch.unmoved(), robot.open("driver-ur3", **settings) as session:
        channel = zenoh.handlers.FifoChannel(100)
        with session.declare_subscriber("ssm/ur3/zone", channel) as subscriber:
            for source in ("joints", "ranges", "obstacles", "target"):
                send_milder(session, "ur3", source, 5)
            assert answers(session, "ssm/ur3/zone") == []
            assert subscriber.try_recv() is None
        assert list(session.liveliness().get("ssm/*/alive", timeout=1.0)) == []
    assert watch.health()["rejected"] == before["rejected"]


def test_who_is_connected_is_put_out_when_the_certificate_expires(robot: Robot, watch: Watch, tmp_path):
    settings = certified(robot, tmp_path / "short", "viewer-ur3", days=4.0 / 86400)
    with robot.open("viewer-ur3", **settings) as session:
        assert len(session.info.routers_zid()) == 1
        begin = time.monotonic()
        wait_for(lambda: not session.info.routers_zid(), 8.0, "the link's end")
        print(f"put out {time.monotonic() - begin:.1f} s after connecting with 3 to 4 s left")
        # Zenoh goes on trying to come back, and is not let in.
        time.sleep(1.0)
        assert session.info.routers_zid() == []
        assert answers(session, "ssm/ur3/zone", seconds=1.0) == []
    with watch.unmoved():
        pass


@pytest.mark.parametrize(("owner", "let_in"), [("driver-ur3", False), ("service-ur3", True)])
def test_nobody_poses_as_a_service_with_another_roles_certificate(robot: Robot, owner, let_in):
    port = free_port()
    listener = robot.config(
        "service-ur3",
        listen__endpoints=[f"tls/127.0.0.1:{port}"],
        transport__link__tls__listen_certificate=str(robot.keys.path / owner / "own.crt"),
        transport__link__tls__listen_private_key=str(robot.keys.path / owner / "own.key"),
    )
    caller = robot.config("viewer-ur3", connect__endpoints=[f"tls/127.0.0.1:{port}"])
    with zenoh.open(listener):
        if let_in:
            zenoh.open(caller).close()
        else:
            assert "Unable to connect" in refused_at_the_door(caller)


def test_the_evaluating_process_answers_behind_access_control(robot: Robot, watch: Watch):
    question = json.dumps([{"position": [0.0, -1.0, 1.0, 0.0, 0.0, 0.0]}]).encode()
    (found,) = answers(watch.session, "ssm/ur3/evaluate", question)
    assert json.loads(found.payload.to_bytes())[0]["zone"] == "stop"
    assert len(answers(watch.session, "ssm/ur3/frames")) == 1

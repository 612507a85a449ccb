"""What each role can do: its own keys and directions, whatever its program tries."""

from __future__ import annotations

import time

import pytest
import zenoh
from security_kit import Robot, Watch, answers, sealed, send_milder

OUTPUTS = ("zone", "command", "separation")
LIE = b'{"zone":"green"}'
SOURCES = ("joints", "ranges", "obstacles", "target")


@pytest.mark.parametrize(
    ("member", "sources"),
    [("viewer-ur3", SOURCES), ("commander-ur3", SOURCES[:3]), ("driver-ur3", SOURCES[3:])],
)
def test_an_input_of_another_role_never_arrives(robot: Robot, watch: Watch, member, sources):
    before = watch.health()
    with watch.unmoved(), robot.open(member) as session:
        for source in sources:
            send_milder(session, robot.name, source)
        session.delete("ssm/ur3/in/ranges")
        for wide in ("ssm/**", "ssm/*/in/ranges", "ssm/ur3/in/*"):
            session.put(wide, b"x")
    # Not even refused by the service, which would be counted: the link lets nothing through.
    after = watch.health()
    assert after["rejected"] == before["rejected"]
    assert all(zone["producer"] == after["producer"] for zone in watch.heard())


def test_a_commander_can_send_targets(robot: Robot, watch: Watch):
    before = watch.health()["accepted"]["target"]
    with robot.open("commander-ur3") as session:
        send_milder(session, robot.name, "target")
        time.sleep(0.2)
    assert watch.health()["accepted"]["target"] > before


@pytest.mark.parametrize("member", ["viewer-ur3", "commander-ur3", "driver-ur3"])
def test_nobody_else_speaks_as_the_service(robot: Robot, watch: Watch, member):
    with watch.unmoved(), robot.open(member) as session:
        for key in OUTPUTS:
            for seq in range(20):
                payload, attachment = sealed(f"ssm/ur3/{key}", "liar", 10**9 + seq, {"zone": "green"})
                session.put(f"ssm/ur3/{key}", payload, attachment=attachment)
        token = session.liveliness().declare_token("ssm/ghost/alive")
        time.sleep(0.3)
        found = [str(one.key_expr) for one in liveliness(watch.session)]
        token.undeclare()
        assert found == ["ssm/ur3/alive"]
    assert not any("duplicate" in reason for zone in watch.heard() for reason in zone["reasons"])


@pytest.mark.parametrize("member", ["viewer-ur3", "driver-ur3"])
@pytest.mark.parametrize("key", ["ssm/ur3/zone", "ssm/**"])
def test_a_second_queryable_gets_no_question(robot: Robot, watch: Watch, member, key):
    asked = []

    def lie(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        query.reply("ssm/ur3/zone", LIE)

    with watch.unmoved(), robot.open(member) as session:
        queryable = session.declare_queryable(key, lie, complete=True)
        time.sleep(0.2)
        for name in ("zone", "command", "health", "evaluate"):
            replies = watch.ask(name)
            assert len(replies) == 1
            if replies[0].ok is not None:
                assert replies[0].ok.payload.to_bytes() != LIE
        queryable.undeclare()
    assert asked == []


@pytest.mark.parametrize("wide", ["**", "ssm/**", "ssm/ur3/*", "ssm/*/zone"])
def test_a_wider_subscription_or_question_than_permitted_yields_nothing(robot: Robot, wide):
    with robot.open("viewer-ur3") as session:
        with session.declare_subscriber(wide, zenoh.handlers.FifoChannel(100)) as subscriber:
            time.sleep(0.3)
            assert subscriber.try_recv() is None
        assert answers(session, wide, seconds=0.5) == []


@pytest.mark.parametrize(
    ("member", "denied"),
    [("driver-ur3", ("evaluate", "frames", "reset")), ("viewer-ur3", ("reset",))],
)
def test_a_question_of_another_role_is_not_passed_on(robot: Robot, watch: Watch, member, denied):
    asked = watch.health()["queries"]
    with robot.open(member) as session:
        for key in denied:
            assert answers(session, f"ssm/ur3/{key}", b"{}", seconds=1.0) == []
        assert len(answers(session, "ssm/ur3/zone")) == 1
    assert watch.health()["queries"].get("reset", 0) == asked.get("reset", 0)


def liveliness(session: zenoh.Session) -> list[zenoh.Sample]:
    return [one.ok for one in session.liveliness().get("ssm/*/alive", timeout=2.0) if one.ok is not None]


@pytest.mark.parametrize(("member", "heard"), [("commander-ur3", 1), ("viewer-ur3", 0), ("driver-ur3", 0)])
def test_only_a_commander_acknowledges_a_latched_stop(robot: Robot, member, heard):
    with robot.open(member) as session:
        assert len(list(session.get("ssm/ur3/reset", timeout=3.0))) == heard
        assert len(answers(session, "ssm/ur3/separation")) == 1

"""Two robots at one router: a certificate for one gives no say over the other, and a stranger has none."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import zenoh
from security_kit import Robot, Watch, answers, guarded, refused_at_the_door, send_milder

NO_CERTIFICATE = {
    "transport__link__tls__connect_certificate": None,
    "transport__link__tls__connect_private_key": None,
    "transport__link__tls__enable_mtls": False,
}


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("router") / "keys"
    with guarded(folder, router=True, robots=("left", "right")) as robot:
        yield robot


@pytest.fixture
def viewer(left: Robot) -> Iterator[Watch]:
    watch = Watch(left, "viewer")
    try:
        yield watch
    finally:
        watch.close()


def test_a_stranger_does_not_get_to_the_router(left: Robot, viewer: Watch):
    with viewer.unmoved():
        refused_at_the_door(left.config("viewer", **NO_CERTIFICATE))


def test_through_the_router_the_evaluating_process_answers(left: Robot, viewer: Watch):
    assert len(answers(viewer.session, "ssm/left/frames")) == 1


@pytest.mark.parametrize("member", ["viewer", "driver-right", "commander-right", "service-right"])
def test_nobody_drives_or_speaks_for_a_robot_that_is_not_theirs(left: Robot, viewer: Watch, member):
    before = viewer.health()
    asked: list[str] = []

    def lie(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        query.reply("ssm/left/zone", b'{"zone":"green"}')

    with viewer.unmoved(), left.open(member) as session:
        queryable = session.declare_queryable("ssm/left/zone", lie, complete=True)
        token = session.liveliness().declare_token("ssm/left/alive")
        for source in ("joints", "ranges", "obstacles", "target"):
            send_milder(session, "left", source, 5)
        for key in ("zone", "command"):
            session.put(f"ssm/left/{key}", b'{"zone":"green"}')
        time.sleep(0.2)
        assert len(viewer.ask("zone")) == 1
        assert answers(session, "ssm/left/reset", seconds=1.0) == []
        queryable.undeclare()
        token.undeclare()
    after = viewer.health()
    assert asked == []
    assert after["rejected"] == before["rejected"]
    assert not any("duplicate" in reason for zone in viewer.heard() for reason in zone["reasons"])


def test_another_robots_driver_does_not_even_listen(left: Robot):
    with left.open("driver-right") as session:
        with session.declare_subscriber("ssm/left/zone", zenoh.handlers.FifoChannel(100)) as subscriber:
            time.sleep(0.3)
            assert subscriber.try_recv() is None
        assert answers(session, "ssm/left/zone", seconds=1.0) == []


def test_a_second_service_with_the_same_certificate_is_noticed(left: Robot, viewer: Watch):
    """Access control cannot tell two holders of one key apart; the service can."""
    viewer.until_yellow()
    with left.open("service-left") as session:
        end = time.monotonic() + 10.0
        while time.monotonic() < end and not any(
            "duplicate:service" in zone["reasons"] for zone in viewer.heard()
        ):
            session.put("ssm/left/zone", b'{"producer":"x","seq":1,"zone":"green","reasons":[]}')
            time.sleep(0.02)
    ours = viewer.health()["producer"]
    noticed = [zone for zone in viewer.heard() if zone["producer"] == ours]
    assert any("duplicate:service" in zone["reasons"] and zone["zone"] == "stop" for zone in noticed)
    viewer.until_yellow()

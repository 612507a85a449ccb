"""Too much of everything, from outside and from one who has a certificate: bounded, on loopback."""

from __future__ import annotations

import contextlib
import socket
import time

import zenoh
from security_kit import Robot, Watch, answers, wait_for

MB = 1_000_000
BLOCK = zenoh.CongestionControl.BLOCK


def test_what_is_too_long_ends_at_the_door(robot: Robot, watch: Watch):
    before, memory = watch.health()["rejected"], robot.service.memory()
    with watch.unmoved(), robot.open("driver-ur3") as session:
        for size in (70_000, 1 * MB, 8 * MB):
            for _ in range(5):
                session.put("ssm/ur3/in/ranges", b"x" * size, congestion_control=BLOCK)
        for key in ("zone", "command", "health"):
            assert answers(session, f"ssm/ur3/{key}", b"x" * 100_000, seconds=1.0) == []
    with robot.open("commander-ur3") as session:
        assert answers(session, "ssm/ur3/evaluate", b"x" * 5 * MB, seconds=1.0) == []
    # None of it came as far as being refused by the service, which would have been a stop.
    assert watch.health()["rejected"] == before
    grown = robot.service.memory() - memory
    print(f"memory grew by {grown / MB:.1f} MB")
    assert grown < 64 * MB


def test_many_keys_cost_no_memory_that_grows_with_them(robot: Robot, watch: Watch):
    memory = robot.service.memory()
    with watch.unmoved(), robot.open("driver-ur3") as session:
        for number in range(10_000):
            session.put(f"ssm/ur3/in/joints{number}", b"x", congestion_control=BLOCK)
        for number in range(500):
            session.declare_subscriber(f"ssm/ur3/zone{number}", zenoh.handlers.RingChannel(1))
        for number in range(500):
            session.declare_keyexpr(f"ssm/ur3/{'y' * 200}/{number}")
    grown = robot.service.memory() - memory
    print(f"memory grew by {grown / MB:.1f} MB")
    assert grown < 64 * MB


def test_sessions_beyond_the_limit_are_refused(robot: Robot, watch: Watch):
    sessions: list[zenoh.Session] = []
    with watch.unmoved():
        try:
            with contextlib.suppress(zenoh.ZError):
                while len(sessions) < 70:
                    config = robot.config("viewer-ur3", connect__timeout_ms=1000)
                    sessions.append(zenoh.open(config))
            print(f"{len(sessions)} sessions")
            assert len(sessions) <= 64
        finally:
            for session in sessions:
                session.close()


def test_half_open_connections_harm_nobody_who_is_in(robot: Robot, watch: Watch):
    with watch.unmoved():
        strangers = [socket.create_connection(("127.0.0.1", robot.port), 1.0) for _ in range(30)]
        time.sleep(1.0)
        robot.open("viewer-ur3").close()  # while they wait, others still get in
        for stranger in strangers:
            stranger.close()
    # Each failed handshake holds Zenoh's door shut for 100 ms: see docker/README.md.
    begin = time.monotonic()

    def let_in() -> bool:
        try:
            robot.open("viewer-ur3").close()
        except zenoh.ZError:
            return False
        return True

    wait_for(let_in, 40.0, "the door is open again")
    print(f"a newcomer was let in {time.monotonic() - begin:.1f} s after 30 failed handshakes")
    with watch.unmoved():
        pass

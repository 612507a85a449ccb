"""The watched stream against real processes. Ages are true: stamps are from the shared monotonic clock."""

import itertools
import json
import os
import signal
import time
from pathlib import Path

import pytest

from ssm_service.client import Client
from ssm_service.safety import Zone

MS = 1_000_000
VALID_NS = 40 * MS
HERE = Path(__file__).parent


class Watching:
    """A running stream, and every yield with its time."""

    def __init__(self, client):
        self.stream = client.stream()
        self.yields = []

    def until(self, wanted, seconds=10.0):
        """Consume until a yield is wanted; return its time [ns] and itself."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            followed = next(self.stream)
            self.yields.append((time.monotonic_ns(), followed))
            if wanted(followed):
                return self.yields[-1]
        pytest.fail(f"not within {seconds} s; the last was {self.yields[-1][1] if self.yields else 'none'}")

    def during(self, seconds):
        end, first = time.monotonic() + seconds, len(self.yields)
        self.until(lambda _: time.monotonic() >= end)
        return [followed for _, followed in self.yields[first:]]


def valid(followed):
    return not followed.stopped_by_consumer


def own_stop(followed):
    return followed.stopped_by_consumer


def said(reason):
    return lambda followed: followed.stopped_by_consumer and followed.reasons == (reason,)


@pytest.fixture
def client(endpoint):
    with Client("arm", connect=(endpoint,)) as client:
        yield client


@pytest.fixture
def watching(client):
    watching = Watching(client)
    yield watching
    watching.stream.close()


def assert_standing_still(followed):
    assert followed.zone is Zone.STOP
    assert not any(followed.velocity)
    assert not any(followed.speed_limit)
    assert len(followed.velocity) == len(followed.speed_limit) == len(followed.name)


def test_without_a_service_it_waits_and_says_so_ten_times_a_second(watching):
    begin = time.monotonic()
    first = next(watching.stream)
    assert time.monotonic() - begin < 1.0
    assert said("waiting:service")(first)
    all_of_them = watching.during(1.5)
    assert {followed.reasons for followed in all_of_them} == {("waiting:service",)}
    assert 5 <= len(all_of_them) <= 20
    for followed in all_of_them:
        assert_standing_still(followed)


def test_a_service_that_comes_later_is_found(watching, pretended):
    watching.during(0.3)
    pretended()
    _, followed = watching.until(valid)
    assert followed.zone is Zone.GREEN
    assert followed.name == ("shoulder", "elbow", "wrist")
    assert followed.velocity == (0.5, 0.5, 0.5)
    assert followed.speed_limit == (1.0, 1.0, 1.0)
    assert followed.zone_message.seq == followed.command_message.seq


def test_every_decision_comes_once_in_order_and_young(watching, pretended):
    pretended()
    watching.until(valid)
    watching.during(1.0)
    good = [(now, f) for now, f in watching.yields if valid(f)]
    seqs = [f.zone_message.seq for _, f in good]
    assert len(seqs) > 100
    assert all(a < b for a, b in itertools.pairwise(seqs))
    in_time = [(now, f) for now, f in good if now < f.expires_ns]
    assert len(in_time) > 0.99 * len(good)  # the test itself may be held up between the yield and the clock
    assert max(now - f.zone_message.stamp_ns for now, f in in_time) < VALID_NS + 20 * MS


def test_kill_9_stops_in_time_and_the_restarted_service_is_followed(watching, pretended):
    delays = []
    for number in range(3):
        service = pretended(producer=f"start{number}")
        _, followed = watching.until(valid)
        assert followed.zone_message.producer == f"start{number}"
        watching.during(0.2)
        watching.until(valid)
        killed = service.kill()
        stopped, followed = watching.until(own_stop)
        assert followed.reasons == ("stale:service",)
        assert_standing_still(followed)
        delays.append((stopped - killed) / MS)
        last = max(f.expires_ns for _, f in watching.yields if valid(f))
        assert last <= killed + VALID_NS + 20 * MS  # whatever the scheduler did to this process
        watching.during(0.2)
        assert own_stop(watching.yields[-1][1])
    # The scheduler of a busy machine may spoil one of them, not all.
    assert min(delays) <= VALID_NS / MS + 20
    assert max(delays) <= VALID_NS / MS + 250


def test_a_frozen_service_stops_it_and_what_it_said_before_is_not_believed_after(watching, pretended):
    service = pretended()
    watching.until(valid)
    watching.during(0.2)
    service.process.send_signal(signal.SIGSTOP)
    frozen = time.monotonic_ns()
    stopped, _ = watching.until(own_stop)
    assert stopped - frozen < VALID_NS + 250 * MS
    watching.during(1.0)
    resumed = time.monotonic_ns()
    service.process.send_signal(signal.SIGCONT)
    _, followed = watching.until(valid)
    assert followed.zone_message.stamp_ns >= resumed


def test_a_delay_that_grows_by_little_with_every_message_is_a_stop(watching, pretended):
    """By half a millisecond a tick of 2.5 ms: after three seconds messages are half a second old."""
    service = pretended()
    watching.until(valid)
    begin = len(watching.yields)
    service.wish(creep_s=0.0005)
    watching.during(3.0)
    found = watching.yields[begin:]
    ages = [now - f.zone_message.stamp_ns for now, f in found if valid(f) and now < f.expires_ns]
    assert len(ages) > 50
    # In the 0.1 s from one renewal to the next the delay grows by 17 ms.
    assert max(ages) < VALID_NS + 17 * MS + 40 * MS
    late = [f for now, f in found if now > found[-1][0] - 1000 * MS]
    assert late
    assert all(map(own_stop, late))


@pytest.mark.parametrize("patient", [False, True], ids=["link_lost", "backlog_in_the_sockets"])
def test_a_frozen_consumer_never_yields_what_waited_for_it(spawn, pretended, endpoint, tmp_path, patient):
    file = tmp_path / "yields.json"
    words = [endpoint, 4.5, file]
    if patient:
        # Zenoh's own values: the link outlives the pause, and sockets hold a second and more of decisions.
        config = {
            "mode": "client",
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        }
        words.append(tmp_path / "zenoh.json5")
        words[-1].write_text(json.dumps(config))
    pretended(**({"patient": True} if patient else {}))
    consumer = spawn(HERE / "consumer_process.py", *words)
    time.sleep(1.0)
    os.kill(consumer.process.pid, signal.SIGSTOP)
    time.sleep(2.0)
    resumed = time.monotonic_ns()
    os.kill(consumer.process.pid, signal.SIGCONT)
    assert consumer.process.wait(20) == 0
    rows = json.loads(file.read_text())
    before = [row for row in rows if row["now"] < resumed]
    after = [row for row in rows if row["now"] >= resumed]
    assert sum(not row["own"] for row in before) > 50
    # What was under way when the process was stopped expired meanwhile, and says so by its own time.
    acted_on = [row for row in after if not row["own"] and row["now"] < row["expires"]]
    assert sum(not row["own"] for row in after) - len(acted_on) <= 3
    assert after[0]["own"] or after[0]["now"] >= after[0]["expires"]
    assert len(acted_on) > 50
    assert acted_on[0]["stamp"] >= resumed
    everything = [row for row in rows if not row["own"] and row["now"] < row["expires"]]
    assert max(row["now"] - row["stamp"] for row in everything) < VALID_NS + 20 * MS
    assert not any(row["moving"] for row in rows if row["own"])


def test_two_services_at_once_are_a_stop(watching, pretended):
    pretended(producer="first")
    watching.until(valid)
    second = pretended(listen=False, producer="second", mute=True)
    watching.until(said("duplicate:service"))
    during = watching.during(0.5)
    assert not any(map(valid, during[1:]))
    assert ("duplicate:service",) in {followed.reasons for followed in during}
    second.kill()
    watching.until(valid)
    assert not any(own_stop(followed) for followed in watching.during(0.5)[-5:])


def test_two_services_that_both_answer_are_a_stop_from_the_start(watching, pretended):
    pretended(producer="first")
    pretended(listen=False, producer="second")
    watching.until(said("duplicate:service"))
    assert not any(map(valid, watching.during(0.5)))


@pytest.mark.parametrize(
    "fault",
    [
        "encoding",
        "json",
        "robot",
        "length",
        "mismatch",
        "unknown_field",
        "infinite",
        "repeat",
        "backward",
        "delete",
    ],
)
def test_what_is_not_right_never_refreshes(client, watching, pretended, fault):
    service = pretended()
    watching.until(valid)
    service.wish(fault=fault)
    stopped, followed = watching.until(own_stop)
    assert followed.reasons in {("invalid:service",), ("stale:service",)}
    good = [f for now, f in watching.yields if valid(f)]
    assert stopped >= good[-1].expires_ns
    assert stopped - good[-1].zone_message.stamp_ns < VALID_NS + 250 * MS
    assert not any(map(valid, watching.during(0.4)))
    service.wish(fault=None)
    watching.until(valid)


def test_without_an_answer_to_the_query_nothing_is_believed(watching, pretended):
    pretended(mute=True)
    assert not any(map(valid, watching.during(2.0)))


def test_a_stop_is_obeyed_at_once_also_without_its_command(watching, pretended):
    service = pretended()
    watching.until(valid)
    service.wish(zone="stop", command=False)
    _, followed = watching.until(lambda followed: followed.zone is Zone.STOP)
    assert valid(followed)
    assert followed.reasons == ("distance",)
    assert followed.command_message is None
    assert_standing_still(followed)
    last_green = [f for _, f in watching.yields if f.zone is Zone.GREEN][-1].zone_message
    assert 0 < followed.zone_message.seq - last_green.seq < 20
    assert all(followed.zone is Zone.STOP for followed in watching.during(0.3))
    service.wish(zone="green", command=True)
    watching.until(lambda followed: followed.zone is Zone.GREEN)


def test_a_slow_consumer_is_given_a_stop_after_each_delay(watching, pretended):
    pretended()
    for _ in range(3):
        watching.until(valid)
        time.sleep(3 * VALID_NS / 1e9)
        assert own_stop(next(watching.stream))


def test_polling_costs_little(client, pretended):
    pretended()
    follower = client.follower()
    durations = []
    for _ in range(2000):
        begin = time.perf_counter_ns()
        follower.poll()
        durations.append(time.perf_counter_ns() - begin)
        time.sleep(0.002)
        if len(durations) > 500 and follower.watchdog.proved:
            break
    follower.close()
    assert sorted(durations)[len(durations) // 2] < 500_000


@pytest.mark.parametrize(("fault", "cause"), [("corrupt", "corrupt"), ("no_crc", "missing_crc")])
def test_what_is_changed_on_its_way_is_a_stop_and_a_latch_holds_it(pretended, endpoint, fault, cause):
    service = pretended()
    with Client("arm", connect=(endpoint,), latch=600.0) as client:
        watching = Watching(client)
        watching.until(valid)
        service.wish(fault=fault)
        word = {"corrupt": "corruption", "no_crc": "masquerade"}[fault]
        _, stop = watching.until(said(f"latched:{word}"))
        assert_standing_still(stop)
        service.wish(fault=None)
        assert all(said(f"latched:{word}")(followed) for followed in watching.during(0.3))
        assert client.acknowledge().startswith(f"{word} on arm, ")
        watching.until(valid)
        assert client.acknowledge() is None
        watching.stream.close()


def test_a_client_without_a_latch_has_nothing_to_acknowledge(client):
    assert client.acknowledge() is None


def test_a_stream_sends_echoes_to_the_service_unless_told_not_to(pretended, endpoint):
    pretended()
    echoes = []
    with Client("arm", connect=(endpoint,)) as client, Client("arm", connect=(endpoint,), echo=False) as mute:
        session = client.connection.wait(5.0)
        with session.declare_subscriber("ssm/arm/in/echo", lambda sample: echoes.append(sample)):
            silent = Watching(mute)
            silent.until(valid)
            silent.during(0.3)
            assert echoes == []
            watching = Watching(client)
            watching.until(valid)
            watching.during(0.6)
            silent.stream.close()
            watching.stream.close()
    first = json.loads(echoes[0].payload.to_string())
    assert (first["service"], first["seq"]) == ("first", 0)
    assert 2 <= len(echoes) <= 12
    assert echoes[0].attachment.to_string().startswith("crc32=")

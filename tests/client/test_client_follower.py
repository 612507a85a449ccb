"""The follower between its channels and its clock, with both in the test's hands."""

from collections import deque
from types import SimpleNamespace

import msgspec
import pytest
import zenoh

from ssm_service.client import Follower
from ssm_service.client.echoing import Echoing
from ssm_service.client.follower import RENEW_NS
from ssm_service.client.roundtrip import Answers
from ssm_service.errors import InputError
from ssm_service.wire import Heard, Keys, opened
from ssm_service.wire import messages as m

MS = 1_000_000
VALID_NS = 20 * MS
COMMON = {
    "producer": "p",
    "stamp_ns": 0,
    "valid_for_ns": VALID_NS,
    "robot": "arm",
    "zone": "green",
    "name": ["a"],
}


def zone(seq, producer="p"):
    return m.Zone(
        **{**COMMON, "producer": producer},
        seq=seq,
        profile="test",
        distance=None,
        speed_limit=[1.0],
        speed_scaling=1.0,
        nearest=None,
        sources={},
        reaction=None,
        reasons=[],
    )


def command(seq):
    return m.VelocityCommand(**COMMON, seq=seq, velocity=[0.1])


class Channel:
    def __init__(self):
        self.waiting = deque()
        self.endless = None

    def receive(self):
        return self.endless or (self.waiting.popleft() if self.waiting else None)

    def decode(self, sample):
        if isinstance(sample, bytes):
            raise InputError("not_json", "payload", sample, "JSON")
        return sample


class Trip:
    def __init__(self):
        self.answers = None
        self.unanswered = False
        self.heard = None
        self.asked = 0
        self.restarts = 0
        self.took_ns = 0

    def restart(self, _now):
        self.restarts += 1

    def step(self, now, heard):
        self.asked += 1
        self.given = heard
        return self.answers and Answers(zones=self.answers, asked_ns=now - self.took_ns, heard=self.heard)


class Bench:
    """A proved follower at time 0, polled every 2 ms of the test's own time."""

    def __init__(self):
        self.follower = Follower(None, Keys("arm"))
        self.zones, self.commands, self.trip = Channel(), Channel(), Trip()
        self.follower._channels = (self.zones, self.commands)
        self.follower._trip = self.trip
        self.follower._polled_ns = self.follower._empty_ns = 0
        self.trip.answers = (zone(10),)

    def send(self, *seqs):
        for seq in seqs:
            self.zones.waiting.append(zone(seq))
            self.commands.waiting.append(command(seq))


@pytest.fixture
def bench():
    bench = Bench()
    assert bench.follower.poll(0).stopped_by_consumer
    assert bench.follower.watchdog.proved
    return bench


def test_a_message_is_as_old_as_the_last_sight_of_its_empty_channel(bench):
    bench.follower.poll(2 * MS)
    bench.send(11)
    assert bench.follower.poll(8 * MS).expires_ns == 2 * MS + VALID_NS


def test_one_channel_seen_empty_is_not_both(bench):
    bench.zones.waiting.append(zone(11))
    bench.commands.waiting.append(command(11))
    bench.commands.endless = command(11)
    bench.follower.poll(2 * MS)
    bench.commands.endless = None
    bench.send(12)
    assert bench.follower.poll(4 * MS).expires_ns == 0 + VALID_NS


def test_after_a_longish_gap_an_empty_channel_proves_only_the_poll_before(bench):
    bench.follower.poll(2 * MS)
    bench.follower.poll(2 * MS + 15 * MS)
    bench.send(11)
    assert bench.follower.poll(18 * MS).expires_ns == 2 * MS + VALID_NS


@pytest.mark.parametrize("gap", [VALID_NS + 1, 2000 * MS, -1])
def test_after_a_pause_the_backlog_is_dropped_and_the_proof_asked_for_anew(bench, gap):
    bench.send(11)
    assert not bench.follower.poll(2 * MS).stopped_by_consumer
    bench.send(12, 13)
    bench.trip.answers = None
    before = bench.trip.restarts
    assert bench.follower.poll(2 * MS + gap).stopped_by_consumer
    assert bench.trip.restarts == before + 1
    bench.send(14)
    assert bench.follower.poll(3 * MS + gap).stopped_by_consumer
    bench.trip.answers = (zone(14),)
    bench.send(14)
    assert bench.follower.poll(4 * MS + gap).stopped_by_consumer
    bench.send(15)
    followed = bench.follower.poll(5 * MS + gap)
    assert followed.zone_message.seq == 15
    assert followed.expires_ns == 4 * MS + gap + VALID_NS


def test_what_came_before_the_proof_is_passed_over_only_until_something_later_has_come(bench):
    bench.zones.waiting += [zone(9), zone(10)]  # still under way when tick 10 was the answer
    bench.follower.poll(2 * MS)
    assert not bench.follower.watchdog.rejected
    bench.send(11)
    bench.zones.waiting.append(zone(10))
    assert not bench.follower.poll(4 * MS).stopped_by_consumer
    assert bench.follower.watchdog.rejected == {"old_seq": 1}


def test_a_pause_hides_nothing_that_is_wrong_with_what_waited(bench):
    bench.send(11)
    bench.follower.poll(2 * MS)
    bench.zones.waiting += [b"nonsense", msgspec.structs.replace(zone(12), robot="another"), zone(13)]
    bench.commands.waiting += [b"nonsense"]
    assert bench.follower.poll(2000 * MS).reasons == ("invalid:service",)
    assert bench.follower.watchdog.rejected == {"not_json": 2, "wrong_robot": 1}
    assert bench.follower.watchdog.integrity_errors == {"addressing": 1}
    assert bench.follower.heard.seq == 11  # what is right with it is dropped all the same


def test_a_flood_neither_holds_up_a_poll_nor_refreshes(bench):
    bench.send(11)
    bench.follower.poll(2 * MS)
    bench.zones.endless = b"nonsense"
    followed = [bench.follower.poll(now * MS) for now in range(3, 30)]
    assert followed[-1].reasons == ("invalid:service",)
    assert bench.follower.watchdog.rejected["not_json"] < 27 * 200


def test_after_a_pause_even_an_endless_backlog_does_not_hold_up_the_poll(bench):
    bench.zones.endless = zone(11)
    bench.trip.answers = None
    assert bench.follower.poll(2000 * MS).stopped_by_consumer
    assert bench.trip.restarts == 1


def test_two_answers_of_two_producers_are_a_stop(bench):
    bench.follower.watchdog.forget()
    bench.trip.answers = (zone(10), zone(77, producer="q"))
    bench.send(11)
    assert bench.follower.poll(2 * MS).reasons == ("duplicate:service",)


def test_a_steady_stream_is_followed_and_its_proof_renewed_ten_times_a_second(bench):
    asked = bench.trip.asked
    for tick in range(11, 1011):
        bench.send(tick)
        bench.trip.answers = (zone(tick),)
        assert bench.follower.poll(2 * MS * (tick - 10)).zone_message.seq == tick
    assert bench.trip.asked == asked + 2.0 / (RENEW_NS * 1e-9)
    assert bench.follower.watchdog.rejected == {}


@pytest.mark.parametrize("each", [0.02, 0.25, 0.9, 3.0])
def test_a_delay_that_grows_too_slowly_for_any_gap_is_a_stop(bench, each):
    """Each tick comes a little later than the one before; ``each``: by so many ms."""
    oldest, stopped, sent = 0.0, None, 11
    for now in range(2, 6000, 2):
        newest = 10 + now // 2
        # tick n was decided at 2 (n - 10) ms and comes ``each`` (n - 10) later
        while (sent - 10) * (2 + each) <= now:
            bench.send(sent)
            sent += 1
        bench.trip.answers = (zone(newest),)
        said = bench.follower.poll(now * MS)
        if said.stopped_by_consumer:
            stopped = now if stopped is None and now > 10 else stopped
        else:
            oldest = max(oldest, now - 2.0 * (said.zone_message.seq - 10))
            stopped = None if oldest < 20 else stopped
    assert stopped is not None
    renewal = 2.0 + RENEW_NS / MS
    assert oldest <= 20 + 2 + renewal * each / (2 + each) + each
    assert bench.follower.watchdog.rejected == {}


def test_a_proof_that_nobody_renews_lasts_a_second(bench):
    bench.trip.answers = None
    held = []
    for tick in range(11, 800):
        bench.send(tick)
        held.append(not bench.follower.poll(2 * MS * (tick - 10)).stopped_by_consumer)
    assert held == [True] * 499 + [False] * (len(held) - 499)


def test_a_renewal_by_another_service_ends_the_proof(bench):
    bench.trip.answers = (zone(99, producer="q"),)
    for tick in range(11, 200):
        bench.send(tick)
        said = bench.follower.poll(2 * MS * (tick - 10))
        assert said.stopped_by_consumer == (tick >= 60)


def test_a_renewal_by_two_services_is_a_stop_and_a_malformed_one_is_refused(bench):
    bench.trip.answers = (zone(10), zone(77, producer="q"))
    for tick in range(11, 60):
        bench.send(tick)
        assert not bench.follower.poll(2 * MS * (tick - 10)).stopped_by_consumer
    bench.trip.answers = (zone(60), zone(77, producer="q"))
    bench.send(60)
    assert bench.follower.poll(100 * MS).reasons == ("duplicate:service",)
    bench.trip.heard = Heard("p", 200)
    refused, refuse = [], bench.follower.watchdog.refuse

    def watched(error, now):
        refused.append((error.cause, now))
        refuse(error, now)

    bench.follower.watchdog.refuse = watched
    for tick in range(61, 112):
        bench.trip.answers = (zone(tick),)
        bench.send(tick)
        bench.follower.poll(2 * MS * (tick - 10))
    assert bench.follower.watchdog.rejected == {"old_seq": 1}
    assert refused == [("old_seq", 200 * MS)]
    assert bench.trip.given == Heard("p", 109)


def test_a_closed_session_is_a_stop_and_no_error(bench):
    def closed():
        raise zenoh.ZError("closed")

    bench.send(11)
    assert not bench.follower.poll(2 * MS).stopped_by_consumer
    bench.zones.receive = bench.commands.receive = closed
    assert bench.follower.poll(10 * MS).zone_message.seq == 11
    assert bench.follower.poll(2 * MS + VALID_NS).stopped_by_consumer


class Session:
    """A session whose one publisher keeps what is put, until it is closed."""

    def __init__(self):
        self.put = []
        self.closed = self.undeclared = False

    def declare_publisher(self, key, *, encoding, **_):
        def put(payload, *, attachment):
            if self.closed:
                raise zenoh.ZError("closed")
            self.put.append((key, encoding, payload, attachment))

        def undeclare():
            self.undeclared = True

        return SimpleNamespace(put=put, undeclare=undeclare)


@pytest.fixture
def session():
    return Session()


@pytest.fixture
def echoing(bench, session, monkeypatch):
    """A follower that sends echoes by the test's own clock."""
    clock = SimpleNamespace(now=10**9)
    monkeypatch.setattr("ssm_service.client.echoing.time.monotonic_ns", lambda: clock.now)
    bench.follower._echoing = Echoing(session, Keys("arm"))
    bench.clock = clock
    return bench


def sent(session):
    echoes = []
    for key, encoding, payload, attachment in session.put:
        echo = msgspec.json.decode(payload, type=m.Echo)
        assert (key, encoding) == ("ssm/arm/in/echo", "application/json;ssm.Echo/1")
        opened(key, echo.producer, echo.seq, payload, attachment, required=True)
        echoes.append(echo)
    return echoes


def test_what_was_heard_is_named_for_drivers(bench):
    assert bench.follower.heard is None
    bench.send(11, 12)
    bench.follower.poll(2 * MS)
    assert bench.follower.heard == Heard("p", 12)
    bench.zones.waiting.append(zone(12))  # refused
    bench.follower.poll(4 * MS)
    assert bench.follower.heard == Heard("p", 12)


def test_the_newest_zone_is_echoed_ten_times_a_second(echoing, session):
    for tick in range(11, 511):
        echoing.send(tick)
        echoing.follower.poll(2 * MS * (tick - 10))
        echoing.clock.now += 2 * MS
    echoes = sent(session)
    assert len(echoes) == 10
    assert [echo.seq for echo in echoes] == list(range(10))
    assert {echo.producer for echo in echoes} == {echoes[0].producer}
    assert {echo.service for echo in echoes} == {"p"}
    assert [echo.tick for echo in echoes] == [11 + 50 * index for index in range(10)]
    assert {echo.held_ns for echo in echoes} == {0}


def test_an_echo_says_how_long_it_was_held_and_is_sent_once(echoing, session):
    echoing.send(11)
    echoing.follower.poll(2 * MS)
    echoing.clock.now += 3 * MS
    echoing.send(12)
    echoing.follower.poll(4 * MS)
    echoing.clock.now += 97 * MS
    for poll in range(6, 20):
        echoing.follower.poll(poll * MS)
        echoing.clock.now += 200 * MS
    assert [(echo.tick, echo.held_ns) for echo in sent(session)] == [(11, 0), (12, 97 * MS)]


def test_nothing_is_echoed_before_anything_was_heard_or_once_the_session_is_closed(echoing, session):
    echoing.follower.poll(2 * MS)
    session.closed = True
    echoing.send(11)
    assert not echoing.follower.poll(4 * MS).stopped_by_consumer
    assert session.put == []
    channels = (SimpleNamespace(close=lambda: None),) * 2
    echoing.follower._channels = channels
    echoing.follower.close()
    assert session.undeclared
    echoing.follower.close()


def test_an_answer_that_is_older_than_what_was_heard_before_the_question_proves_nothing(bench):
    bench.follower.watchdog.forget()
    bench.trip.heard = Heard("p", 11)
    bench.trip.answers = (zone(10),)
    bench.send(12)
    assert bench.follower.poll(2 * MS).stopped_by_consumer
    assert not bench.follower.watchdog.proved
    assert bench.follower.watchdog.rejected == {"old_seq": 1}
    assert bench.follower.watchdog.integrity_errors == {"repetition": 1}
    bench.trip.answers = (zone(12),)
    bench.send(13)
    assert bench.follower.poll(4 * MS).zone_message.seq == 13


@pytest.mark.parametrize("heard", [None, Heard("p", 10), Heard("another", 99)])
def test_an_answer_as_new_as_what_was_heard_or_of_a_new_service_proves_the_ages(bench, heard):
    bench.follower.watchdog.forget()
    bench.trip.heard = heard
    bench.trip.answers = (zone(10),)
    bench.follower.poll(2 * MS)
    assert bench.follower.watchdog.proved


def test_an_answer_that_took_as_long_as_a_message_is_valid_proves_nothing(bench):
    bench.follower.watchdog.forget()
    bench.trip.took_ns = VALID_NS
    bench.send(11)  # whoever held the answer back may have held this as well
    assert bench.follower.poll(2 * MS).stopped_by_consumer
    assert not bench.follower.watchdog.proved
    bench.trip.took_ns = VALID_NS - 1
    bench.send(12)
    assert bench.follower.poll(4 * MS).zone_message.seq == 12

"""The follower on a whole session of the test's own: what it subscribes to, asks, sends back and gives up."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace

import msgspec
import pytest
import zenoh

from ssm_service.client import Follower, follower
from ssm_service.client.connection import Connection
from ssm_service.client.followed import decision, own_stop, service_stop
from ssm_service.client.roundtrip import TIMEOUT_NS
from ssm_service.safety import Zone
from ssm_service.wire import Heard, Keys, encoding_of
from ssm_service.wire import messages as m
from ssm_service.wire.integrity import seal

MS = 1_000_000
VALID_NS = 20 * MS
COMMON = {"producer": "p", "stamp_ns": 0, "valid_for_ns": VALID_NS, "robot": "arm", "name": ["a"]}


def zone(seq, word="green", reasons=()):
    return m.Zone(
        **COMMON,
        seq=seq,
        zone=word,
        profile="test",
        distance=None,
        speed_limit=[1.0],
        speed_scaling=1.0,
        nearest=None,
        sources={},
        reaction=None,
        reasons=list(reasons),
    )


def command(seq, word="green"):
    return m.VelocityCommand(**COMMON, seq=seq, zone=word, velocity=[0.1])


def sample(key, message):
    payload = msgspec.json.encode(message)
    sealed = seal(key, message.producer, message.seq, payload)
    return SimpleNamespace(
        kind=zenoh.SampleKind.PUT,
        encoding=encoding_of(type(message)),
        payload=SimpleNamespace(to_bytes=lambda: payload),
        attachment=SimpleNamespace(to_bytes=lambda: sealed),
    )


class Handler:
    """What waits on a subscription or for a query."""

    def __init__(self):
        self.waiting = deque()
        self.endless = None
        self.ended = False
        self.received = 0

    def try_recv(self):
        self.received += 1
        if self.ended:
            raise zenoh.ZError("ended")
        return self.endless or (self.waiting.popleft() if self.waiting else None)


class Session:
    """A session that keeps what is declared, asked and put."""

    def __init__(self):
        self.subscribed, self.published, self.asked = {}, {}, []
        self.undeclared, self.put = [], []
        self.closed = False
        self.answer = None

    def is_closed(self):
        return self.closed

    def declare_subscriber(self, key, ring):
        assert isinstance(ring, zenoh.handlers.RingChannel)
        self.subscribed[key] = Handler()
        return SimpleNamespace(handler=self.subscribed[key], undeclare=lambda: self.undeclared.append(key))

    def declare_publisher(self, key, **options):
        self.published[key] = options
        put = lambda payload, *, attachment: self.put.append((key, payload, attachment))  # noqa: E731
        return SimpleNamespace(put=put, undeclare=lambda: self.undeclared.append(key))

    def get(self, key, _channel, **_options):
        replies = Handler()
        if self.answer is not None:
            replies.waiting.append(SimpleNamespace(ok=sample(key, self.answer), err=None))
        self.asked.append((key, replies))
        return replies

    def send(self, *seqs, word="green"):
        for seq in seqs:
            self.subscribed["ssm/arm/zone"].waiting.append(sample("ssm/arm/zone", zone(seq, word)))
            self.subscribed["ssm/arm/command"].waiting.append(sample("ssm/arm/command", command(seq, word)))


class Link(Connection):
    """A connection whose session the test replaces."""

    def __init__(self, session):
        self.given = session
        self.said = []

    @property
    def session(self):
        return self.given

    def answered(self):
        self.said.append("answered")

    def unanswered(self, session):
        self.said.append(session)


@pytest.fixture
def session():
    session = Session()
    session.answer = zone(10)
    return session


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now=0, later=0)

    def monotonic_ns():
        clock.now += clock.later
        return clock.now

    monkeypatch.setattr(follower, "time", SimpleNamespace(monotonic_ns=monotonic_ns))
    return clock


@pytest.fixture
def proved(session, clock):
    """A follower whose ages are proved from 2 ms on."""
    made = Follower(session, Keys("arm"))
    for now in (0, 1 * MS, 2 * MS):
        assert made.poll(now).stopped_by_consumer
    assert made.watchdog.proved
    return made


def test_it_subscribes_asks_and_follows(proved, session):
    assert list(session.subscribed) == ["ssm/arm/zone", "ssm/arm/command"]
    assert [key for key, _ in session.asked] == ["ssm/arm/zone"]
    session.send(11)
    followed = proved.poll(4 * MS)
    assert followed.zone_message.seq == followed.command_message.seq == 11
    assert followed.expires_ns == 2 * MS + VALID_NS
    assert proved.heard == Heard("p", 11)


def test_it_sends_back_what_it_hears_unless_it_shall_not(proved, session, clock):
    assert session.published["ssm/arm/in/echo"] == {
        "encoding": "application/json;ssm.Echo/1",
        "express": True,
        "priority": zenoh.Priority.REAL_TIME,
        "congestion_control": zenoh.CongestionControl.DROP,
    }
    session.send(11)
    proved.poll(4 * MS)
    ((key, payload, _),) = session.put
    echo = msgspec.json.decode(payload, type=m.Echo)
    assert (key, echo.service, echo.tick, echo.seq) == ("ssm/arm/in/echo", "p", 11, 0)
    quiet = Session()
    Follower(quiet, Keys("arm"), echo=False).poll(0)
    assert quiet.subscribed
    assert not quiet.published


def test_a_closed_session_is_not_attached_to(clock):
    session = Session()
    session.closed = True
    made = Follower(session, Keys("arm"))
    assert made.poll(0).reasons == ("waiting:service",)
    assert not session.subscribed
    session.closed = False
    made.poll(1)
    assert session.subscribed
    assert not session.undeclared


def test_a_session_that_was_replaced_is_given_up_with_all_that_it_said(session, clock):
    link = Link(session)
    made = Follower(link, Keys("arm"))
    for now in (0, 1 * MS, 2 * MS):
        made.poll(now)
    session.send(11)
    assert not made.poll(4 * MS).stopped_by_consumer
    assert session.undeclared == []
    link.given = other = Session()
    other.answer = zone(11)
    assert made.poll(6 * MS).stopped_by_consumer
    assert session.undeclared == ["ssm/arm/zone", "ssm/arm/command", "ssm/arm/in/echo"]
    assert not made.watchdog.proved
    for now in (7 * MS, 8 * MS):
        made.poll(now)
    other.send(12)
    assert made.poll(9 * MS).zone_message.seq == 12
    link.given = None
    assert made.poll(10 * MS).stopped_by_consumer


def test_a_session_that_cannot_be_given_up_any_more_is_no_error(session, clock):
    link = Link(session)
    made = Follower(link, Keys("arm"))
    made.poll(0)

    def broken():
        raise zenoh.ZError("closed")

    made._channels[0]._subscriber.undeclare = broken
    link.given = None
    assert made.poll(1).stopped_by_consumer


def test_closed_it_starts_anew_with_the_next_poll(proved, session):
    proved.close()
    assert session.undeclared == ["ssm/arm/zone", "ssm/arm/command", "ssm/arm/in/echo"]
    session.subscribed.clear()
    session.undeclared.clear()
    proved.poll(3 * MS)
    assert list(session.subscribed) == ["ssm/arm/zone", "ssm/arm/command"]
    assert session.undeclared == []


def test_a_connection_is_told_whether_somebody_answered(session, clock):
    answer, session.answer = session.answer, None
    link = Link(session)
    made = Follower(link, Keys("arm"))
    made.poll(0)
    made.poll(1)
    made.poll(2)
    assert link.said == []
    session.asked[0][1].ended = True
    made.poll(3)
    assert link.said == [session]
    session.answer = answer
    for now in range(60 * MS, 80 * MS, 5 * MS):
        made.poll(now)
    assert link.said[-1] == "answered"


def test_a_plain_session_is_told_nothing(session, clock):
    session.answer = None
    made = Follower(session, Keys("arm"))
    made.poll(0)
    made.poll(1)
    session.asked[0][1].ended = True
    assert made.poll(2).reasons == ("waiting:service",)
    assert made._trip.unanswered
    assert made.poll(2 + TIMEOUT_NS).reasons == ("waiting:service",)


def test_what_was_heard_goes_with_the_question(session, clock):
    session.answer = None
    made = Follower(session, Keys("arm"))
    made.poll(0)
    session.send(20)
    made.poll(1)
    session.asked[0][1].ended = True
    made.poll(2)
    session.answer = zone(19)  # older than what was heard before it was asked for
    made.poll(51 * MS)
    made.poll(52 * MS)
    made.poll(53 * MS)
    assert made.watchdog.rejected == {"old_seq": 1}
    assert not made.watchdog.proved


def test_a_pause_as_long_as_a_message_is_valid_is_none_too_long(proved, session):
    session.send(11)
    proved.poll(4 * MS)
    session.send(12)
    proved.poll(4 * MS + VALID_NS)
    assert len(session.asked) == 2  # it expired, but nothing was dropped unread
    assert proved.heard == Heard("p", 12)
    session.send(13)
    assert session.subscribed["ssm/arm/zone"].waiting
    proved.poll(4 * MS + 2 * VALID_NS + 1)
    assert not session.subscribed["ssm/arm/zone"].waiting
    assert not session.subscribed["ssm/arm/command"].waiting


def test_after_a_pause_a_question_is_asked_at_once_and_all_that_waits_is_dropped(proved, session):
    session.send(*range(11, 40))
    now = 2 * MS + VALID_NS + 1
    asked = len(session.asked)
    proved.poll(now)
    assert len(session.asked) == asked + 1
    assert [len(session.subscribed[key].waiting) for key in session.subscribed] == [0, 0]
    assert proved.heard is None


def test_up_to_half_the_validity_an_empty_channel_is_believed(proved, session):
    for gap, believed in ((VALID_NS // 2, True), (VALID_NS // 2 + 1, False)):
        start = proved._polled_ns
        proved.poll(start + gap)
        assert proved._empty_ns == (start + gap if believed else start)


def test_a_flood_is_drained_twice_as_deep_as_a_channel_holds(proved, session):
    handler = session.subscribed["ssm/arm/zone"]
    handler.endless = SimpleNamespace(kind=zenoh.SampleKind.DELETE)
    handler.received = 0
    proved.poll(4 * MS)
    assert handler.received == 2 * follower.CAPACITY
    assert proved.watchdog.rejected == {"not_put": 2 * follower.CAPACITY}
    proved.poll(400 * MS)
    assert handler.received <= 2 * follower.CAPACITY + 3 * follower.CAPACITY


def test_a_poll_that_takes_longer_than_a_message_is_valid_gives_a_stop(session, clock):
    made = Follower(session, Keys("arm"))
    for now in (1, 2, 3):
        clock.now = now * MS
        made.poll()
    session.send(11)
    clock.now = 4 * MS
    assert not made.poll().stopped_by_consumer
    session.send(12)
    clock.later = VALID_NS // 2 + MS  # once when it begins, and once before it says what holds
    assert made.poll().stopped_by_consumer


def test_an_invalid_answer_is_shown_as_the_reason_for_a_while(session, clock):
    session.answer = m.Zone(**{**msgspec.structs.asdict(zone(10)), "robot": "other"})
    made = Follower(session, Keys("arm"))
    for now in (0, 1 * MS, 2 * MS):
        followed = made.poll(now)
    assert followed.reasons == ("invalid:service",)
    assert made.watchdog.rejected == {"wrong_robot": 1}


def test_a_stop_of_ones_own():
    stop = own_stop("stale:service", ("a", "b"))
    assert (stop.zone, stop.name, stop.reasons) == (Zone.STOP, ("a", "b"), ("stale:service",))
    assert stop.velocity == stop.speed_limit == (0.0, 0.0)
    assert (stop.zone_message, stop.command_message, stop.expires_ns) == (None, None, 0)
    assert stop.stopped_by_consumer


@pytest.mark.parametrize("make", [service_stop, decision])
def test_a_stop_of_the_service(make):
    told, ordered = zone(11, "stop", ["contact"]), command(11, "stop")
    stop = make(told, ordered, 77)
    assert (stop.zone, stop.name, stop.reasons) == (Zone.STOP, ("a",), ("contact",))
    assert stop.velocity == stop.speed_limit == (0.0,)
    assert (stop.zone_message, stop.command_message, stop.expires_ns) == (told, ordered, 77)
    assert not stop.stopped_by_consumer


def test_a_decision_of_the_service():
    told, ordered = zone(11, "yellow", ["distance"]), command(11, "yellow")
    found = decision(told, ordered, 77)
    assert (found.zone, found.name, found.reasons) == (Zone.YELLOW, ("a",), ("distance",))
    assert (found.velocity, found.speed_limit) == ((0.1,), (1.0,))
    assert (found.zone_message, found.command_message, found.expires_ns) == (told, ordered, 77)
    assert not found.stopped_by_consumer

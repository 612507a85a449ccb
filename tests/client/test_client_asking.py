"""Questions and round trips with a session in the test's hands: answers when all goes wrong."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import msgspec
import pytest
import zenoh

from ssm_service.client import Client, Follower
from ssm_service.client.ask import ask
from ssm_service.client.connection import Connection
from ssm_service.client.roundtrip import RETRY_NS, TIMEOUT_NS, RoundTrip
from ssm_service.errors import InputError, NoServiceError, ServiceError
from ssm_service.wire import Heard, Keys, encoding_of
from ssm_service.wire import messages as m
from ssm_service.wire.integrity import seal

NOBODY = "tcp/127.0.0.1:1"


class Payload:
    def __init__(self, data):
        self.data = data

    def to_bytes(self):
        return self.data


def good(data):
    return SimpleNamespace(ok=SimpleNamespace(payload=Payload(data), attachment=None), err=None)


def bad(data):
    return SimpleNamespace(ok=None, err=SimpleNamespace(payload=Payload(data)))


EMPTY = SimpleNamespace(ok=None, err=None)


class Session:
    """Answers queries with what it was given, one list after the other; then with none."""

    def __init__(self, *answers):
        self.answers = list(answers)
        self.asked = []

    def answered(self):
        self.doubted = False

    def unanswered(self, session):
        assert session is self
        self.doubted = True

    def wait(self, _timeout_s):
        return self

    def get(self, key, *_channel, **options):
        self.asked.append((key, options))
        answer = self.answers.pop(0) if self.answers else []
        if isinstance(answer, Exception):
            raise answer
        return answer


def asked(session, **options):
    return [answer.payload for answer in ask(session, "ssm/arm/zone", patience_s=0.12, **options)]


def test_all_good_answers_come_back_whatever_else_does():
    session = Session([bad(b'{"error": "no"}'), good(b"1"), EMPTY, good(b"2")])
    assert asked(session, payload=b"[]", timeout_s=7.0) == [b"1", b"2"]
    ((key, options),) = session.asked
    assert key == "ssm/arm/zone"
    assert (options["payload"], options["encoding"], options["timeout"]) == (b"[]", "application/json", 7.0)


def test_it_asks_again_while_nobody_answers():
    session = Session([], [bad(b"Timeout")], [good(b"1")])
    assert asked(session) == [b"1"]
    assert len(session.asked) == 3
    timeouts = [options["timeout"] for _, options in session.asked]
    assert timeouts == sorted(timeouts, reverse=True)
    assert timeouts[0] <= 0.12
    assert {options["encoding"] for _, options in session.asked} == {None}


def test_nobody_is_an_error_with_the_time_that_was_waited():
    with pytest.raises(NoServiceError, match=r"nobody answered ssm/arm/zone within 0\.12 s"):
        asked(Session())


@pytest.mark.parametrize(
    ("payload", "words"), [(b'{"error": "no fresh joints"}', "no fresh joints"), (b"\xffplain", "plain")]
)
def test_an_error_is_said_in_the_words_that_came(payload, words):
    with pytest.raises(ServiceError, match=words) as caught:
        asked(Session([bad(payload)]))
    assert not isinstance(caught.value, NoServiceError)


def test_a_query_that_cannot_be_sent_is_an_error_with_its_key():
    with pytest.raises(ServiceError, match="ssm/arm/zone could not be sent: closed"):
        asked(Session(zenoh.ZError("closed")))


class Replies:
    """A channel of replies that is empty, or ended."""

    def __init__(self, *replies, ended=False):
        self.replies, self.ended = list(replies), ended

    def try_recv(self):
        if self.replies:
            return self.replies.pop(0)
        if self.ended:
            raise zenoh.ZError("ended")
        return None


def test_a_round_trip_that_cannot_be_sent_is_tried_again_later():
    session = Session(zenoh.ZError("closed"), Replies())
    trip = RoundTrip(session, "ssm/arm/zone")
    assert trip.step(0) is None
    assert trip.step(RETRY_NS - 1) is None
    assert len(session.asked) == 1
    assert trip.step(RETRY_NS) is None
    assert len(session.asked) == 2


def test_a_query_that_ended_without_an_answer_is_asked_anew():
    session = Session(Replies(EMPTY, bad(b"Timeout"), ended=True), Replies())
    trip = RoundTrip(session, "ssm/arm/zone")
    assert [trip.step(0), trip.step(1), trip.step(RETRY_NS)] == [None] * 3
    assert len(session.asked) == 2


def test_a_query_that_nobody_ends_is_given_up_in_time():
    session = Session(Replies(), Replies())
    trip = RoundTrip(session, "ssm/arm/zone")
    for now in (0, TIMEOUT_NS, TIMEOUT_NS + 1):
        assert trip.step(now) is None
    assert len(session.asked) == 1
    trip.step(TIMEOUT_NS + 2)
    assert len(session.asked) == 2


def test_what_was_heard_before_the_question_goes_with_its_answer():
    payload = msgspec.json.encode(a_zone(seq=5))
    answer = SimpleNamespace(
        kind=zenoh.SampleKind.PUT,
        encoding=encoding_of(m.Zone),
        payload=SimpleNamespace(to_bytes=lambda: payload),
        attachment=SimpleNamespace(to_bytes=lambda: seal("ssm/arm/zone", "p", 5, payload)),
    )
    trip = RoundTrip(Session(Replies(SimpleNamespace(ok=answer, err=None))), "ssm/arm/zone")
    assert trip.step(0, Heard("p", 7)) is None
    answers = trip.step(1, Heard("p", 9))
    assert (answers.heard, [zone.seq for zone in answers.zones]) == (Heard("p", 7), [5])
    with pytest.raises(InputError, match="heard before the question"):
        answers.check()


def a_zone(seq):
    return m.Zone(
        producer="p",
        seq=seq,
        stamp_ns=0,
        valid_for_ns=1,
        robot="arm",
        profile="test",
        zone="green",
        distance=None,
        name=["a"],
        speed_limit=[1.0],
        speed_scaling=1.0,
        nearest=None,
        sources={},
        reaction=None,
        reasons=[],
    )


def test_a_follower_without_a_session_says_stop_and_can_be_closed():
    connection = Connection((NOBODY,), None)
    follower = Follower(connection, Keys("arm"))
    assert follower.poll().reasons == ("waiting:service",)
    follower.close()
    connection.close()
    assert connection.session is None
    with pytest.raises(NoServiceError, match="closed"):
        connection.wait(0.1)


def test_closing_before_anything_was_opened_ends_at_once():
    client = Client("arm", connect=(NOBODY,))
    client.close()
    client.close()
    with pytest.raises(NoServiceError, match="closed"):
        client.robots()


class Present:
    """A connection with a session on which nobody answers, and tokens of robots."""

    def __init__(self, *robots, closed=False):
        self.robots, self.closed = robots, closed
        self.session = self

    def wait(self, _timeout_s):
        return self

    def get(self, key, **_options):
        if key.endswith("/alive"):
            if self.closed:
                raise zenoh.ZError("closed")
            tokens = [
                SimpleNamespace(ok=SimpleNamespace(key_expr=f"ssm/{name}/alive")) for name in self.robots
            ]
            return [*tokens, SimpleNamespace(ok=None)]
        return []

    def liveliness(self):
        return self

    def unanswered(self, session):
        assert session is self


@pytest.mark.parametrize(
    ("there", "words"),
    [
        (Present(), "no robot's service is there"),
        (Present("left", "right", "left"), r"there: left(,| and) right"),
        (Present("left", "arm"), "its service is there, but did not answer in time"),
        (Present("left", closed=True), "no robot's service is there"),
    ],
)
def test_who_gets_no_answer_is_told_who_is_there(there, words):
    with Client("arm", connect=(NOBODY,), timeout_s=0.06) as client:
        client.connection = there
        for question in (client.zone, client.health, client.config):
            with pytest.raises(NoServiceError, match=f"nobody answered ssm/arm/.*; {words}; "):
                question()


def test_a_connection_that_is_closed_while_it_is_opened_keeps_nothing_open(monkeypatch):
    opened = OpenedSession()
    opening, go = threading.Event(), threading.Event()

    def open_slowly(_config):
        opening.set()
        assert go.wait(10.0)
        return opened

    monkeypatch.setattr("ssm_service.client.connection.open_session", open_slowly)
    connection = Connection((NOBODY,), None)
    assert connection.session is None
    assert opening.wait(10.0)
    closing = threading.Thread(target=connection.close)
    closing.start()
    while not connection._closed.is_set():
        pass
    go.set()
    closing.join(10.0)
    assert opened.closed.wait(10.0)
    assert connection.session is None


class OpenedSession:
    def __init__(self):
        self.closed = threading.Event()

    def close(self):
        self.closed.set()


def test_a_latch_of_the_clients_own_is_acknowledged_once():
    with Client("arm", connect=(NOBODY,)) as client:
        assert client.acknowledge() is None
    with Client("arm", connect=(NOBODY,), latch=10.0) as client:
        assert client.acknowledge() is None
        watchdog = client.follower().watchdog
        for _ in range(2):
            watchdog.refuse(InputError("corrupt", "payload", "x", "y", fault="corruption"), 0)
        assert watchdog.state(0).reasons == ("latched:corruption",)
        said = client.acknowledge()
        assert said is not None
        assert said.startswith("corruption")
        assert watchdog.state(0).reasons != ("latched:corruption",)


def test_a_reset_is_answered_with_what_was_cleared():
    payload = b'{"producer":"s","seq":3,"stamp_ns":0,"robot":"arm","cleared":"corruption on zone"}'
    sealed = seal("ssm/arm/reset", "s", 3, payload)
    answer = SimpleNamespace(
        ok=SimpleNamespace(payload=Payload(payload), attachment=Payload(sealed)), err=None
    )
    with Client("arm", connect=(NOBODY,)) as client:
        client.connection = Session([answer])
        assert client.reset().cleared == "corruption on zone"
        client.connection = Session([good(payload)])
        with pytest.raises(ServiceError, match="malformed"):
            client.reset()


@pytest.mark.parametrize("answer", [b"{", b"[]", b'{"a": "\xff"}'])
def test_a_malformed_configuration_under_a_right_checksum_is_the_services_error(monkeypatch, answer):
    with Client("arm", connect=[NOBODY]) as client:
        monkeypatch.setattr(client, "_plain", lambda _name: answer)
        with pytest.raises(ServiceError, match="config answered with something malformed"):
            client.config()

"""What exactly is asked for, how long, and what is sent; with a session in the test's hands."""

from __future__ import annotations

from types import MappingProxyType, SimpleNamespace

import msgspec
import pytest
import zenoh

from ssm_service.client import ask as asking
from ssm_service.client.ask import AGAIN_S, Answer, ask
from ssm_service.client.chunks import CHUNK_OBSTACLES, chunks, encoded
from ssm_service.client.roundtrip import PAUSE_NS, RETRY_NS, TIMEOUT_NS, RoundTrip
from ssm_service.errors import InputError, NoServiceError, ServiceError
from ssm_service.wire import Heard, encoding_of
from ssm_service.wire import messages as m
from ssm_service.wire.integrity import seal

KEY = "ssm/arm/zone"


def put(data):
    return SimpleNamespace(to_bytes=lambda: data)


def good(data, attachment=None):
    sealed = None if attachment is None else put(attachment)
    return SimpleNamespace(ok=SimpleNamespace(payload=put(data), attachment=sealed), err=None)


def bad(data):
    return SimpleNamespace(ok=None, err=SimpleNamespace(payload=put(data)))


class Clock:
    """Time that passes only while somebody sleeps."""

    def __init__(self):
        self.now = 0.0
        self.slept = []

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(asking, "time", clock)
    return clock


class Session:
    """Answers queries with one list after the other; then with none."""

    def __init__(self, *answers):
        self.answers, self.asked, self.waited, self.events = list(answers), [], [], []

    def wait(self, timeout_s):
        self.waited.append(timeout_s)
        return self

    def answered(self):
        self.events.append("answered")

    def unanswered(self, session):
        assert session is self
        self.events.append("unanswered")

    def get(self, *arguments, **options):
        self.asked.append((arguments, options))
        answer = self.answers.pop(0) if self.answers else []
        if isinstance(answer, Exception):
            raise answer
        return answer


def test_everybody_is_asked_and_every_answer_wanted(clock):
    session = Session([good(b"1", b"crc32=0"), good(b"2")])
    assert ask(session, KEY, patience_s=0.5) == [Answer(b"1", b"crc32=0"), Answer(b"2", None)]
    (((key,), options),) = session.asked
    assert key == KEY
    assert options == {
        "target": zenoh.QueryTarget.ALL,
        "consolidation": zenoh.ConsolidationMode.NONE,
        "timeout": 0.5,
        "payload": None,
        "encoding": None,
    }
    assert (session.waited, session.events, clock.slept) == ([0.5], ["answered"], [])


def test_patience_is_spent_in_attempts_until_no_other_one_fits(clock):
    session = Session()
    with pytest.raises(NoServiceError, match=r"nobody answered ssm/arm/zone within 0\.2 s"):
        ask(session, KEY, patience_s=0.2)
    timeouts = [options["timeout"] for _, options in session.asked]
    assert timeouts == pytest.approx([0.2, 0.15, 0.1, 0.05])
    assert clock.slept == [AGAIN_S] * 3
    assert session.events == ["unanswered"]
    again = Session()
    clock.now = 0.0
    with pytest.raises(NoServiceError):
        ask(again, KEY, patience_s=AGAIN_S)
    assert len(again.asked) == 1


def test_an_answer_may_take_longer_than_patience_and_none_is_asked_for_in_no_time(clock):
    session = Session()
    with pytest.raises(NoServiceError, match="within 7 s"):
        ask(session, KEY, patience_s=0.04, timeout_s=7.0)
    with pytest.raises(NoServiceError):
        ask(session, KEY, patience_s=0.0)
    assert [options["timeout"] for _, options in session.asked] == [7.0, 0.001]


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b'{"error": "no fresh joints"}', "no fresh joints"),
        (b'{"error": 1}', '{"error": 1}'),
        (b"\xff" + b"x" * 500, "\ufffd" + "x" * 499),
        (b"[" * 400, "[" * 400),
    ],
)
def test_the_first_error_is_said_in_its_own_words(payload, words):
    with pytest.raises(ServiceError) as caught:
        ask(Session([bad(payload), bad(b"second")]), KEY, patience_s=1.0)
    assert str(caught.value) == words


class Map(dict):
    """Keeps msgspec from knowing the type."""


def test_any_mapping_can_be_an_input_and_a_wrong_one_is_named_by_its_index():
    (chunk,) = chunks([MappingProxyType({"position": [0.5]}), Map(position=[1.5])])
    assert msgspec.json.decode(chunk.payload) == [{"position": [0.5]}, {"position": [1.5]}]
    for wrong, cause in (
        ({"position": [float("nan")]}, "not_finite"),
        ({"position": object()}, "wrong_type"),
    ):
        with pytest.raises(InputError) as caught:
            list(chunks([{"position": [0.5]}, wrong]))
        assert (caught.value.cause, caught.value.where) == (cause, "inputs[1]")


def test_what_has_no_form_is_named_by_its_type_behind_the_refusal():
    with pytest.raises(InputError) as caught:
        encoded(Session())
    assert str(caught.value.__cause__) == "Session has no form in JSON"


def test_every_chunk_but_the_first_begins_with_no_obstacles():
    half = {"position": [0.0], "obstacles": [{}] * (CHUNK_OBSTACLES // 2)}
    assert [chunk.count for chunk in chunks([half] * 5)] == [2, 2, 1]


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


def a_zone(seq):
    payload = msgspec.json.encode(
        m.Zone(
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
    )
    sealed = seal(KEY, "p", seq, payload)
    answer = SimpleNamespace(
        kind=zenoh.SampleKind.PUT,
        encoding=encoding_of(m.Zone),
        payload=put(payload),
        attachment=put(sealed),
    )
    return SimpleNamespace(ok=answer, err=None)


def test_a_round_trip_asks_everybody_at_once_and_is_never_in_the_way():
    session = Session(Replies())
    trip = RoundTrip(session, KEY)
    assert not trip.unanswered
    assert trip.step(5) is None
    (((key, channel), options),) = session.asked
    assert key == KEY
    assert isinstance(channel, zenoh.handlers.FifoChannel)
    assert options == {
        "target": zenoh.QueryTarget.ALL,
        "consolidation": zenoh.ConsolidationMode.NONE,
        "timeout": pytest.approx(TIMEOUT_NS * 1e-9),
        "congestion_control": zenoh.CongestionControl.DROP,
        "priority": zenoh.Priority.INTERACTIVE_HIGH,
        "express": True,
    }


def test_after_an_answer_there_is_a_pause():
    session = Session(Replies(a_zone(5), a_zone(6)), Replies())
    trip = RoundTrip(session, KEY)
    trip.step(1_000)
    answers = trip.step(7_000, Heard("p", 9))
    assert [zone.seq for zone in answers.zones] == [5, 6]
    assert (answers.asked_ns, answers.heard) == (1_000, None)
    trip.step(7_000 + PAUSE_NS - 1)
    assert len(session.asked) == 1
    trip.step(7_000 + PAUSE_NS)
    assert len(session.asked) == 2


def test_nobody_is_noted_until_somebody_answers():
    session = Session(Replies(ended=True), Replies(), Replies(a_zone(5)))
    trip = RoundTrip(session, KEY)
    trip.step(0)
    assert not trip.unanswered
    trip.step(1)
    assert trip.unanswered
    trip.step(RETRY_NS - 1)
    assert len(session.asked) == 1
    trip.step(RETRY_NS)
    assert len(session.asked) == 2
    trip.step(RETRY_NS + 1)
    assert trip.unanswered
    trip.step(RETRY_NS + TIMEOUT_NS + 1)  # given up: asked anew at the next step
    trip.step(RETRY_NS + TIMEOUT_NS + 2)
    assert len(session.asked) == 3
    assert trip.step(RETRY_NS + TIMEOUT_NS + 3).zones[0].seq == 5
    assert not trip.unanswered


def test_a_restart_asks_at_once_and_forgets_the_answer_under_way():
    session = Session(Replies(a_zone(5)), Replies(a_zone(9)))
    trip = RoundTrip(session, KEY)
    trip.step(0)
    trip.restart(10)
    assert trip.step(9) is None
    assert len(session.asked) == 1
    assert trip.step(10) is None
    assert len(session.asked) == 2
    answers = trip.step(11)
    assert (answers.asked_ns, [zone.seq for zone in answers.zones]) == (10, [9])


def test_a_malformed_answer_ends_its_query():
    wrong = a_zone(5)
    wrong.ok.attachment = None
    session = Session(Replies(wrong, a_zone(6)), Replies())
    trip = RoundTrip(session, KEY)
    trip.step(0)
    with pytest.raises(InputError, match="attachment"):
        trip.step(1)
    assert trip.step(RETRY_NS - 1) is None
    assert len(session.asked) == 1
    trip.step(RETRY_NS)
    assert len(session.asked) == 2


def test_a_query_is_given_up_by_its_own_age_not_by_the_time_of_day():
    session = Session(Replies(), Replies())
    trip = RoundTrip(session, KEY)
    begin = 10**12
    for now in (begin, begin + 1, begin + TIMEOUT_NS):
        trip.step(now)
    assert not trip.unanswered
    trip.step(begin + TIMEOUT_NS + 1)
    assert trip.unanswered
    assert len(session.asked) == 1

"""Each refusal of a consumer says which field, what stood there, what may stand there, and the fault."""

from types import SimpleNamespace

import msgspec
import pytest
import zenoh

from ssm_service.client.accept import CAPACITY, Channel, OutputDecoder, check
from ssm_service.client.pairing import WAITING, Pairing
from ssm_service.client.roundtrip import Answers
from ssm_service.client.watchdog import REFUSAL_SHOWN_NS, Watchdog
from ssm_service.errors import InputError
from ssm_service.wire import Heard, encoding_of
from ssm_service.wire import messages as m
from ssm_service.wire.integrity import seal

KEY = "ssm/arm/zone"
COMMON = {"stamp_ns": 0, "valid_for_ns": 20_000_000, "robot": "arm", "zone": "green", "name": ["a", "b"]}
ZONE = {
    "profile": "test",
    "distance": None,
    "speed_limit": [1.0, 2.0],
    "speed_scaling": 1.0,
    "nearest": None,
    "sources": {},
    "reaction": None,
    "reasons": [],
}


def zone(seq=11, producer="p", **changes):
    return m.Zone(**{**COMMON, **ZONE, "producer": producer, "seq": seq, **changes})


def command(seq=11, producer="p", **changes):
    velocity = {"velocity": [0.1, -0.2]}
    return m.VelocityCommand(**{**COMMON, **velocity, "producer": producer, "seq": seq, **changes})


def said(action, *arguments):
    """What a refusal says: cause, field, found, allowed, fault."""
    with pytest.raises(InputError) as caught:
        action(*arguments)
    error = caught.value
    return error.cause, error.where, error.found, error.allowed, error.fault


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (zone(robot="other"), ("wrong_robot", "robot", "other", "arm", "addressing")),
        (command(name=["b", "b"]), ("repeated_joint", "name", ["b", "b"], "each joint once", "")),
        (zone(speed_limit=[1.0]), ("wrong_length", "speed_limit", "1 values", "2 values", "")),
        (command(velocity=[1.0] * 3), ("wrong_length", "velocity", "3 values", "2 values", "")),
        (
            zone(speed_limit=[1.0, float("inf")]),
            ("not_finite", "speed_limit", [1.0, float("inf")], "finite numbers", ""),
        ),
        (
            command(velocity=[float("-inf"), 0.0]),
            ("not_finite", "velocity", [float("-inf"), 0.0], "finite numbers", ""),
        ),
        (zone(speed_limit=[0.5, -1e-9]), ("out_of_range", "speed_limit", [0.5, -1e-9], "0 or more", "")),
    ],
)
def test_a_message_that_does_not_hold_together(message, expected):
    assert said(check, message, "arm") == expected


@pytest.mark.parametrize(
    "message", [zone(speed_limit=[0.0, 0.0]), command(velocity=[-1.0, 0.5]), zone(name=[], speed_limit=[])]
)
def test_no_motion_no_joints_and_backward_motion_hold_together(message):
    check(message, "arm")


def sample(payload=None, attachment=None, **changes):
    message = zone(5)
    payload = msgspec.json.encode(message) if payload is None else payload
    attachment = seal(KEY, "p", 5, payload) if attachment is None else attachment
    fields = {
        "kind": zenoh.SampleKind.PUT,
        "encoding": encoding_of(m.Zone),
        "payload": SimpleNamespace(to_bytes=lambda: payload),
        "attachment": SimpleNamespace(to_bytes=lambda: attachment),
    }
    return SimpleNamespace(**{**fields, **changes})


def test_a_sample_of_the_right_kind_and_key_becomes_its_message():
    assert OutputDecoder(m.Zone, KEY).decode(sample()) == zone(5)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"kind": zenoh.SampleKind.DELETE}, ("not_put", "sample", "a delete", "a put", "insertion")),
        (
            {"encoding": "application/json"},
            ("wrong_encoding", "encoding", "application/json", encoding_of(m.Zone), "addressing"),
        ),
        (
            {"encoding": encoding_of(m.VelocityCommand)},
            ("wrong_encoding", "encoding", encoding_of(m.VelocityCommand), encoding_of(m.Zone), "addressing"),
        ),
    ],
)
def test_a_sample_of_another_kind(changes, expected):
    assert said(OutputDecoder(m.Zone, KEY).decode, sample(**changes)) == expected


def test_an_output_without_a_checksum_is_none_of_the_services():
    cause, where, found, _, fault = said(OutputDecoder(m.Zone, KEY).decode, bare())
    assert (cause, where, found, fault) == ("missing_crc", "attachment", None, "masquerade")
    assert said(OutputDecoder(m.Zone, "ssm/arm/other").decode, sample())[0] == "corrupt"


def bare():
    one = sample()
    one.attachment = None
    return one


class Session:
    """A session that notes what is subscribed to."""

    def __init__(self):
        self.subscribed = []
        self.undeclared = 0
        self.handler = self

    def declare_subscriber(self, key, ring):
        self.subscribed.append((key, ring))
        return self

    def try_recv(self):
        return "next"

    def undeclare(self):
        self.undeclared += 1


def test_a_channel_is_one_subscription_that_keeps_the_newest():
    session = Session()
    channel = Channel(session, KEY, m.Zone)
    ((key, ring),) = session.subscribed
    assert key == KEY
    assert isinstance(ring, zenoh.handlers.RingChannel)
    assert channel.receive() == "next"
    assert channel.decode(sample()) == zone(5)
    channel.close()
    assert session.undeclared == 1
    assert CAPACITY >= 2


def test_a_repeated_tick_and_a_tick_before_the_last():
    pairing = Pairing("p", 10)
    assert pairing.add(zone(15), 0) is None
    allowed = "above 15, the last one accepted"
    assert said(pairing.add, zone(15), 0) == ("old_seq", "seq", 15, allowed, "repetition")
    assert said(pairing.add, zone(14), 0) == ("old_seq", "seq", 14, allowed, "sequence")
    assert pairing.add(command(15), 0).command.seq == 15


def test_messages_of_a_tick_that_disagree():
    pairing = Pairing("p", 10)
    pairing.add(zone(11), 0)
    expected = ("mismatch", "command", "red for ['a', 'b']", "green for ['a', 'b']", "")
    assert said(pairing.add, command(11, zone="red"), 0) == expected


def test_a_command_of_joints_in_another_order():
    pairing = Pairing("p", 10)
    pairing.add(command(11, name=["b", "a"]), 0)
    expected = ("mismatch", "command", "green for ['b', 'a']", "green for ['a', 'b']", "")
    assert said(pairing.add, zone(11), 0) == expected


def test_an_answer_older_than_what_was_heard():
    allowed = "12, which was heard before the question, or above"
    answers = Answers(zones=(zone(12), zone(11)), asked_ns=0, heard=Heard("p", 12))
    assert said(answers.check) == ("old_seq", "seq", 11, allowed, "repetition")
    Answers(zones=(zone(12), zone(3, producer="q")), asked_ns=0, heard=Heard("p", 12)).check()


def test_a_second_producer():
    watchdog = Watchdog("arm")
    watchdog.prove(zone(10), 0)
    expected = ("second_producer", "producer", "q", "only p", "insertion")
    assert said(watchdog.take, zone(11, producer="q"), 0, 0) == expected


def test_a_message_or_an_answer_for_another_robot_is_refused_by_its_name():
    watchdog = Watchdog("arm")
    for action, arguments in ((watchdog.prove, (0,)), (watchdog.take, (0, 0))):
        expected = ("wrong_robot", "robot", "other", "arm", "addressing")
        assert said(action, zone(robot="other"), *arguments) == expected
    assert not watchdog.proved


def test_the_last_refusal_is_kept_in_words_cut_short():
    watchdog = Watchdog("arm")
    assert watchdog.last_rejection == ""
    error = InputError("corrupt", "attachment", "a", "b", fault="corruption")
    watchdog.refuse(error, 0)
    assert watchdog.last_rejection == "attachment: found 'a', allowed: b"
    watchdog.refuse(InputError("corrupt", "x" * 1000, "a", "b"), 0)
    assert watchdog.last_rejection == "x" * 300


@pytest.mark.parametrize(("first", "second"), [(zone, command), (command, zone)])
def test_one_message_waits_for_the_other_for_64_ticks(first, second):
    pairing = Pairing("p", 10)
    for seq in range(11, 11 + WAITING + 1):
        assert pairing.add(first(seq), seq) is None
    assert pairing.add(second(11), 0) is None  # too late by one
    pair = pairing.add(second(12), 99)
    assert (pair.zone.seq, pair.command.seq, pair.arrived_ns) == (12, 12, 12)


def test_gaps_add_up():
    pairing = Pairing("p", 10)
    for seq in (11, 15, 16, 18):
        pairing.add(zone(seq), 0)
        pairing.add(command(seq), 0)
    assert pairing.lost == 3 + 1


@pytest.mark.parametrize("shorter", ["zone", "command"])
def test_the_shorter_validity_of_the_two_messages_is_the_watchdogs(shorter):
    watchdog = Watchdog("arm")
    watchdog.prove(zone(10), 0)
    for kind in (zone, command):
        watchdog.take(kind(11, valid_for_ns=5_000_000 if kind.__name__ == shorter else 9_000_000), 0, 0)
    assert watchdog.valid_for_ns == 5_000_000
    assert watchdog.state(0).expires_ns == 5_000_000


def test_refusals_are_counted_by_cause_and_fault():
    watchdog = Watchdog("arm")
    for _ in range(3):
        watchdog.refuse(InputError("corrupt", "attachment", "a", "b", fault="corruption"), 0)
    assert watchdog.rejected == {"corrupt": 3}
    assert watchdog.integrity_errors == {"corruption": 3}


def test_a_stop_without_its_command_holds_no_longer_than_what_was_proved():
    watchdog = Watchdog("arm")
    watchdog.prove(zone(10), 7)
    watchdog.take(zone(11, zone="stop", speed_limit=[0.0, 0.0]), 9, 9)
    stop = watchdog.state(9)
    assert (stop.expires_ns, stop.command_message, stop.stopped_by_consumer) == (7 + 20_000_000, None, False)


def test_a_refusal_is_the_reason_of_a_stop_for_half_a_second():
    watchdog = Watchdog("arm")
    begin = 3_000_000_000
    watchdog.refuse(InputError("corrupt", "attachment", "a", "b", fault="corruption"), begin)
    for after, reason in ((0, "invalid"), (REFUSAL_SHOWN_NS - 1, "invalid"), (REFUSAL_SHOWN_NS, "waiting")):
        assert watchdog.state(begin + after).reasons == (f"{reason}:service",)

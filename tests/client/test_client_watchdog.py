"""The watchdog's judgement, with time as a number."""

import random

import pytest

from ssm_service.client.followed import Followed
from ssm_service.client.watchdog import LONGEST_VALID_NS, UNRENEWED_NS, Watchdog
from ssm_service.errors import InputError
from ssm_service.safety import Zone
from ssm_service.wire import messages as m
from ssm_service.wire.latch import Latch

MS = 1_000_000
VALID_NS = 20 * MS
NAME = ["a", "b"]


def zone(seq, *, producer="p", word="green", stamp=0, **changes):
    fields = {
        "producer": producer,
        "seq": seq,
        "stamp_ns": stamp,
        "valid_for_ns": VALID_NS,
        "robot": "arm",
        "profile": "test",
        "zone": word,
        "distance": None,
        "name": NAME,
        "speed_limit": [1.0, 2.0],
        "speed_scaling": 1.0,
        "nearest": None,
        "sources": {},
        "reaction": None,
        "reasons": [],
    }
    return m.Zone(**{**fields, **changes})


def command(seq, *, producer="p", word="green", **changes):
    fields = {
        "producer": producer,
        "seq": seq,
        "stamp_ns": 0,
        "valid_for_ns": VALID_NS,
        "robot": "arm",
        "zone": word,
        "name": NAME,
        "velocity": [0.1, -0.2],
    }
    return m.VelocityCommand(**{**fields, **changes})


def both(watchdog, seq, now, **changes):
    watchdog.take(zone(seq, **changes), now, now)
    watchdog.take(command(seq, **changes), now, now)


def refused(watchdog, message, now):
    with pytest.raises(InputError) as caught:
        watchdog.take(message, now, now)
    return caught.value.cause


@pytest.fixture
def proved():
    watchdog = Watchdog("arm")
    watchdog.prove(zone(10), 0)
    return watchdog


def test_nothing_is_believed_before_the_proof():
    watchdog = Watchdog("arm")
    both(watchdog, 11, 0)
    assert watchdog.state(0).reasons == ("waiting:service",)


def test_ticks_up_to_the_proofs_are_passed_over(proved):
    for seq in (9, 10):
        both(proved, seq, 1)
        assert proved.state(1).stopped_by_consumer
    both(proved, 11, 1)
    assert proved.state(1).velocity == (0.1, -0.2)
    assert proved.state(1).speed_limit == (1.0, 2.0)
    assert proved.rejected == {}


def test_a_pair_holds_exactly_as_long_as_it_says(proved):
    both(proved, 11, 5 * MS)
    assert not proved.state(5 * MS + VALID_NS - 1).stopped_by_consumer
    assert proved.state(5 * MS + VALID_NS).reasons == ("stale:service",)


def test_after_expiry_a_new_proof_is_needed(proved):
    both(proved, 11, 0)
    both_at = VALID_NS + 1
    assert proved.state(both_at).stopped_by_consumer
    both(proved, 12, both_at)
    assert proved.state(both_at).stopped_by_consumer
    assert not proved.proved
    proved.prove(zone(12), both_at)
    both(proved, 13, both_at)
    assert not proved.state(both_at).stopped_by_consumer


def test_a_pair_is_as_old_as_the_older_of_its_messages(proved):
    proved.take(zone(11), 1 * MS, 9 * MS)
    proved.take(command(11), 9 * MS, 9 * MS)
    assert proved.state(9 * MS).expires_ns == 1 * MS + VALID_NS


def test_no_arrival_counts_as_before_the_question(proved):
    proved.prove(zone(20), 7 * MS)
    both(proved, 21, 3 * MS)
    assert proved.state(8 * MS).expires_ns == 7 * MS + VALID_NS


def test_the_shorter_validity_counts_and_none_is_unbounded(proved):
    proved.take(zone(11, valid_for_ns=30 * MS), 0, 0)
    proved.take(command(11, valid_for_ns=10 * MS), 0, 0)
    assert proved.state(0).expires_ns == 10 * MS
    proved.take(zone(12, valid_for_ns=2**63 - 1), 0, 0)
    proved.take(command(12, valid_for_ns=2**63 - 1), 0, 0)
    assert proved.state(0).expires_ns == LONGEST_VALID_NS


def test_half_a_tick_changes_nothing(proved):
    both(proved, 11, 0)
    first = proved.state(1)
    proved.take(zone(12), 1, 1)
    proved.take(command(13), 1, 1)
    assert proved.state(1) is first


def test_messages_pair_whatever_comes_first(proved):
    proved.take(command(11), 0, 0)
    proved.take(command(12), 0, 0)
    proved.take(zone(11), 0, 0)
    proved.take(zone(12), 0, 0)
    assert proved.state(0).zone_message.seq == 12
    assert proved.lost == 0


def test_missing_ticks_are_counted(proved):
    both(proved, 11, 0)
    both(proved, 15, 0)
    assert proved.lost == 3
    proved.forget()
    assert proved.lost == 3


def test_a_stop_is_obeyed_without_its_command_and_nothing_older_undoes_it(proved):
    both(proved, 11, 0)
    proved.take(zone(12), 0, 0)
    proved.take(zone(13, word="stop", speed_limit=[0.0, 0.0], reasons=["contact"]), 0, 0)
    state = proved.state(0)
    assert (state.zone, state.velocity, state.reasons) == (Zone.STOP, (0.0, 0.0), ("contact",))
    assert not state.stopped_by_consumer
    proved.take(command(12), 0, 0)
    assert proved.state(0) is state
    assert refused(proved, zone(12), 0) == "old_seq"
    proved.take(zone(14), 0, 0)
    assert proved.state(0) is state
    proved.take(command(14), 0, 0)
    assert proved.state(0).zone is Zone.GREEN


def test_the_numbers_of_a_stop_are_zero_whatever_it_carries(proved):
    both(proved, 11, 0, word="stop")
    assert proved.state(0).velocity == proved.state(0).speed_limit == (0.0, 0.0)


@pytest.mark.parametrize(
    ("message", "cause"),
    [
        (zone(12, robot="other"), "wrong_robot"),
        (zone(12, name=["a", "a"]), "repeated_joint"),
        (zone(12, speed_limit=[1.0]), "wrong_length"),
        (zone(12, speed_limit=[1.0, float("nan")]), "not_finite"),
        (zone(12, speed_limit=[1.0, -1.0]), "out_of_range"),
        (command(12, velocity=[1.0, 1.0, 1.0]), "wrong_length"),
        (command(12, velocity=[float("inf"), 0.0]), "not_finite"),
        (command(12, robot="other"), "wrong_robot"),
        (zone(11), "old_seq"),
        (command(11), "old_seq"),
        (zone(12, producer="q"), "second_producer"),
    ],
)
def test_refusals_have_their_cause_and_refresh_nothing(proved, message, cause):
    both(proved, 11, 0)
    expires = proved.state(0).expires_ns
    with pytest.raises(InputError) as caught:
        proved.take(message, 5 * MS, 5 * MS)
    assert caught.value.cause == cause
    proved.refuse(caught.value, 5 * MS)
    assert proved.rejected == {cause: 1}
    assert proved._current.expires_ns == expires
    expected = "stale:service" if cause == "second_producer" else "invalid:service"
    assert proved.state(5 * MS + LONGEST_VALID_NS // 3).reasons == (expected,)
    assert proved.state(LONGEST_VALID_NS).reasons == ("stale:service",)


@pytest.mark.parametrize("changes", [{"word": "red"}, {"name": ["b", "a"]}])
def test_two_messages_of_a_tick_that_disagree_are_no_pair(proved, changes):
    proved.take(zone(11), 0, 0)
    assert refused(proved, command(11, **changes), 0) == "mismatch"
    assert proved.state(0).stopped_by_consumer


def test_two_producers_are_a_stop_until_one_of_them_has_been_silent(proved):
    both(proved, 11, 0)
    assert refused(proved, zone(500, producer="q"), 1 * MS) == "second_producer"
    assert proved.state(1 * MS).reasons == ("duplicate:service",)
    both(proved, 12, 15 * MS)
    assert proved.state(15 * MS).reasons == ("duplicate:service",)
    both(proved, 13, 21 * MS)
    assert proved.state(21 * MS).velocity == (0.1, -0.2)


def test_another_producer_is_taken_after_the_first_has_expired(proved):
    both(proved, 11, 0)
    later = VALID_NS + MS
    assert proved.state(later).reasons == ("stale:service",)
    proved.prove(zone(3, producer="q"), later)
    both(proved, 4, later, producer="q")
    assert proved.state(later).zone_message.producer == "q"


def test_a_flood_of_producers_is_bounded(proved):
    for number in range(1000):
        with pytest.raises(InputError):
            proved.take(zone(1, producer=str(number)), 0, 0)
    assert len(proved._heard) < 10
    assert proved.state(0).reasons == ("duplicate:service",)


def test_the_same_object_as_long_as_nothing_changed(proved):
    assert proved.state(0) is proved.state(1)
    both(proved, 11, 0)
    assert proved.state(0) is proved.state(1)
    assert proved.state(VALID_NS) is proved.state(VALID_NS + 1)


@pytest.mark.parametrize("seed", range(20))
def test_no_network_makes_it_act_on_what_was_decided_before_the_proof_or_too_long_ago(seed):
    """Delays, losses, repetitions and silences of any length; decisions carry their true time."""
    rng = random.Random(seed)
    watchdog, network, seq, empty, believed = Watchdog("arm"), [], 0, 0, 0
    silent_until = asked = 0
    for now in range(0, 3000 * MS, MS):
        if now % (2 * MS) == 0:
            seq += 1
            # A silence holds back everything sent in it, and lets it all go at its end.
            due = max(now + rng.randrange(2) * MS, silent_until)
            if rng.random() < 0.95:
                network += [(due, zone(seq, stamp=now)), (due, command(seq))] * rng.choice([1, 1, 1, 2])
        if rng.random() < 0.01:
            silent_until = max(silent_until, now + rng.randrange(200) * MS)
        watchdog.expire(now)
        if not watchdog.proved and now >= silent_until:
            asked = now
            watchdog.prove(zone(seq), now)
        for _, message in [entry for entry in network if entry[0] <= now]:
            try:
                watchdog.take(message, empty, now)
            except InputError as error:
                watchdog.refuse(error, now)
        network = [entry for entry in network if entry[0] > now]
        empty = now
        state: Followed = watchdog.state(now)
        if state.stopped_by_consumer:
            continue
        believed += 1
        decided = state.zone_message.stamp_ns
        assert now < state.expires_ns
        assert decided > asked
        assert now - decided < 2 * VALID_NS
    assert believed > 100
    assert set(watchdog.rejected) <= {"old_seq"}


def refuse(watchdog, fault, now, cause="corrupt"):
    watchdog.refuse(InputError(cause, "attachment", "", "", fault=fault), now)


def test_faults_of_transmission_are_counted_apart(proved):
    refuse(proved, "corruption", 0)
    refuse(proved, "corruption", 0, "bad_attachment")
    refuse(proved, "masquerade", 0, "missing_crc")
    refuse(proved, "", 0, "not_finite")
    assert proved.integrity_errors == {"corruption": 2, "masquerade": 1}
    assert proved.rejected == {"corrupt": 1, "bad_attachment": 1, "missing_crc": 1, "not_finite": 1}


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (zone(11), "repetition"),
        (zone(12, robot="other"), "addressing"),
        (zone(12, producer="q"), "insertion"),
    ],
)
def test_a_message_that_shows_a_fault_names_it(proved, message, fault):
    both(proved, 11, 0)
    with pytest.raises(InputError) as caught:
        proved.take(message, 0, 0)
    assert caught.value.fault == fault


def test_without_a_latch_errors_pass(proved):
    for _ in range(10):
        refuse(proved, "corruption", 0)
    both(proved, 11, 0)
    assert not proved.state(0).stopped_by_consumer


def test_with_a_latch_the_second_error_holds_the_stop_until_it_is_acknowledged():
    latch = Latch(10.0)
    watchdog = Watchdog("arm", latch=latch)
    watchdog.prove(zone(10), 0)
    refuse(watchdog, "corruption", 0)
    refuse(watchdog, "", 0, "not_finite")
    both(watchdog, 11, 1)
    assert not watchdog.state(1).stopped_by_consumer
    refuse(watchdog, "masquerade", 2 * MS)
    for tick in range(12, 20):
        both(watchdog, tick, tick * MS)
        state = watchdog.state(tick * MS)
        assert (state.reasons, state.velocity) == (("latched:masquerade",), (0.0, 0.0))
        assert state.stopped_by_consumer
    assert latch.reset() == "masquerade on arm, 0.0 s after corruption on arm"
    assert watchdog.state(20 * MS).zone_message.seq == 19


def test_ticks_that_were_answered_are_acted_on_for_as_long_as_they_are_valid_from_then(proved):
    both(proved, 11, 1 * MS)
    proved.renew(zone(14), 1 * MS, 2 * MS)
    for seq, now in ((12, 10), (13, 18), (14, 21), (15, 21)):
        both(proved, seq, now * MS)
        known = now * MS if seq > 14 else 2 * MS
        assert proved.state(now * MS).expires_ns == known + VALID_NS
        assert proved.state(now * MS).zone_message.seq == seq


def test_a_tick_that_was_there_for_longer_than_it_is_valid_is_a_stop(proved):
    both(proved, 11, 1 * MS)
    proved.renew(zone(14), 1 * MS, 2 * MS)
    both(proved, 12, 20 * MS)
    both(proved, 13, 22 * MS)
    assert proved.state(22 * MS).reasons == ("stale:service",)
    assert not proved.proved


def test_a_proof_lasts_a_second_from_the_question_that_renewed_it(proved):
    at = 0
    for seq in range(11, 400):
        at += 10 * MS
        if seq == 60:
            proved.renew(zone(60), at - 3 * MS, at)
            until = at - 3 * MS + UNRENEWED_NS
        both(proved, seq, at)
        assert proved.proved
        if seq >= 60 and at + 10 * MS >= until:
            break
    assert proved.state(until - 1).zone_message is not None
    assert proved.state(until).stopped_by_consumer
    assert not proved.proved


def test_a_renewal_is_checked_and_changes_nothing_without_a_proof(proved):
    with pytest.raises(InputError) as caught:
        proved.renew(zone(12, robot="leg"), 0, 1)
    assert caught.value.cause == "wrong_robot"
    both(proved, 11, 1 * MS)
    assert not proved.state(1 * MS).stopped_by_consumer
    proved.renew(zone(12, producer="q"), 1 * MS, 2 * MS)
    assert not proved.proved
    assert proved.state(2 * MS).stopped_by_consumer
    proved.renew(zone(13), 2 * MS, 3 * MS)
    both(proved, 14, 3 * MS)
    assert proved.state(3 * MS).stopped_by_consumer

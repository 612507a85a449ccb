from __future__ import annotations

import pytest

from ssm_service.errors import InputError
from ssm_service.wire import ProducerGate

TIMEOUT = 0.1


def pass_through(gate: ProducerGate, producer: str, seq: int, now: float) -> None:
    gate.check(producer, seq, now)
    gate.accept(producer, seq, now)


def cause(gate: ProducerGate, producer: str, seq: int, now: float) -> str:
    with pytest.raises(InputError) as caught:
        gate.check(producer, seq, now)
    return caught.value.cause


def test_the_first_producer_may_begin_anywhere():
    for first in (0, 5, 2**63 - 1):
        gate = ProducerGate(TIMEOUT)
        pass_through(gate, "a", first, 0.0)
        assert gate.producer == "a"
        assert gate.lost == 0


def test_a_repeated_or_older_message_never_passes_however_late():
    gate = ProducerGate(TIMEOUT)
    pass_through(gate, "a", 10, 0.0)
    for seq in (10, 9, 0):
        for now in (0.0, 0.05, 1e6):
            assert cause(gate, "a", seq, now) == "old_seq"
    pass_through(gate, "a", 11, 0.01)


def test_a_gap_passes_and_is_counted():
    gate = ProducerGate(TIMEOUT)
    for seq in (1, 2, 5, 6, 16):
        pass_through(gate, "a", seq, 0.0)
    assert gate.lost == 2 + 9


def test_a_second_producer_waits_until_the_first_is_silent():
    gate = ProducerGate(TIMEOUT)
    pass_through(gate, "a", 1000, 0.0)
    for now in (0.0, 0.05, TIMEOUT):
        assert cause(gate, "b", 2000, now) == "second_producer"
    pass_through(gate, "b", 0, TIMEOUT + 1e-9)
    assert gate.producer == "b"
    assert gate.lost == 0
    assert cause(gate, "a", 1001, TIMEOUT + 0.05) == "second_producer"


def test_only_what_is_accepted_keeps_a_producer_fresh():
    gate = ProducerGate(TIMEOUT)
    pass_through(gate, "a", 1, 0.0)
    gate.check("a", 2, 0.09)  # passed the gate, but its content was refused: never accepted
    assert cause(gate, "b", 1, 0.1) == "second_producer"
    pass_through(gate, "b", 1, 0.11)


def test_two_that_take_turns_are_never_mixed():
    gate = ProducerGate(TIMEOUT)
    taken = []
    for index in range(200):
        producer = "ab"[index % 2]
        try:
            pass_through(gate, producer, index, 0.01 * index)
        except InputError:
            continue
        taken.append(producer)
    assert set(taken) == {"a"}


def test_each_refusal_names_its_fault_of_transmission():
    gate = ProducerGate(TIMEOUT)
    pass_through(gate, "a", 10, 0.0)
    for producer, seq, fault in (("a", 10, "repetition"), ("a", 9, "sequence"), ("b", 11, "insertion")):
        with pytest.raises(InputError) as caught:
            gate.check(producer, seq, 0.0)
        assert caught.value.fault == fault


def test_each_refusal_says_what_was_found_and_what_may_stand_there():
    gate = ProducerGate(TIMEOUT)
    pass_through(gate, "a", 10, 0.0)
    for producer, seq, expected in (
        ("a", 9, ("old_seq", "seq", 9, "above 10, the last one accepted")),
        ("b", 11, ("second_producer", "producer", "b", "only a while it is fresh")),
    ):
        with pytest.raises(InputError) as caught:
            gate.check(producer, seq, 0.0)
        error = caught.value
        assert (error.cause, error.where, error.found, error.allowed) == expected

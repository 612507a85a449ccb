"""A decoder that tells a sender's mistake from a change on the way."""

from __future__ import annotations

import json
import random

import pytest
from wire_samples import VALID, changed

from ssm_service.errors import InputError
from ssm_service.wire import Heard, SealedDecoder, encoding_of, seal
from ssm_service.wire.messages import INPUTS, MAX_PAYLOAD, EvaluateError, Message

KEY = "ssm/ur3/in/joints"
GOOD = json.dumps(VALID["joints"]).encode()


def decoder(source: str = "joints") -> SealedDecoder[Message]:
    return SealedDecoder(INPUTS[source], f"ssm/ur3/in/{source}")


def sealed(payload: bytes, producer: str = "driver", seq: int = 7, after: Heard | None = None) -> bytes:
    return seal(KEY, producer, seq, payload, after)


def refusal(payload: bytes, attachment: bytes | None, *, required: bool = True) -> tuple[str, str]:
    with pytest.raises(InputError) as caught:
        decoder().decode(payload, attachment, required=required)
    return caught.value.cause, caught.value.fault


def test_a_good_message_comes_with_what_its_attachment_says():
    opened = decoder().decode(GOOD, sealed(GOOD, after=Heard("s", 3)), required=True)
    assert encoding_of(type(opened.message)) == "application/json;ssm.JointState/1"
    assert (opened.sealed, opened.after) == (True, Heard("s", 3))
    opened = decoder().decode(GOOD, None, required=False)
    assert (opened.sealed, opened.after) == (False, None)


def test_a_message_of_no_producer_counts_as_from_nobody():
    payload = b'{"error":"no"}'
    replies = SealedDecoder(EvaluateError, KEY)
    assert replies.decode(payload, seal(KEY, "", 0, payload), required=True).sealed
    with pytest.raises(InputError):
        replies.decode(payload, seal(KEY, "", 1, payload), required=True)


MISTAKES = [
    (json.dumps(changed("joints", position="x")).encode(), "wrong_type"),
    (json.dumps(changed("joints", extra=1)).encode(), "unknown_field"),
    (json.dumps(changed("joints", position=[float("nan")] * 6)).encode(), "not_json"),  # as Python writes it
    (json.dumps({key: VALID["joints"][key] for key in ("producer", "seq")}).encode(), "missing_field"),
]


@pytest.mark.parametrize(("payload", "cause"), MISTAKES)
def test_a_mistake_under_a_right_checksum_is_no_fault_of_the_network(payload, cause):
    assert refusal(payload, sealed(payload)) == (cause, "")
    assert refusal(payload, sealed(payload), required=False) == (cause, "")


@pytest.mark.parametrize("payload", [*(payload for payload, _ in MISTAKES), b"", b"{", b"[" * 9_000, b"\xff"])
def test_the_same_under_a_wrong_checksum_is_corruption(payload):
    assert refusal(payload, sealed(b"another")) == ("corrupt", "corruption")
    assert refusal(payload, sealed(b"another"), required=False) == ("corrupt", "corruption")


def test_what_is_no_message_and_names_nobody_is_a_mistake_only_under_nobodys_checksum():
    assert refusal(b"{", sealed(b"{", producer="", seq=0)) == ("not_json", "")
    assert refusal(b"{", sealed(b"{")) == ("corrupt", "corruption")


def test_without_any_checksum_it_is_malformed_where_none_is_due_and_refused_unread_where_one_is():
    assert refusal(b"{", None, required=False) == ("not_json", "")
    assert refusal(b"{", None) == ("missing_crc", "masquerade")
    assert refusal(GOOD, b"crc32=zz", required=False) == ("bad_attachment", "corruption")


def test_more_than_a_message_can_hold_is_refused_unread():
    for required in (True, False):
        assert refusal(b" " * (MAX_PAYLOAD + 1), None, required=required) == ("too_large", "insertion")


@pytest.mark.parametrize("source", INPUTS)
def test_no_change_of_any_message_on_its_way_is_accepted(source):
    choose = random.Random(source)
    payload = json.dumps(VALID[source]).encode()
    key = f"ssm/ur3/in/{source}"
    attachment = seal(key, VALID[source]["producer"], VALID[source]["seq"], payload)
    decode = decoder(source).decode
    assert decode(payload, attachment, required=True).sealed
    for _ in range(2_000):
        data = bytearray(payload)
        match choose.randrange(4):
            case 0:
                for _ in range(choose.randrange(1, 5)):
                    data[choose.randrange(len(data))] ^= 1 << choose.randrange(8)
            case 1:
                start = choose.randrange(len(data))
                data[start : start + 4] = choose.randbytes(4)
            case 2:
                del data[choose.randrange(len(data)) :]
            case _:
                place = choose.randrange(len(data))
                data[place:place] = bytes([choose.choice(b"0123456789 ")])
        if bytes(data) == payload:
            continue
        with pytest.raises(InputError) as caught:
            decode(bytes(data), attachment, required=True)
        assert caught.value.fault == "corruption"

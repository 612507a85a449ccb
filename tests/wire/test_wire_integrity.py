"""The checksum: right by an implementation of its own; every change of what it covers is noticed."""

from __future__ import annotations

import random

import pytest

from ssm_service.errors import InputError
from ssm_service.wire import Heard, opened, seal
from ssm_service.wire.integrity import MAX_ATTACHMENT, checksum

KEY = "ssm/ur3/in/joints"
PAYLOAD = b'{"producer":"driver","seq":7}'


def bitwise_crc32(data: bytes) -> int:
    """CRC-32 bit by bit, from its definition: polynomial 0x04C11DB7, reflected, all ones before and after."""
    crc = 0xFFFFFFFF
    for byte in data:
        for place in range(8):
            bit = (byte >> place & 1) ^ (crc & 1)
            crc = crc >> 1 ^ (0xEDB88320 if bit else 0)
    return crc ^ 0xFFFFFFFF


def refusal(attachment: bytes | None, *, required: bool = True, **changed: object) -> InputError:
    message = {"key": KEY, "producer": "driver", "seq": 7, "payload": PAYLOAD, **changed}
    with pytest.raises(InputError) as caught:
        opened(**message, attachment=attachment, required=required)  # type: ignore[arg-type]
    return caught.value


def test_the_checksum_is_the_common_one():
    assert bitwise_crc32(b"123456789") == 0xCBF43926  # the check value of every catalogue
    choose = random.Random(1)
    for _ in range(50):
        key, producer = f"ssm/{choose.randrange(99)}/in/x", "pröducer"[: choose.randrange(1, 9)]
        seq, payload = choose.randrange(2**63), choose.randbytes(choose.randrange(200))
        covered = f"{key}\n{producer}\n{seq}\n\n".encode() + payload
        assert seal(key, producer, seq, payload) == f"crc32={bitwise_crc32(covered):08x}".encode()
        heard = Heard("service", choose.randrange(2**63))
        covered = f"{key}\n{producer}\n{seq}\nservice/{heard.seq}\n".encode() + payload
        expected = f"crc32={bitwise_crc32(covered):08x};after=service/{heard.seq}"
        assert seal(key, producer, seq, payload, heard) == expected.encode()


@pytest.mark.parametrize("after", [None, Heard("service", 12), Heard("a/b;c/1", 0), Heard("ö\n", 2**63 - 1)])
@pytest.mark.parametrize("required", [True, False])
def test_what_was_sealed_opens(after, required):
    attachment = seal(KEY, "driver", 7, PAYLOAD, after)
    assert opened(KEY, "driver", 7, PAYLOAD, attachment, required=required) == after


def test_capital_digits_are_as_good():
    text = seal(KEY, "driver", 7, PAYLOAD).decode()
    opened(KEY, "driver", 7, PAYLOAD, f"crc32={text[6:].upper()}".encode(), required=True)


@pytest.mark.parametrize("required", [True, False])
def test_every_inverted_bit_is_noticed(required):
    attachment = seal(KEY, "driver", 7, PAYLOAD, Heard("s", 1))
    for bit in range(8 * len(PAYLOAD)):
        changed = (int.from_bytes(PAYLOAD) ^ 1 << bit).to_bytes(len(PAYLOAD))
        error = refusal(attachment, required=required, payload=changed)
        assert (error.cause, error.fault) == ("corrupt", "corruption")
    for bit in range(8 * len(attachment)):
        changed = (int.from_bytes(attachment) ^ 1 << bit).to_bytes(len(attachment))
        if changed.lower() == attachment:
            continue  # a hexadecimal digit in capitals says the same
        error = refusal(changed, required=required)
        assert error.cause in {"corrupt", "bad_attachment"}
        assert error.fault == "corruption"


@pytest.mark.parametrize(
    "changed", [{"key": "ssm/ur3/in/target"}, {"key": "ssm/ur5/in/joints"}, {"producer": "x"}, {"seq": 8}]
)
def test_another_address_producer_or_sequence_is_noticed(changed):
    assert refusal(seal(KEY, "driver", 7, PAYLOAD), **changed).cause == "corrupt"


def test_a_message_without_a_checksum():
    assert opened(KEY, "driver", 7, PAYLOAD, None, required=False) is None
    error = refusal(None)
    assert (error.cause, error.fault) == ("missing_crc", "masquerade")


@pytest.mark.parametrize(
    "attachment",
    [
        b"",
        b"crc32=",
        b"crc32=123",
        b"crc32=123456789",
        b"crc32=0123456g",
        b" crc32=01234567",
        b"crc32=01234567\n",
        b"crc32=01234567;",
        b"crc32=01234567;after=",
        b"crc32=01234567;after=/1",
        b"crc32=01234567;after=a/",
        b"crc32=01234567;after=a/-1",
        b"crc32=01234567;after=a/1.0",
        b"crc32=01234567;after=a/" + b"1" * 20,
        b"crc32=01234567;after=" + b"a" * 65 + b"/1",
        "crc32=٠١٢٣٤٥٦٧".encode(),
        "crc32=01234567;after=a/١".encode(),
        b"\xff\xfe",
        b"crc32=01234567;after=\xff/1",
        b"x" * (MAX_ATTACHMENT + 1),
        b"\x00" * 1_000_000,
    ],
    ids=lambda attachment: repr(attachment[:30]),
)
@pytest.mark.parametrize("required", [True, False])
def test_an_attachment_of_another_form_is_refused(attachment, required):
    error = refusal(attachment, required=required)
    assert (error.cause, error.fault) == ("bad_attachment", "corruption")
    assert len(str(error)) < 500


def test_text_that_is_no_unicode_raises_nothing_of_its_own():
    assert checksum(KEY, "\ud800", 0, "", b"") == bitwise_crc32(f"{KEY}\n".encode() + b"\xed\xa0\x80\n0\n\n")


FORMS = "crc32=XXXXXXXX or crc32=XXXXXXXX;after=PRODUCER/SEQ"


def test_each_refusal_says_what_was_found_and_what_may_stand_there():
    covered = f"{KEY}\ndriver\n7\n\n".encode() + PAYLOAD
    for attachment, found, allowed in (
        (None, None, FORMS),
        (b"crc32=1", "crc32=1", FORMS),
        (b"\xff" + b"0123456789" * 10, "\ufffd" + "0123456789" * 7 + "012345678", FORMS),
        (b"crc32=000000AB", "crc32=000000ab", f"crc32={bitwise_crc32(covered):08x}"),
    ):
        error = refusal(attachment)
        assert (error.where, error.found, error.allowed) == ("attachment", found, allowed)


def test_what_both_sides_make_of_the_longest_names():
    heard = Heard("\U0001f600" * 64, 10**19 - 1)  # four bytes for each letter
    attachment = seal(KEY, "driver", 7, PAYLOAD, heard)
    assert len(attachment) == 14 + 7 + 256 + 1 + 19 < MAX_ATTACHMENT
    assert opened(KEY, "driver", 7, PAYLOAD, attachment, required=True) == heard

"""What Zenoh delivers, before it is read."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import zenoh

from ssm_service.errors import InputError
from ssm_service.wire import attachment_of, check_sample
from ssm_service.wire.messages import Echo, JointState


def sample(kind: zenoh.SampleKind = zenoh.SampleKind.PUT, encoding: str = "application/json") -> zenoh.Sample:
    attachment = SimpleNamespace(to_bytes=lambda: b"crc32=0")
    return SimpleNamespace(kind=kind, encoding=encoding, attachment=attachment)  # type: ignore[return-value]


def test_a_put_of_the_right_kind_or_of_none_passes():
    for encoding in ("application/json;ssm.Echo/1", "application/json", "zenoh/bytes", "text/plain;x"):
        check_sample(sample(encoding=encoding), Echo)


def test_another_of_our_kinds_is_at_the_wrong_address():
    with pytest.raises(InputError) as caught:
        check_sample(sample(encoding="application/json;ssm.Echo/1"), JointState)
    assert (caught.value.cause, caught.value.fault) == ("wrong_encoding", "addressing")


def test_a_delete_is_nobodys_message():
    with pytest.raises(InputError) as caught:
        check_sample(sample(zenoh.SampleKind.DELETE), Echo)
    assert (caught.value.cause, caught.value.fault) == ("not_put", "insertion")


def test_an_attachment_as_it_came_or_none():
    assert attachment_of(sample()) == b"crc32=0"
    assert attachment_of(SimpleNamespace(attachment=None)) is None  # type: ignore[arg-type]


def test_each_refusal_says_what_was_found_and_what_may_stand_there():
    encoding = "application/json;ssm.Echo/1"
    for wrong, expected in (
        (sample(zenoh.SampleKind.DELETE), ("sample", "a delete", "a put")),
        (
            sample(encoding=encoding),
            ("encoding", encoding, "application/json;ssm.JointState/1, or no schema"),
        ),
    ):
        with pytest.raises(InputError) as caught:
            check_sample(wrong, JointState)
        assert (caught.value.where, caught.value.found, caught.value.allowed) == expected

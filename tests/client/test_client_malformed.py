"""Answers that are no JSON at all are a service's error to the caller, whatever their bytes."""

from __future__ import annotations

import pytest

from ssm_service.client.chunks import outputs
from ssm_service.errors import InputError, ServiceError
from ssm_service.wire import Decoder
from ssm_service.wire import messages as m

DEEP = b"[" * 100_000


@pytest.mark.parametrize(
    "answer", [b'[{"err\x9dr": "no"}]', b'[{"error": "n\xae"}]', b"\xff", DEEP, b"[{}", b"{}"]
)
def test_a_malformed_answer_to_evaluate(answer: bytes) -> None:
    with pytest.raises(ServiceError, match="malformed"):
        outputs(answer, 1)


@pytest.mark.parametrize("explain", [False, True])
def test_a_refusal_is_short_whatever_the_name_of_a_field(explain: bool) -> None:
    payload = b'{"producer":"d","seq":1,"stamp_ns":1,"ranges":[],"' + b"x" * 60_000 + b'":1}'
    with pytest.raises(InputError) as refused:
        Decoder(m.Ranges, explain=explain).decode(payload)
    assert refused.value.cause == "unknown_field"
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize("explain", [False, True])
def test_an_integer_that_no_double_can_hold_is_refused(explain: bool) -> None:
    payload = b'{"position":[0,0,' + b"9" * 400 + b"]}"
    with pytest.raises(InputError) as refused:
        Decoder(m.FramesRequest, explain=explain).decode(payload)
    assert refused.value.cause == "out_of_range"

"""A message without a checksum, where none is due, and one longer than messages commonly are."""

from __future__ import annotations

import json

import pytest
from wire_samples import VALID

from ssm_service.errors import InputError
from ssm_service.wire import SealedDecoder
from ssm_service.wire import messages as m

KEY = "ssm/ur3/in/ranges"
GOOD = json.dumps(VALID["ranges"]).encode()


def test_a_message_without_a_checksum_is_the_same_message() -> None:
    opened = SealedDecoder(m.Ranges, KEY).decode(GOOD, None, required=False)
    assert opened.message == m.Ranges(**VALID["ranges"])
    assert (opened.sealed, opened.after) == (False, None)


def test_a_limit_of_its_own_is_the_only_one() -> None:
    long = GOOD + b" " * m.MAX_PAYLOAD
    with pytest.raises(InputError):
        SealedDecoder(m.Ranges, KEY).decode(long, None, required=False)
    opened = SealedDecoder(m.Ranges, KEY, 2 * m.MAX_PAYLOAD).decode(long, None, required=False)
    assert opened.message.seq == VALID["ranges"]["seq"]

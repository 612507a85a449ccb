"""A refusal of the parser in words that nobody foresaw is one of a wrong type."""

from __future__ import annotations

from typing import Annotated

import pytest
from msgspec import Meta

from ssm_service.errors import InputError
from ssm_service.wire import Decoder
from ssm_service.wire import messages as m


class Patterned(m.Message, frozen=True, kw_only=True):
    """A message with a constraint that no message of ours has."""

    word: Annotated[str, Meta(pattern="^a")]


def test_words_that_nobody_foresaw_are_a_wrong_type() -> None:
    assert Decoder(Patterned).decode(b'{"word": "ab"}').word == "ab"
    for explain in (False, True):
        with pytest.raises(InputError) as caught:
            Decoder(Patterned, explain=explain).decode(b'{"word": "b"}')
        assert (caught.value.cause, caught.value.where) == ("wrong_type", "word")

"""Names that a robot may have on the network."""

from __future__ import annotations

import pytest

from ssm_service.errors import ConfigError
from ssm_service.wire.keys import Keys


@pytest.mark.parametrize("name", ["a", "_", "UR3", "left.arm-2_x", "0", "x" * 64])
def test_letters_digits_and_three_signs_are_a_name(name: str) -> None:
    assert Keys(name).output("zone") == f"ssm/{name}/zone"


@pytest.mark.parametrize("name", ["", "-a", ".a", "a/b", "a b", "a*", "ä", "x" * 65, "a\n", "$a"])
def test_anything_else_is_refused_as_the_option_that_it_comes_from(name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Keys(name)
    error = caught.value
    assert (error.file, error.key, error.found) == ("--name", "", name)
    assert error.allowed == "1 to 64 letters, digits, '_', '-' or '.'"

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from ssm_service.errors import InputError
from ssm_service.model import Robot
from ssm_service.wire import VALUES, Decoder
from ssm_service.wire.messages import INPUTS

Accept = Callable[[str, bytes], Any]
Refused = Callable[[str, bytes | dict[str, Any]], InputError]


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot.load("ur3")


@pytest.fixture(scope="session")
def accept(robot: Robot) -> Accept:
    """Take an input message from bytes to the monitor's value, as the service does."""
    decoders = {source: Decoder(kind) for source, kind in INPUTS.items()}

    def accept(source: str, payload: bytes) -> Any:
        message = decoders[source].decode(payload)
        return VALUES[source](robot, message)

    return accept


@pytest.fixture(scope="session")
def refused(accept: Accept) -> Refused:
    """Return the refusal of a message that must not pass."""

    def refused(source: str, payload: bytes | dict[str, Any]) -> InputError:
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        with pytest.raises(InputError) as caught:
            accept(source, data)
        assert caught.value.where
        assert caught.value.allowed
        assert len(str(caught.value)) < 500
        return caught.value

    return refused

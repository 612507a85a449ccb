"""``ssm reset``: acknowledge what a service has latched."""

from __future__ import annotations

from .options import (
    ConnectOption,
    FollowedOption,
    JsonOption,
    TimeoutOption,
    ZenohConfigOption,
    checked_timeout,
    endpoints,
)
from .output import emit, emit_json


def reset(
    name: FollowedOption = "ur3",
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 1.0,
    json: JsonOption = False,
) -> None:
    """Acknowledge a stop that errors on the network have latched; says what they were.

    Look for their cause first: a second one within the profile's
    `latch.interval_s` latches again. The zone comes back by itself, after its
    good ticks.
    """
    checked_timeout(timeout)
    from ..client import Client

    with Client(
        name, connect=endpoints(connect, zenoh_config), zenoh_config=zenoh_config, timeout_s=timeout
    ) as client:
        reply = client.reset()
    if json:
        emit_json(reply)
    elif reply.cleared is None:
        emit(f"{reply.robot}: nothing was latched")
    else:
        emit(f"{reply.robot}: cleared: {reply.cleared}")

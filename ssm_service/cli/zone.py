"""``ssm zone``: the zone of a running service, once."""

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
from .words import zone_line


def zone(
    name: FollowedOption = "ur3",
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 1.0,
    json: JsonOption = False,
) -> None:
    """Ask a running service for its zone, once."""
    checked_timeout(timeout)
    from ..client import Client

    with Client(
        name, connect=endpoints(connect, zenoh_config), zenoh_config=zenoh_config, timeout_s=timeout
    ) as client:
        message = client.zone()
    if json:
        emit_json(message)
    else:
        emit(zone_line(message))

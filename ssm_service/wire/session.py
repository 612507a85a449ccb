"""Zenoh sessions as this service needs them: no scouting, short leases, small buffers, real-time queues."""

from __future__ import annotations

import json
import os
import re
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import zenoh

from ..errors import ConfigError, ServiceError, listed

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Where a service listens, and its consumers dial, when nothing else is said."""

CLOSE_TIMEOUT_S = 0.3
NETWORK_NICE = -15
_closing: list[threading.Thread] = []

Mode = Literal["router", "client", "peer"]

COMMON: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # A frozen process is noticed after the lease; the sender announces its own.
    "transport/link/tx/lease": 100,
    "transport/link/tx/keep_alive": 4,
    # With the default of 2, DROP loses samples on a healthy loopback.
    "transport/link/tx/queue/size/real_time": 16,
    "transport/link/tx/queue/size/interactive_high": 16,
    # Small buffers keep what a frozen consumer finds on waking short.
    "transport/link/tcp/so_sndbuf": 8192,
    "transport/link/tcp/so_rcvbuf": 8192,
    # What waits to be read holds on to whole batches: a quarter of the default size, and more of them for
    # what is longer than one.
    "transport/link/tx/batch_size": 16_384,
    "transport/link/tx/queue/size/data": 16,
    "transport/link/rx/max_message_size": 4 * 1024 * 1024,
    "transport/shared_memory/enabled": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
}

# The protocols that Zenoh's Python package is built with.
_NETWORK = ("tcp", "udp", "tls", "quic", "ws")
_OTHER = ("unixsock-stream",)


def zenoh_config(
    mode: Mode,
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    file: str | Path | None = None,
    patient: bool = True,
) -> zenoh.Config:
    """Return a Zenoh configuration.

    Args:
        mode: The session's mode. The service is a ``router``, so that it passes queries on to its own
            evaluating process; programs that use it are ``client``.
        listen: Endpoints to listen on, e.g. ``tcp/127.0.0.1:7447``.
        connect: Endpoints to dial.
        file: A Zenoh configuration file to start from instead of our values. Its mode holds where it names
            one; ``listen`` is added to its endpoints, ``connect`` replaces those that it dials.
        patient: Whether opening may go on in the background while an endpoint is not there yet.

    Raises:
        ConfigError: The file or an endpoint is not acceptable to Zenoh.
    """
    _check_endpoints("--listen", listen)
    _check_endpoints("--connect", connect)
    config = zenoh.Config() if file is None else _from_file(file)
    settings: dict[str, Any] = {}
    if file is None:
        settings.update(COMMON)
    if file is None or json.loads(config.get_json("mode")) is None:
        settings["mode"] = mode
    if file is None:
        settings["listen/endpoints"] = list(listen)
    elif listen:
        settings["listen/endpoints"] = [*_listen_endpoints(config, mode), *listen]
    if connect or file is None:
        settings["connect/endpoints"] = list(connect)
    if connect and mode != "client":
        settings["connect/exit_on_failure"] = not patient
        settings["connect/timeout_ms"] = -1 if patient else 1000
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigError(file or "Zenoh", key, value, _said(error)) from error
    return config


def _check_endpoints(option: str, endpoints: Sequence[str]) -> None:
    for endpoint in endpoints:
        if not _is_endpoint(endpoint):
            allowed = f"PROTOCOL/HOST:PORT, for example {DEFAULT_ENDPOINT}"
            raise ConfigError(
                option, "", endpoint, f"{allowed}; the protocols are {listed(_NETWORK + _OTHER)}"
            )


def _is_endpoint(endpoint: str) -> bool:
    protocol, _, address = endpoint.partition("/")
    if protocol in _OTHER:
        return re.fullmatch(r"\S+", address) is not None
    found = re.fullmatch(r"(?:\[[^\s/\[\]]+\]|[^\s/:\[\]]+):(\d{1,5})(?:[?#]\S*)?", address)
    return protocol in _NETWORK and found is not None and int(found[1]) <= 65535


def _from_file(file: str | Path) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(str(file))
    except (zenoh.ZError, OSError, ValueError) as error:
        raise ConfigError(file, "", _said(error), "a Zenoh configuration in JSON5, JSON or YAML") from error


def _listen_endpoints(config: zenoh.Config, mode: Mode) -> list[str]:
    """Return where a file says to listen; Zenoh's own default, every interface, counts as nothing said."""
    found = json.loads(config.get_json("listen/endpoints"))
    if found == json.loads(zenoh.Config().get_json("listen/endpoints")):
        return []
    if isinstance(found, dict):
        found = found.get(json.loads(config.get_json("mode")) or mode, [])
    return [found] if isinstance(found, str) else list(found)


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session.

    Raises:
        ServiceError: An endpoint cannot be listened on or dialled.
    """
    try:
        with _favoured():
            return zenoh.open(config)
    except zenoh.ZError as error:
        raise ServiceError(f"Zenoh session could not be opened: {_said(error)}") from error


@contextmanager
def _favoured() -> Iterator[None]:
    """Have the threads that are made meanwhile favoured by the scheduler, where that is permitted.

    Every decision and every input goes through Zenoh's own threads; an ordinary process must not keep them
    waiting for longer than a decision is valid. They do not become real-time threads: under a flood of
    messages these would take the time that the loop needs.
    """
    before = os.getpriority(os.PRIO_PROCESS, 0)  # of the calling thread, on Linux
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, min(before, NETWORK_NICE))
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)


def close_session(session: zenoh.Session, timeout_s: float = CLOSE_TIMEOUT_S) -> None:
    """Close a session, but wait no longer than ``timeout_s`` for it.

    Zenoh takes up to ten seconds to say goodbye to a frozen peer. What is not done in time goes on in a
    thread; a process in which ``still_closing`` then ends by ``os._exit``, because the interpreter must not
    end under a thread that is inside Zenoh.
    """
    thread = threading.Thread(target=session.close, name="ssm-closing", daemon=True)
    thread.start()
    thread.join(timeout_s)
    _closing.append(thread)


def still_closing() -> bool:
    """Tell whether a session that was closed has not yet come to its end."""
    return any(thread.is_alive() for thread in _closing)


def _said(error: Exception) -> str:
    """Return what Zenoh said, without the places in its own source and its own notation."""
    text = re.sub(r" at /\S+:\d+\.?", "", str(error))
    text = re.sub(r"\bSingle\(([^()]*)\)", r"\1", text)
    return re.sub(r"#so_rcvbuf=\d+;so_sndbuf=\d+", "", text).rstrip("!. ")

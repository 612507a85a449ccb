"""Which endpoints of a configuration let strangers in: beyond this machine, and without mutual TLS."""

from __future__ import annotations

import ipaddress
import json
import re
from dataclasses import dataclass
from typing import Any, Final

import zenoh

SECURE: Final = ("tls", "quic")
"""Protocols that can prove who is at the other end."""

_LOCAL: Final = ("unixsock-stream", "unixpipe")
_TLS: Final = "transport/link/tls"


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """One endpoint at which nobody has to prove who they are.

    Attributes:
        key: Where it stands in the configuration, ``listen/endpoints`` or ``connect/endpoints``.
        endpoint: The endpoint.
        why: What is missing.
    """

    key: str
    endpoint: str
    why: str

    def __str__(self) -> str:
        verb = "listens at" if self.key.startswith("listen") else "dials"
        return f"{verb} {self.endpoint}, {self.why}"


def exposures(config: zenoh.Config) -> tuple[Exposure, ...]:
    """Return the endpoints beyond this machine, listened on or dialled, that are not under mutual TLS.

    A listener must ask for a certificate (``enable_mtls``), or anybody gets in. Who dials must know the
    authority and verify the name, or anybody may answer.
    """
    tls = _read(config, _TLS) or {}
    found = [
        Exposure(key="listen/endpoints", endpoint=endpoint, why=why)
        for endpoint in endpoints(config, "listen/endpoints")
        if (why := _weakness(endpoint, tls, listens=True))
    ]
    found += [
        Exposure(key="connect/endpoints", endpoint=endpoint, why=why)
        for endpoint in endpoints(config, "connect/endpoints")
        if (why := _weakness(endpoint, tls, listens=False))
    ]
    return tuple(found)


def unchecked_rights(config: zenoh.Config) -> bool:
    """Tell whether everybody who gets in from beyond this machine may do everything."""
    control = _read(config, "access_control") or {}
    closed = control.get("enabled") is True and control.get("default_permission") == "deny"
    beyond = [
        endpoint
        for key in ("listen/endpoints", "connect/endpoints")
        for endpoint in endpoints(config, key)
        if not is_local(endpoint)
    ]
    return bool(beyond) and not closed


def endpoints(config: zenoh.Config, key: str) -> list[str]:
    """Return the endpoints of a key for the configuration's mode, given for all modes or for each."""
    found = _read(config, key)
    if isinstance(found, dict):
        found = found.get(_read(config, "mode") or "peer")
    return [str(endpoint) for endpoint in found or ()]


def is_local(endpoint: str) -> bool:
    """Tell whether only this machine reaches an endpoint.

    A host name counts as beyond it, save ``localhost``: where it leads is decided elsewhere.
    """
    if protocol_of(endpoint) in _LOCAL:
        return True
    host = re.sub(r":\d+$", "", re.split(r"[?#]", endpoint.partition("/")[2])[0]).strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def protocol_of(endpoint: str) -> str:
    """Return the protocol of an endpoint, e.g. ``tcp``."""
    return endpoint.partition("/")[0].lower()


def _weakness(endpoint: str, tls: dict[str, Any], *, listens: bool) -> str | None:
    """Return what an endpoint lacks; an endpoint's own settings, after ``#``, come before the common ones."""
    if is_local(endpoint):
        return None
    if protocol_of(endpoint) not in SECURE:
        return "without TLS"
    own = dict(part.partition("=")[::2] for part in endpoint.partition("#")[2].split(";"))
    if listens:
        asked = own.get("enable_mtls", str(tls.get("enable_mtls") is True).lower())
        return None if asked == "true" else "with TLS, but enable_mtls is not true"
    verified = own.get("verify_name_on_connect", str(tls.get("verify_name_on_connect") is not False).lower())
    return None if verified == "true" else "with TLS, but verify_name_on_connect is false"


def _read(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))

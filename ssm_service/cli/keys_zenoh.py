"""The Zenoh configuration of one party: mutual TLS, everything denied but what its role needs."""

from __future__ import annotations

import json
from pathlib import PurePosixPath
from typing import Any, Final

from ..wire.messages import MAX_PAYLOAD
from ..wire.session import COMMON
from .keys_network import ROUTER, Member, evaluating
from .keys_roles import access_control

MAX_SESSIONS: Final = {ROUTER: 256, "service": 64}
ACCEPT_TIMEOUT_MS: Final = 2000
ATTACHMENT: Final = 1024
"""Room for an attachment beside the greatest payload [bytes]."""

AUTHORITY_FILE: Final = "authority.crt"
CERTIFICATE_FILE: Final = "own.crt"
KEY_FILE: Final = "own.key"
CONFIG_FILE: Final = "zenoh.json5"

_WORDS: Final = {
    "mode": "A router passes on what others may hear; a client has one link, to where it dials.",
    "listen": "Only who has a certificate of this network's authority gets in.",
    "connect": "The other side must be certified for the name or address that is dialled.",
    "scouting": "Nobody is searched for, and nobody is told of others.",
    "transport": "Short leases and small buffers [ms, bytes]; a link ends when its certificate does.",
    "access_control": "Everything is denied but this: keys and directions of each certificate's name.",
    "low_pass_filter": "What is longer than any message of this kind ends here [bytes].",
    "adminspace": "Nothing can be asked or changed from outside.",
}


def configuration(member: Member, folder: PurePosixPath) -> dict[str, Any]:
    """Return a party's configuration.

    Args:
        member: The party.
        folder: Where its files will lie when it starts.
    """
    passes_on = member.role in (ROUTER, "service")
    config: dict[str, Any] = {
        "mode": "router" if passes_on else "client",
        "metadata": {"name": member.name},
        "listen": {"endpoints": [member.listens] if member.listens else []},
        "connect": _connect(member),
        "scouting": _nested("scouting"),
        "transport": _transport(member, folder),
        "access_control": access_control(member.others, mirrored=member.mirrored),
        "adminspace": {"enabled": False},
    }
    if member.role == "service" and member.mirrored:
        config["access_control"] = _with_evaluating(member)
    if not passes_on:
        del config["listen"]
    if member.listens:
        config["low_pass_filter"] = _size_limits()
    return config


def configuration_text(member: Member, folder: PurePosixPath) -> str:
    """Return a party's configuration as JSON5, with a line of explanation for each section."""
    robots = ", ".join(f"`{robot}`" for robot in member.robots)
    lines = [f"// {member.name}: {member.role} for {robots}. Made by `ssm keys`.", "{"]
    for key, value in configuration(member, folder).items():
        if key in _WORDS:
            lines.append(f"  // {_WORDS[key]}")
        text = json.dumps(value, indent=2).replace("\n", "\n  ")
        lines.append(f'  "{key}": {text},')
    return "\n".join([*lines, "}", ""])


def _connect(member: Member) -> dict[str, Any]:
    connect: dict[str, Any] = {"endpoints": [member.dials] if member.dials else []}
    if member.dials:
        connect["retry"] = COMMON["connect/retry"]
        if member.role == "service":  # its router may come later, or go and come again
            connect |= {"timeout_ms": -1, "exit_on_failure": False}
    return connect


def _transport(member: Member, folder: PurePosixPath) -> dict[str, Any]:
    transport = _nested("transport")
    link = transport["link"]
    link["protocols"] = ["tls", "unixsock-stream"] if member.role == "service" else ["tls"]
    buffers = link.pop("tcp")
    side = "listen" if member.listens else "connect"
    link["tls"] = {
        "root_ca_certificate": str(folder / AUTHORITY_FILE),
        f"{side}_certificate": str(folder / CERTIFICATE_FILE),
        f"{side}_private_key": str(folder / KEY_FILE),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
        **buffers,
    }
    if member.listens:
        transport["unicast"] = {
            "max_sessions": MAX_SESSIONS[member.role],
            "accept_timeout": ACCEPT_TIMEOUT_MS,
        }
    return transport


def _with_evaluating(member: Member) -> dict[str, Any]:
    """Return the access rules of a service that dials: its own rights there, and its evaluating process."""
    outer = access_control(member.others, mirrored=True)
    inner = access_control([evaluating(member.robots[0])])
    return {key: outer[key] + inner[key] if isinstance(outer[key], list) else outer[key] for key in outer}


def _size_limits() -> list[dict[str, Any]]:
    """Bound what may enter; ``evaluate`` has the transport's own bound, ``max_message_size``."""
    names = ["in/*", "zone", "command", "separation", "config", "health", "reset", "frames"]
    return [
        {
            "id": "sizes",
            "flows": ["ingress"],
            "messages": ["put", "delete", "query"],
            "key_exprs": [f"ssm/*/{name}" for name in names],
            "size_limit": MAX_PAYLOAD + ATTACHMENT,
        }
    ]


def _nested(section: str) -> dict[str, Any]:
    """Return the package's own settings of a section, nested as a file has them."""
    found: dict[str, Any] = {}
    for key, value in COMMON.items():
        head, *middle, last = key.split("/")
        if head == section:
            place = found
            for part in middle:
                place = place.setdefault(part, {})
            place[last] = value
    return found

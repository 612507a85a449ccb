"""What is wrong or weak in a Zenoh configuration, for a service that moves a robot."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import zenoh

from ..errors import ConfigError, ServiceError, listed
from ..wire.exposure import SECURE, is_local, protocol_of
from ..wire.session import zenoh_config
from .findings import Finding, Report

LONG_LEASE_MS: Final = 1000
SMALL_QUEUE: Final = 16


class Settings:
    """A loaded configuration, read by key.

    Args:
        file: The file.

    Raises:
        ConfigError: Zenoh does not accept it.
    """

    def __init__(self, file: Path) -> None:
        if not file.is_file():
            raise ConfigError(file, "", "no such file", "a Zenoh configuration in JSON5, JSON or YAML")
        self._config = zenoh_config("router", file=file)
        self.mode: str = self.get("mode") or "peer"

    def get(self, key: str) -> Any:
        """Return the value of a key; ``None`` where Zenoh has no such key here."""
        try:
            return json.loads(self._config.get_json(key))
        except (zenoh.ZError, ValueError):
            return None

    def of_mode(self, key: str) -> Any:
        """Return a value that may be given for each mode: the one of this mode."""
        value = self.get(key)
        if isinstance(value, dict) and value.keys() & {"router", "peer", "client"}:
            return value.get(self.mode)
        return value

    def endpoints(self, key: str) -> list[str]:
        """Return endpoints, however they are written."""
        value = self.of_mode(key) or []
        return [value] if isinstance(value, str) else [str(endpoint) for endpoint in value]


def check_zenoh(file: Path) -> Report:
    """Check a Zenoh configuration.

    Raises:
        ConfigError: It cannot be read.
    """
    settings = Settings(file)
    findings = [Finding("ok", "", f"Zenoh {version('eclipse-zenoh')} reads it; mode {settings.mode}")]
    for rule in (_mode, _listening, _scouting, _tls, _access, _timing, _open_doors):
        findings.extend(rule(settings))
    return Report(str(file), "zenoh", findings)


def _mode(settings: Settings) -> Iterator[Finding]:
    if settings.mode == "client" and settings.endpoints("listen/endpoints"):
        yield Finding("fault", "mode", "'client' never listens, but listen/endpoints names some")
    elif settings.mode != "router":
        text = f"'{settings.mode}': right for consumers; `ssm run` needs 'router' to pass queries on"
        yield Finding("note", "mode", text)


def _listening(settings: Settings) -> Iterator[Finding]:
    if settings.mode == "client":
        return
    for endpoint in settings.endpoints("listen/endpoints"):
        if is_local(endpoint):
            yield Finding("ok", "listen/endpoints", f"{endpoint}: this machine only")
        elif protocol_of(endpoint) in SECURE:
            yield Finding("note", "listen/endpoints", f"{endpoint}: beyond this machine, encrypted")
        else:
            text = f"{endpoint}: beyond this machine without TLS; whoever reaches it can send and read all"
            yield Finding("weak", "listen/endpoints", text)
    for endpoint in settings.endpoints("connect/endpoints"):
        if not is_local(endpoint) and protocol_of(endpoint) not in SECURE:
            text = (
                f"{endpoint}: dialled without TLS; anybody on the way can answer instead, send and read all"
            )
            yield Finding("weak", "connect/endpoints", text)
    if settings.endpoints("listen/endpoints") and settings.endpoints("connect/endpoints"):
        text = "listens and dials; if the other side dials back, a session may split: let one side dial only"
        yield Finding("note", "connect/endpoints", text)


def _scouting(settings: Settings) -> Iterator[Finding]:
    if settings.get("scouting/multicast/enabled") is not False:
        text = "on (Zenoh's default): strangers on the same network find this session; set it to false"
        yield Finding("weak", "scouting/multicast/enabled", text)
    if settings.get("scouting/gossip/enabled") is not False:
        text = "on (Zenoh's default): sessions learn of each other through third ones; set it to false"
        yield Finding("weak", "scouting/gossip/enabled", text)


def _tls(settings: Settings) -> Iterator[Finding]:
    tls = settings.get("transport/link/tls") or {}
    listens = [e for e in settings.endpoints("listen/endpoints") if protocol_of(e) in SECURE]
    dials = [e for e in settings.endpoints("connect/endpoints") if protocol_of(e) in SECURE]
    if listens and settings.mode != "client":
        for key in ("listen_certificate", "listen_private_key"):
            if not (tls.get(key) or tls.get(f"{key}_base64")):
                yield Finding(
                    "fault", f"transport/link/tls/{key}", f"missing, but {listed(listens)} needs it"
                )
        if tls.get("enable_mtls") is not True:
            text = "not true: any client gets in, whatever its certificate"
            yield Finding("weak", "transport/link/tls/enable_mtls", text)
    if dials and tls.get("verify_name_on_connect") is False:
        yield Finding(
            "weak", "transport/link/tls/verify_name_on_connect", "false: any certified host may answer"
        )
    if (listens or dials) and tls.get("close_link_on_expiration") is not True:
        text = "not true: whoever is connected when its certificate expires stays connected"
        yield Finding("weak", "transport/link/tls/close_link_on_expiration", text)
    for key, name in tls.items():
        if name and key.endswith(("certificate", "private_key")):
            yield from _file(key, Path(str(name)))


def _file(key: str, path: Path) -> Iterator[Finding]:
    key = f"transport/link/tls/{key}"
    try:
        mode = path.stat().st_mode
    except OSError as error:
        yield Finding("fault", key, f"{path}: {error.strerror}")
        return
    if key.endswith("certificate"):
        yield from _validity(key, path)
    if key.endswith("private_key") and mode & 0o077:
        yield Finding(
            "weak", key, f"{path}: others than its owner can read or change it (mode {mode & 0o777:03o})"
        )


def _validity(key: str, path: Path) -> Iterator[Finding]:
    from .keys_certificates import EXPIRES_SOON_DAYS, read_certificate

    try:
        certificate = read_certificate(path)
    except ServiceError as error:
        yield Finding("note", key, f"{path}: not looked into; {error}")
        return
    except ConfigError as error:
        yield Finding("fault", key, str(error))
        return
    left, ends = certificate.days_left(), f"{certificate.ends:%Y-%m-%d %H:%M} UTC"
    if left <= 0:
        yield Finding("fault", key, f"{path}: expired at {ends}: nobody will accept it")
    elif left < EXPIRES_SOON_DAYS:
        text = f"{path}: expires in {left:.1f} days, at {ends}; then links end and the robot stops"
        yield Finding("weak", key, text)
    else:
        yield Finding("ok", key, f"{path}: valid until {ends}")


def _access(settings: Settings) -> Iterator[Finding]:
    control = settings.get("access_control") or {}
    beyond = [e for e in settings.endpoints("listen/endpoints") if not is_local(e)]
    if not control.get("enabled"):
        if beyond and settings.mode != "client":
            text = "off: every connected program may publish inputs and commands on every key"
            yield Finding("weak", "access_control", text)
    elif control.get("default_permission") != "deny":
        text = "what no rule names is allowed; 'deny' is the safe default"
        yield Finding("weak", "access_control/default_permission", text)


def _timing(settings: Settings) -> Iterator[Finding]:
    lease = settings.of_mode("transport/link/tx/lease")
    if isinstance(lease, int) and lease > LONG_LEASE_MS:
        text = f"{lease} ms: so long may a frozen process keep its liveliness; `ssm` itself uses 100"
        yield Finding("weak", "transport/link/tx/lease", text)
    for queue, what in (("real_time", "decisions"), ("interactive_high", "commands")):
        key = f"transport/link/tx/queue/size/{queue}"
        size = settings.of_mode(key)
        if isinstance(size, int) and size < SMALL_QUEUE:
            text = f"{size}: {what} are dropped even on a healthy link; `ssm` itself uses {SMALL_QUEUE}"
            yield Finding("weak", key, text)


def _open_doors(settings: Settings) -> Iterator[Finding]:
    admin = settings.get("adminspace") or {}
    if admin.get("enabled") and (admin.get("permissions") or {}).get("write"):
        yield Finding(
            "weak", "adminspace/permissions/write", "true: the configuration can be changed from outside"
        )
    plugins = settings.get("plugins") or {}
    for name in plugins:
        text = "Zenoh's Python package loads no plugins: this section does nothing in `ssm`"
        if name == "rest":
            text = "a router that loads it serves every key over plain HTTP"
        yield Finding("weak", f"plugins/{name}", text)

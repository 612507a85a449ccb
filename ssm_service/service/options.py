"""How to run the service and its evaluating process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError

MIN_RATE_HZ, MAX_RATE_HZ = 50, 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerOptions:
    """What the service tells its evaluating process.

    Attributes:
        robot_file: Path of the robot file.
        profile: Zone profile.
        name: Name of the robot on the network.
        endpoint: Where the service listens for its evaluating process.
    """

    robot_file: str
    profile: str
    name: str
    endpoint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceOptions:
    """How to run the service.

    Attributes:
        robot: Name or path of a robot file.
        name: Name of the robot on the network; the file's where left out.
        profile: Zone profile; the file's default where left out.
        rate_hz: Ticks per second.
        listen: Endpoints to listen on; the default one where neither this, ``connect`` nor a file says so.
        connect: Endpoints to dial, e.g. a router's.
        zenoh_config: Zenoh configuration file to start from.
        seconds: End by itself after this time.
        state: Folder in which a latched stop is kept; by default ``ssm-service`` in the user's state folder.
        insecure: Run although an endpoint beyond this machine is not under mutual TLS; ``health`` says so.
    """

    robot: str = "ur3"
    name: str | None = None
    profile: str | None = None
    rate_hz: float = 500.0
    listen: Sequence[str] = ()
    connect: Sequence[str] = ()
    zenoh_config: Path | None = None
    seconds: float | None = None
    state: Path | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        if not MIN_RATE_HZ <= self.rate_hz <= MAX_RATE_HZ:
            raise ConfigError("--rate", "", self.rate_hz, f"{MIN_RATE_HZ} to {MAX_RATE_HZ} Hz")

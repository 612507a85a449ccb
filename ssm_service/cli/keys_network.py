"""Who is on a network of robots: the parties that need a certificate, and who dials whom."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from ..errors import ConfigError
from ..wire import Keys
from .keys_roles import EVALUATING, ROLES, Party

ROUTER: Final = "router"
COMMON_NAME_LENGTH: Final = 64
FOR_EACH_ROBOT: Final = ("service", "driver", "commander")


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """One party that gets a certificate and a configuration.

    Attributes:
        name: Common name, and the name of its folder: ``driver-left``, ``viewer``, ``router``.
        role: Its role, a key of ``ROLES``, or ``router``.
        robots: The robots that it has to do with.
        listens: Endpoint at which it listens; ``None`` for one that dials.
        dials: Endpoint that it dials, ``None`` for one that listens.
        hosts: Names and addresses under which it is dialled.
        others: Who may be at the other end of its links.
    """

    name: str
    role: str
    robots: tuple[str, ...]
    listens: str | None = None
    dials: str | None = None
    hosts: tuple[str, ...] = ()
    others: tuple[Party, ...] = ()

    @property
    def mirrored(self) -> bool:
        """Whether the rights in ``others`` are its own: those of one who dials."""
        return self.listens is None


@dataclass(frozen=True, slots=True, kw_only=True)
class Network:
    """How the parties are connected.

    Attributes:
        robots: Names of the robots.
        hosts: Names and addresses under which the listeners are dialled; the first is the one to dial.
        router: Whether all dial a router; otherwise each service listens, at a port of its own.
        port: First port.
        simulation: Whether a simulation stands for each robot, besides its drivers.

    Raises:
        ConfigError: A name does not fit.
    """

    robots: tuple[str, ...]
    hosts: tuple[str, ...] = ("127.0.0.1",)
    router: bool = False
    port: int = 7447
    simulation: bool = False

    def __post_init__(self) -> None:
        longest = COMMON_NAME_LENGTH - 1 - max(map(len, ROLES))
        for robot in self.robots:
            Keys(robot)
            if len(robot) > longest:
                raise ConfigError("--robot", "", robot, f"at most {longest} characters, for a certificate")
        if not self.robots or len(set(self.robots)) < len(self.robots):
            raise ConfigError("--robot", "", ",".join(self.robots), "one or more names, each once")
        if not self.hosts:
            raise ConfigError("--host", "", "", "one or more names or addresses")
        if not 1 <= self.port <= 65536 - len(self.robots):
            raise ConfigError("--port", "", self.port, f"1 to {65536 - len(self.robots)}")

    def members(self) -> list[Member]:
        """Return all parties, the ones that listen first."""
        if self.router:
            return list(self._round_a_router())
        return [member for index, robot in enumerate(self.robots) for member in self._alone(robot, index)]

    def _round_a_router(self) -> Iterator[Member]:
        dialling = [
            Party(name=f"{role}-{robot}", rights=ROLES[role], robots=(robot,))
            for robot in self.robots
            for role in self._roles()
        ]
        dialling.append(Party(name="viewer", rights=ROLES["viewer"], robots=self.robots))
        yield Member(
            name=ROUTER,
            role=ROUTER,
            robots=self.robots,
            listens=self._listened(self.port),
            hosts=self.hosts,
            others=tuple(dialling),
        )
        for party in dialling:
            yield self._dialling(party, ROUTER, self.port)

    def _alone(self, robot: str, index: int) -> Iterator[Member]:
        dialling = [
            Party(name=f"{role}-{robot}", rights=ROLES[role], robots=(robot,))
            for role in (*self._roles(), "viewer")
            if role != "service"
        ]
        service = f"service-{robot}"
        yield Member(
            name=service,
            role="service",
            robots=(robot,),
            listens=self._listened(self.port + index),
            hosts=self.hosts,
            others=(*dialling, evaluating(robot)),
        )
        for party in dialling:
            yield self._dialling(party, service, self.port + index)

    def _dialling(self, party: Party, listener: str, port: int) -> Member:
        role = party.name.partition("-")[0]
        other = Party(name=listener, rights=party.rights, robots=party.robots)
        return Member(
            name=party.name,
            role=role,
            robots=party.robots,
            dials=f"tls/{_bracketed(self.hosts[0])}:{port}",
            others=(other,),
        )

    def _roles(self) -> Sequence[str]:
        return (*FOR_EACH_ROBOT, "simulation") if self.simulation else FOR_EACH_ROBOT

    def _listened(self, port: int) -> str:
        """Return where to listen: on this machine alone where only it is to dial, else everywhere."""
        if all(host in ("localhost", "127.0.0.1", "::1") for host in self.hosts):
            return f"tls/{_bracketed(self.hosts[0])}:{port}"
        return f"tls/[::]:{port}" if ":" in self.hosts[0] else f"tls/0.0.0.0:{port}"


def evaluating(robot: str) -> Party:
    """Return a service's own evaluating process, at the other end of its private socket."""
    return Party(name="evaluating", rights=EVALUATING, robots=(robot,), protocol="unixsock-stream")


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host

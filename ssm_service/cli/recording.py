"""What a consumer of one service hears, kept as it arrived."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import zenoh

from ..errors import InputError
from ..safety import Zone
from ..wire import Decoder, Keys, names_another
from ..wire import messages as m

CAPACITY: Final = 4096
HEALTH_PERIOD_S: Final = 0.5
HEALTH_TIMEOUT_S: Final = 1.0


class DecisionRow(NamedTuple):
    """One ``Zone`` message.

    Attributes:
        t: Time of arrival [s] since the recording began.
        seq: Its number.
        zone: The zone.
        exact: [m] what the tracked obstacles say, by the exact distance.
        estimated: [m] what the sensor rings say.
        limit: (n,), [rad/s].
        reasons: Why.
    """

    t: float
    seq: int
    zone: Zone
    exact: float | None
    estimated: float | None
    limit: tuple[float, ...]
    reasons: tuple[str, ...]


class CommandRow(NamedTuple):
    """One ``VelocityCommand`` message: ``velocity`` (n,), [rad/s]."""

    t: float
    seq: int
    velocity: tuple[float, ...]


class JointRow(NamedTuple):
    """One ``JointState`` message: ``position`` (n,), [rad], and measured ``velocity`` (n,), [rad/s]."""

    t: float
    position: tuple[float, ...]
    velocity: tuple[float, ...]


class ObstacleRow(NamedTuple):
    """One ``Obstacles`` message."""

    t: float
    obstacles: tuple[m.ObstacleEntry, ...]


class HealthRow(NamedTuple):
    """One answer to a ``health`` query."""

    t: float
    health: m.Health


class StopRow(NamedTuple):
    """A stop of the consumer's own watchdog, from its beginning to its end [s]."""

    t: float
    end: float
    reasons: tuple[str, ...]


@dataclass(slots=True, kw_only=True)
class Recording:
    """Everything heard, in order of arrival; times in s since it began.

    Attributes:
        robot: The robot's name on the network.
        profile: The zone profile in force, as the messages say.
        directed: Whether the zones' limits are those of any direction, which a retreat may exceed.
        joint_names: The n joints, in the order of every row.
        decisions, commands, joints, obstacles, health, stops: What was heard.
        refused: Messages that could not be read, by cause.
        seconds: How long it lasted.
    """

    robot: str
    joint_names: tuple[str, ...]
    profile: str = ""
    directed: bool = False
    decisions: list[DecisionRow] = field(default_factory=list)
    commands: list[CommandRow] = field(default_factory=list)
    joints: list[JointRow] = field(default_factory=list)
    obstacles: list[ObstacleRow] = field(default_factory=list)
    health: list[HealthRow] = field(default_factory=list)
    stops: list[StopRow] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0


class Reader:
    """Turns samples into messages of one kind.

    Args:
        kind: The message expected.
    """

    def __init__(self, kind: type[m.Message]) -> None:
        self._kind = kind
        self._decoder: Decoder[Any] = Decoder(kind)

    def read(self, sample: zenoh.Sample) -> Any:
        """Return a sample's message.

        Raises:
            InputError: ``not_put``; ``wrong_encoding`` for another schema's, which Zenoh has been seen to
                deliver on a wrong key when a link came back; or as ``Decoder.decode`` says.
        """
        if sample.kind != zenoh.SampleKind.PUT:
            raise InputError("not_put", "sample", "a delete", "a put")
        if names_another(str(sample.encoding), self._kind):
            allowed = m.encoding_of(self._kind)
            raise InputError("wrong_encoding", "encoding", str(sample.encoding), allowed)
        return self._decoder.decode(sample.payload.to_bytes())


class Recorder:
    """Listens to one robot's outputs and inputs. Call ``drain`` often; nothing runs in between.

    Args:
        session: An open session.
        keys: The robot's keys.
        joint_names: The robot's joints, in its own order.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, joint_names: tuple[str, ...]) -> None:
        self._session = session
        self._keys = keys
        self._joint_names = joint_names
        self._channels: list[tuple[Any, Reader, Callable[[float, Any], None]]] = [
            self._channel(keys.output("zone"), m.Zone, self._take_zone),
            self._channel(keys.output("command"), m.VelocityCommand, self._take_command),
            self._channel(keys.input("joints"), m.JointState, self._take_joints),
            self._channel(keys.input("obstacles"), m.Obstacles, self._take_obstacles),
        ]
        self._health = HealthQuery(session, keys)
        self._began = time.monotonic()
        self._stop_began: tuple[float, tuple[str, ...]] | None = None
        self.recording = Recording(robot=keys.robot, joint_names=joint_names)

    def begin(self) -> None:
        """Begin anew at time 0; what was heard so far, or still waits, is dropped."""
        self.drain()
        self._began = time.monotonic()
        self._stop_began = None
        self.recording = Recording(robot=self._keys.robot, joint_names=self._joint_names)

    @property
    def elapsed(self) -> float:
        """Time since it began [s]."""
        return time.monotonic() - self._began

    def drain(self) -> None:
        """Take all that waits, and ask for ``health`` when it is time to."""
        now = self.elapsed
        for subscriber, reader, take in self._channels:
            while (sample := subscriber.handler.try_recv()) is not None:
                try:
                    take(now, reader.read(sample))
                except InputError as error:
                    self.recording.refused[error.cause] += 1
        answer = self._health.poll()
        if answer is not None:
            self.recording.health.append(HealthRow(now, answer))
        self.recording.seconds = now

    def note_stop(self, reasons: tuple[str, ...] | None) -> None:
        """Note the reasons of a stop of the consumer's own watchdog; ``None`` while there is none."""
        now = self.elapsed
        if self._stop_began is not None and reasons != self._stop_began[1]:
            self.recording.stops.append(StopRow(self._stop_began[0], now, self._stop_began[1]))
            self._stop_began = None
        if reasons is not None and self._stop_began is None:
            self._stop_began = now, reasons

    def end(self) -> Recording:
        """Take what still waits and return the recording."""
        self.drain()
        self.note_stop(None)
        return self.recording

    def _channel(
        self, key: str, kind: type[m.Message], take: Callable[[float, Any], None]
    ) -> tuple[Any, Reader, Callable[[float, Any], None]]:
        subscriber = self._session.declare_subscriber(key, zenoh.handlers.RingChannel(CAPACITY))
        return subscriber, Reader(kind), take

    def _take_zone(self, t: float, message: m.Zone) -> None:
        self.recording.profile = message.profile
        self.recording.directed |= message.limiting is not None
        exact, estimated = message.sources.get("obstacles"), message.sources.get("ranges")
        row = DecisionRow(
            t=t,
            seq=message.seq,
            zone=Zone[message.zone.upper()],
            exact=None if exact is None else exact.distance,
            estimated=None if estimated is None else estimated.distance,
            limit=self._ordered(message.name, message.speed_limit),
            reasons=tuple(message.reasons),
        )
        self.recording.decisions.append(row)

    def _take_command(self, t: float, message: m.VelocityCommand) -> None:
        velocity = self._ordered(message.name, message.velocity)
        self.recording.commands.append(CommandRow(t, message.seq, velocity))

    def _take_joints(self, t: float, message: m.JointState) -> None:
        position = self._ordered(message.name, message.position)
        velocity = self._ordered(message.name, message.velocity)
        self.recording.joints.append(JointRow(t, position, velocity))

    def _take_obstacles(self, t: float, message: m.Obstacles) -> None:
        self.recording.obstacles.append(ObstacleRow(t, tuple(message.obstacles)))

    def _ordered(self, name: list[str], values: list[float]) -> tuple[float, ...]:
        by_name = dict(zip(name, values, strict=False))
        try:
            return tuple([by_name[joint] for joint in self._joint_names])
        except KeyError as error:
            raise InputError("missing_joint", "name", name, f"{error.args[0]} among them") from error


class HealthQuery:
    """Asks for ``health`` twice a second without ever waiting for the answer.

    Args:
        session: An open session.
        keys: The robot's keys.
    """

    def __init__(self, session: zenoh.Session, keys: Keys) -> None:
        self._session = session
        self._key = keys.output("health")
        self._reader = Reader(m.Health)
        self._asked = 0.0
        self._replies: Any = None

    def poll(self) -> m.Health | None:
        """Return an answer that has come, and ask again when it is time to."""
        now = time.monotonic()
        if self._replies is not None:
            try:
                reply = self._replies.try_recv()
            except zenoh.ZError:  # the query is over, and nothing came
                self._replies = reply = None
            if reply is not None:
                self._replies = None
                return self._decoded(reply)
        if self._replies is None and now - self._asked >= HEALTH_PERIOD_S:
            self._asked = now
            channel: Any = zenoh.handlers.FifoChannel(4)
            self._replies = self._session.get(self._key, handler=channel, timeout=HEALTH_TIMEOUT_S)
        return None

    def _decoded(self, reply: zenoh.Reply) -> m.Health | None:
        if reply.ok is None:
            return None
        try:
            health: m.Health = self._reader.read(reply.ok)
        except InputError:
            return None
        return health

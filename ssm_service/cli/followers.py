"""Robots that are followed: one by name, or all that are on the network."""

from __future__ import annotations

import time
from typing import Any, Final

import zenoh

from ..client import Connection, Followed, Follower
from ..errors import ConfigError
from ..wire import Keys, robot_of
from .live import HISTORY, History, LiveState
from .meters import RateMeter
from .recording import HealthQuery

REPEAT_S: Final = 0.1
"""Between two reports of a watchdog's stop that goes on [s]."""

SLICE_S: Final = 0.5


class Watched:
    """One robot as its consumer sees it.

    Attributes:
        name: Its name on the network.
        state: What is displayed.
        decided: Whether the service has decided anything so far.
        said, said_at: What was last told of it, and when [s].
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.keys = Keys(name)
        self.state = LiveState(title=f"ssm watch · {name}")
        self.decided = False
        self.said: object = None
        self.said_at = 0.0
        self._began = time.monotonic()
        self._history = History(self.state, SLICE_S)
        self._meter = RateMeter()
        self._follower: Follower | None = None
        self._health: HealthQuery | None = None
        self._reported = 0.0

    def poll(self, connection: Connection) -> bool:
        """Look what holds now; return whether there is something to report."""
        if self._follower is None:
            self._follower = Follower(connection, self.keys)
        followed = self._follower.poll()
        now = time.monotonic() - self._began
        state = self.state
        message, before = followed.zone_message, state.followed
        # A stop is obeyed before its command has come, and is still the same decision afterwards.
        same = message is not None and before is not None and message is before.zone_message
        new = followed is not before and not same
        if new and message is not None:
            self.decided = True
            self._meter.add(now, message.seq, message.producer)
        state.followed, state.elapsed, state.rate = followed, now, self._meter.rate(now)
        self._history.add(now, None if message is None else message.distance, followed.zone)
        self._ask_health(connection)
        report = new or (followed.stopped_by_consumer and now - self._reported >= REPEAT_S)
        if report:
            self._reported = now
        return report

    def record(self) -> dict[str, Any]:
        """Return what holds now as plain values."""
        followed = self.state.followed
        if not isinstance(followed, Followed):
            return {"robot": self.name}
        message = followed.zone_message
        return {
            "robot": self.name,
            "received_ns": time.time_ns(),
            "seq": None if message is None else message.seq,
            "zone": followed.zone.word,
            "distance": None if message is None else message.distance,
            "stopped_by_consumer": followed.stopped_by_consumer,
            "name": followed.name,
            "speed_limit": followed.speed_limit,
            "velocity": followed.velocity,
            "reasons": followed.reasons,
        }

    def _ask_health(self, connection: Connection) -> None:
        session = connection.session
        if session is None:
            return
        if self._health is None:
            self._health = HealthQuery(session, self.keys)
        self.state.health = self._health.poll() or self.state.health


class Everyone:
    """All robots that are followed.

    Args:
        connection: Where they are.
        watched: Those known from the start; new ones are added to it.
        discover: Whether to look for all robots on the network.
    """

    def __init__(self, connection: Connection, watched: list[Watched], *, discover: bool) -> None:
        self.watched = watched
        self.discover = discover
        self._connection = connection
        self._tokens: Any = None

    def poll(self) -> list[Watched]:
        """Look at each of them; return those with something to report."""
        if self.discover:
            self._look_for_more()
        return [robot for robot in self.watched if robot.poll(self._connection)]

    def _look_for_more(self) -> None:
        session = self._connection.session
        if session is None:
            return
        if self._tokens is None:
            channel: Any = zenoh.handlers.RingChannel(HISTORY)
            self._tokens = session.liveliness().declare_subscriber("ssm/*/alive", channel, history=True)
        while (sample := self._tokens.handler.try_recv()) is not None:
            name = robot_of(str(sample.key_expr))
            if sample.kind == zenoh.SampleKind.PUT and all(robot.name != name for robot in self.watched):
                try:
                    self.watched.append(Watched(name))
                except ConfigError:
                    continue  # a name that no service of ours has

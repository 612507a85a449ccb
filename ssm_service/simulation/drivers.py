"""What robot, sensors, tracker and planner would publish, published."""

from __future__ import annotations

import time
import uuid
from contextlib import suppress
from typing import Any

import msgspec
import zenoh

from ..client import Connection
from ..model import Obstacle, Robot
from ..wire import Heard, Keys, encoding_of, optional_readings, seal
from ..wire import messages as m
from .world import Emitted

Input = m.JointState | m.Ranges | m.Obstacles | m.Target


class Drivers:
    """Publishes what a ``World`` emits, as real drivers would: one producer, a ``seq`` for each key.

    Joints are named in alphabetical order, as ROS drivers do, so that nobody may rely on another one.

    Args:
        session: An open session, or a ``Connection`` that may replace its own: publishers follow.
        keys: The robot's keys.
        robot: The robot.
    """

    def __init__(self, session: zenoh.Session | Connection, keys: Keys, robot: Robot) -> None:
        self._link = session
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._keys = keys
        self.producer = uuid.uuid4().hex
        self._encoder = msgspec.json.Encoder()
        self._order = sorted(range(len(robot.joint_names)), key=robot.joint_names.__getitem__)
        self._names = [robot.joint_names[index] for index in self._order]
        self._seq = dict.fromkeys(m.INPUTS, -1)

    def send(self, emitted: Emitted, after: Heard | None = None) -> None:
        """Publish what is there, with its checksum.

        Args:
            emitted: What is there.
            after: The newest tick that had been heard before, if any: it bounds the messages' age.

        Raises:
            zenoh.ZError: The session was closed.
        """
        for message in self.messages(emitted):
            source, payload = _SOURCE[type(message)], self._encoder.encode(message)
            self.put(source, payload, (message.producer, message.seq), after)

    def put(self, source: str, payload: bytes, head: tuple[str, int], after: Heard | None) -> None:
        """Publish one message, with its checksum; while there is no session it is lost, as on any network.

        Args:
            source: E.g. ``joints``.
            payload: The message's bytes.
            head: Producer and ``seq``, for the checksum.
            after: See ``send``.

        Raises:
            zenoh.ZError: The session was closed, and is not a ``Connection``'s.
        """
        attachment = seal(self._keys.input(source), *head, payload, after)
        if not isinstance(self._link, Connection):
            self._publish(self._link, source, payload, attachment)
            return
        session = self._link.session
        if session is not None:
            with suppress(zenoh.ZError):  # it was closed just now, to be replaced
                self._publish(session, source, payload, attachment)

    def _publish(self, session: zenoh.Session, source: str, payload: bytes, attachment: bytes) -> None:
        if session is not self._session:
            self._publishers = self._declared(session)
            self._session = session
        self._publishers[source].put(payload, attachment=attachment)

    def _declared(self, session: zenoh.Session) -> dict[str, zenoh.Publisher]:
        return {
            source: session.declare_publisher(
                self._keys.input(source),
                encoding=encoding_of(kind),
                express=True,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for source, kind in m.INPUTS.items()
        }

    def messages(self, emitted: Emitted) -> list[Input]:
        """Return the messages for what is there, numbered and stamped."""
        made: list[Input] = []
        if (joints := emitted.joints) is not None:
            position, velocity = joints.position[self._order].tolist(), joints.velocity[self._order].tolist()
            made.append(
                m.JointState(**self._head("joints"), name=self._names, position=position, velocity=velocity)
            )
        if emitted.ranges is not None:
            made.append(m.Ranges(**self._head("ranges"), ranges=optional_readings(emitted.ranges)))
        if emitted.obstacles is not None:
            entries = [_entry(obstacle) for obstacle in emitted.obstacles]
            made.append(m.Obstacles(**self._head("obstacles"), obstacles=entries))
        if (target := emitted.target) is not None:
            kind: Any = target.kind
            made.append(m.Target(**self._head("target"), kind=kind, value=target.value.tolist()))
        return made

    def _head(self, source: str) -> dict[str, Any]:
        """Return what every message of a source begins with."""
        self._seq[source] += 1
        return {"producer": self.producer, "seq": self._seq[source], "stamp_ns": time.time_ns()}


_SOURCE: dict[type[m.Message], str] = {kind: source for source, kind in m.INPUTS.items()}


def _entry(obstacle: Obstacle) -> m.ObstacleEntry:
    return m.ObstacleEntry(
        id=obstacle.id,
        shape=obstacle.shape,  # type: ignore[arg-type]
        size=list(obstacle.size),
        position=obstacle.position,
        quaternion_xyzw=obstacle.quaternion_xyzw,
        velocity=obstacle.velocity,
    )

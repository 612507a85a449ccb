"""What robot, sensors, tracker and planner would publish, published."""

from __future__ import annotations

import time
import uuid
from typing import Any

import msgspec
import zenoh

from ..model import Obstacle, Robot
from ..wire import Heard, Keys, encoding_of, optional_readings, seal
from ..wire import messages as m
from .world import Emitted

Input = m.JointState | m.Ranges | m.Obstacles | m.Target


class Drivers:
    """Publishes what a ``World`` emits, as real drivers would: one producer, a ``seq`` for each key.

    Joints are named in alphabetical order, as ROS drivers do, so that nobody may rely on another one.

    Args:
        session: An open session.
        keys: The robot's keys.
        robot: The robot.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, robot: Robot) -> None:
        self._keys = keys
        self.producer = uuid.uuid4().hex
        self._encoder = msgspec.json.Encoder()
        self._order = sorted(range(len(robot.joint_names)), key=robot.joint_names.__getitem__)
        self._names = [robot.joint_names[index] for index in self._order]
        self._seq = dict.fromkeys(m.INPUTS, -1)
        self._publishers = {
            source: session.declare_publisher(
                keys.input(source),
                encoding=encoding_of(kind),
                express=True,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for source, kind in m.INPUTS.items()
        }

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
            attachment = seal(self._keys.input(source), message.producer, message.seq, payload, after)
            self._publishers[source].put(payload, attachment=attachment)

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

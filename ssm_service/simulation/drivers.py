"""What robot, sensors, tracker and planner would publish, published."""

from __future__ import annotations

import time
import uuid

import msgspec
import zenoh

from ..model import Obstacle, Robot
from ..wire import Keys, encoding_of, optional_readings
from ..wire import messages as m
from .world import Emitted


class Drivers:
    """Publishes what a ``World`` emits, as real drivers would: one producer, a ``seq`` for each key.

    Joints are named in alphabetical order, as ROS drivers do, so that nobody may rely on another one.

    Args:
        session: An open session.
        keys: The robot's keys.
        robot: The robot.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, robot: Robot) -> None:
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

    def send(self, emitted: Emitted) -> None:
        """Publish what is there.

        Raises:
            zenoh.ZError: The session was closed.
        """
        for message in self.messages(emitted):
            self._publishers[_SOURCE[type(message)]].put(self._encoder.encode(message))

    def messages(self, emitted: Emitted) -> list[m.Message]:
        """Return the messages for what is there, numbered and stamped."""
        stamp_ns = time.time_ns()
        result: list[m.Message] = []
        if emitted.joints is not None:
            result.append(
                m.JointState(
                    producer=self.producer,
                    seq=self._next("joints"),
                    stamp_ns=stamp_ns,
                    name=self._names,
                    position=emitted.joints.position[self._order].tolist(),
                    velocity=emitted.joints.velocity[self._order].tolist(),
                )
            )
        if emitted.ranges is not None:
            readings = optional_readings(emitted.ranges)
            result.append(
                m.Ranges(producer=self.producer, seq=self._next("ranges"), stamp_ns=stamp_ns, ranges=readings)
            )
        if emitted.obstacles is not None:
            entries = [_entry(obstacle) for obstacle in emitted.obstacles]
            result.append(
                m.Obstacles(
                    producer=self.producer, seq=self._next("obstacles"), stamp_ns=stamp_ns, obstacles=entries
                )
            )
        if emitted.target is not None:
            result.append(
                m.Target(
                    producer=self.producer,
                    seq=self._next("target"),
                    stamp_ns=stamp_ns,
                    kind=emitted.target.kind,  # type: ignore[arg-type]
                    value=emitted.target.value.tolist(),
                )
            )
        return result

    def _next(self, source: str) -> int:
        self._seq[source] += 1
        return self._seq[source]


_SOURCE = {kind: source for source, kind in m.INPUTS.items()}


def _entry(obstacle: Obstacle) -> m.ObstacleEntry:
    return m.ObstacleEntry(
        id=obstacle.id,
        shape=obstacle.shape,  # type: ignore[arg-type]
        size=list(obstacle.size),
        position=obstacle.position,
        quaternion_xyzw=obstacle.quaternion_xyzw,
        velocity=obstacle.velocity,
    )

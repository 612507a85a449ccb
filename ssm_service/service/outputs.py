"""What the service says: every decision published, the latest one kept encoded for queries."""

from __future__ import annotations

import time

import msgspec
import numpy as np
import zenoh
from msgspec.structs import replace

from ..monitor import Decision
from ..safety import Zone
from ..wire import Keys, command_message, encoding_of, seal, zone_message
from ..wire import messages as m
from .queries import Reply


class Outputs:
    """Publishes zone and command of each decision and keeps their bytes as stored replies.

    Args:
        session: The Zenoh session.
        keys: The robot's keys.
        producer: Random id of this service.
        profile: Zone profile in force.
        valid_for_ns: For how long a decision may be acted on [ns].
        joint_names: Names in the order of the decision's arrays.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        *,
        producer: str,
        profile: str,
        valid_for_ns: int,
        joint_names: list[str],
    ) -> None:
        self._robot = keys.robot
        self._producer = producer
        self._profile = profile
        self.valid_for_ns = valid_for_ns
        self._joint_names = joint_names
        self._encoder = msgspec.json.Encoder()
        # Each has a queue of its own, so that together they last longer than a decision is valid.
        self._zone = self._publisher(session, keys.output("zone"), m.Zone, zenoh.Priority.REAL_TIME)
        self._command = self._publisher(
            session, keys.output("command"), m.VelocityCommand, zenoh.Priority.INTERACTIVE_HIGH
        )
        self._keys = keys
        self.zone_reply = self.command_reply = Reply(b"", "", b"")
        self.last: Decision | None = None

    @staticmethod
    def _publisher(
        session: zenoh.Session, key: str, kind: type[m.Message], priority: zenoh.Priority
    ) -> zenoh.Publisher:
        return session.declare_publisher(
            key,
            encoding=encoding_of(kind),
            express=True,
            priority=priority,
            congestion_control=zenoh.CongestionControl.DROP,
        )

    def publish(self, decision: Decision) -> None:
        """Encode a decision once, publish it, and keep it for queries."""
        stamp_ns = time.time_ns()
        zone = zone_message(
            decision,
            producer=self._producer,
            stamp_ns=stamp_ns,
            valid_for_ns=self.valid_for_ns,
            robot=self._robot,
            profile=self._profile,
            name=self._joint_names,
        )
        command = command_message(
            decision,
            producer=self._producer,
            stamp_ns=stamp_ns,
            valid_for_ns=self.valid_for_ns,
            robot=self._robot,
            name=self._joint_names,
        )
        self.zone_reply = self._sealed("zone", zone)
        self.command_reply = self._sealed("command", command)
        self._zone.put(self.zone_reply.payload, attachment=self.zone_reply.attachment)
        self._command.put(self.command_reply.payload, attachment=self.command_reply.attachment)
        self.last = decision

    def _sealed(self, name: str, message: m.Zone | m.VelocityCommand) -> Reply:
        payload = self._encoder.encode(message)
        attachment = seal(self._keys.output(name), message.producer, message.seq, payload)
        return Reply(payload, encoding_of(type(message)), attachment)

    def publish_stop(self, reason: str) -> None:
        """Publish a protective stop as the decision after the last one, if there was one."""
        if self.last is not None:
            self.publish(stopped(self.last, reason, tick=self.last.tick + 1))


def stopped(decision: Decision, reason: str, *, tick: int) -> Decision:
    """Return a protective stop at ``tick`` that is otherwise what ``decision`` saw."""
    return replace(
        decision,
        tick=tick,
        zone=Zone.STOP,
        momentary_zone=Zone.STOP,
        speed_limit=np.zeros_like(decision.speed_limit),
        speed_scaling=0.0,
        velocity=np.zeros_like(decision.velocity),
        reasons=(reason,),
    )

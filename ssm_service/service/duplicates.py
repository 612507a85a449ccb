"""Two services with one name on one network: noticed and said, never mixed."""

from __future__ import annotations

import zenoh

from ..errors import DuplicateServiceError
from ..wire import Keys

HOLD_NS = 500_000_000
"""How long [ns] after a foreign message on our own keys it counts."""

ANSWER_TIMEOUT_S = 1.0


def refuse_duplicate(session: zenoh.Session, keys: Keys) -> None:
    """Refuse to start where a service answers for the same robot already.

    Raises:
        DuplicateServiceError: One does.
    """
    key = keys.output("zone")
    for reply in session.get(key, timeout=ANSWER_TIMEOUT_S):
        if reply.ok is not None:
            raise DuplicateServiceError(
                f"a service for '{keys.robot}' already answers on {key}; give this one another --name"
            )


class ForeignOutputs:
    """Listens on our own outputs for anybody else who speaks there."""

    def __init__(self, session: zenoh.Session, keys: Keys) -> None:
        self._subscribers = [
            session.declare_subscriber(
                keys.output(name), zenoh.handlers.RingChannel(1), allowed_origin=zenoh.Locality.REMOTE
            )
            for name in ("zone", "command")
        ]
        self._heard_ns: int | None = None
        self.ever_heard = False

    def heard(self, now_ns: int) -> bool:
        """Tell whether somebody else spoke within ``HOLD_NS`` of ``now_ns`` [monotonic ns]."""
        for subscriber in self._subscribers:
            if subscriber.handler.try_recv() is not None:
                self._heard_ns = now_ns
                self.ever_heard = True
        return self._heard_ns is not None and now_ns - self._heard_ns <= HOLD_NS

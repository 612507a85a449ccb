"""Who may speak, and in what order: the check of ``producer`` and ``seq``."""

from __future__ import annotations

from ..errors import InputError


def old_seq(seq: int, newest: int) -> InputError:
    """Return the refusal of a ``seq`` that is not above the newest one: a repetition or a wrong sequence."""
    fault = "repetition" if seq == newest else "sequence"
    return InputError("old_seq", "seq", seq, f"above {newest}, the last one accepted", fault=fault)


class ProducerGate:
    """Lets one producer through at a time, each message once and in rising order.

    Another producer is taken only when nothing of the present one was accepted for ``timeout_s``: a
    restarted driver is picked up, two drivers at once are not mixed.
    """

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._producer: str | None = None
        self._seq = -1
        self._accepted_at = 0.0
        self.lost = 0

    @property
    def producer(self) -> str | None:
        """The producer whose message was accepted last."""
        return self._producer

    def check(self, producer: str, seq: int, now: float) -> None:
        """Refuse a message that is repeated, out of order or from a second producer.

        Args:
            producer: Its producer.
            seq: Its sequence number.
            now: Earliest time at which it can have arrived, monotonic [s].

        Raises:
            InputError: ``old_seq`` or ``second_producer``.
        """
        if producer == self._producer:
            if seq <= self._seq:
                raise old_seq(seq, self._seq)
        elif self._producer is not None and now - self._accepted_at <= self._timeout_s:
            raise InputError(
                "second_producer",
                "producer",
                producer,
                f"only {self._producer} while it is fresh",
                fault="insertion",
            )

    def accept(self, producer: str, seq: int, now: float) -> None:
        """Remember a message that passed every check, this one's and its content's.

        Args:
            producer: Its producer.
            seq: Its sequence number.
            now: Latest time at which it can have arrived, monotonic [s].
        """
        if producer == self._producer:
            self.lost += seq - self._seq - 1
        self._producer = producer
        self._seq = seq
        self._accepted_at = now

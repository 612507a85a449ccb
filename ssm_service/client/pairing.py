"""Zone and command of one tick belong together."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import InputError
from ..wire import messages as m
from ..wire import old_seq
from .accept import Output

WAITING = 64
"""Ticks of which one message may wait for the other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Both messages of one tick.

    Attributes:
        zone: Its zone.
        command: Its command.
        arrived_ns: The earliest time [ns] at which the earlier of them can have arrived.
    """

    zone: m.Zone
    command: m.VelocityCommand
    arrived_ns: int


class Pairing:
    """Matches the messages of one producer by ``seq``.

    Args:
        producer: The producer.
        floor: Ticks up to this one were decided before the proof. They are passed over without a word until
            the first later one of their kind; what comes out of its order after that is refused.
    """

    def __init__(self, producer: str, floor: int) -> None:
        self.producer = producer
        self.lost = 0
        self._floor = floor
        self._newest: dict[type[Output], int] = {m.Zone: floor, m.VelocityCommand: floor}
        self._last_pair = floor
        self._zones: dict[int, tuple[m.Zone, int]] = {}
        self._commands: dict[int, tuple[m.VelocityCommand, int]] = {}

    def add(self, message: Output, arrived_ns: int) -> Pair | None:
        """Add a message; return its tick's pair if that is complete now.

        A zone of ``stop`` undoes what came before it: a command of an earlier tick finds no zone any more.

        Raises:
            InputError: ``old_seq`` for a repeated or older one; ``mismatch`` if the two messages of a tick
                differ in what both of them say.
        """
        newest = self._newest[type(message)]
        if message.seq <= self._floor == newest:
            return None
        if message.seq <= newest:
            raise old_seq(message.seq, newest)
        self._newest[type(message)] = message.seq
        if isinstance(message, m.Zone):
            if message.zone == "stop":
                self._zones.clear()
            self._zones[message.seq] = (message, arrived_ns)
        else:
            self._commands[message.seq] = (message, arrived_ns)
        return self._complete(message.seq)

    def _complete(self, seq: int) -> Pair | None:
        if seq not in self._zones or seq not in self._commands:
            self._prune(max(self._newest.values()) - WAITING)
            return None
        zone, zone_ns = self._zones[seq]
        command, command_ns = self._commands[seq]
        self._prune(seq)
        if (zone.zone, zone.name) != (command.zone, command.name):
            found = f"{command.zone} for {command.name}"
            raise InputError("mismatch", "command", found, f"{zone.zone} for {zone.name}")
        self.lost += seq - self._last_pair - 1
        self._last_pair = seq
        return Pair(zone=zone, command=command, arrived_ns=min(zone_ns, command_ns))

    def _prune(self, seq: int) -> None:
        self._zones = {key: value for key, value in self._zones.items() if key > seq}
        self._commands = {key: value for key, value in self._commands.items() if key > seq}

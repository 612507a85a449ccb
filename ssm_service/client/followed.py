"""What a consumer is told at each moment."""

from __future__ import annotations

from dataclasses import dataclass

from ..safety import Zone
from ..wire import messages as m


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """What holds now: the decision of one tick, or a stop of the consumer's own.

    Attributes:
        zone: The zone in force.
        name: (n,), joint names; empty in a stop before anything was heard.
        velocity: (n,), [rad/s or m/s], by name. All zero in a stop.
        speed_limit: (n,), [rad/s or m/s], by name. All zero in a stop.
        reasons: The service's words, or the watchdog's own: ``waiting:service``, ``stale:service``,
            ``invalid:service``, ``duplicate:service`` or ``latched:FAULT``.
        zone_message: The message that this was taken from; ``None`` in a stop of the consumer's own.
        command_message: Likewise; also ``None`` in a service's stop whose command has not arrived.
        stopped_by_consumer: Whether the watchdog stopped, because nothing valid had come in time.
        expires_ns: Time of ``time.monotonic_ns`` [ns] from which this must not be acted on any more. Who
            keeps it for longer than it takes to use it must look at the clock. 0 in the watchdog's stop,
            which holds until something else is said.
    """

    zone: Zone
    name: tuple[str, ...]
    velocity: tuple[float, ...]
    speed_limit: tuple[float, ...]
    reasons: tuple[str, ...]
    zone_message: m.Zone | None = None
    command_message: m.VelocityCommand | None = None
    stopped_by_consumer: bool = False
    expires_ns: int = 0


def own_stop(reason: str, name: tuple[str, ...]) -> Followed:
    """Return the watchdog's stop."""
    zeros = (0.0,) * len(name)
    return Followed(
        zone=Zone.STOP,
        name=name,
        velocity=zeros,
        speed_limit=zeros,
        reasons=(reason,),
        stopped_by_consumer=True,
    )


def service_stop(zone: m.Zone, command: m.VelocityCommand | None, expires_ns: int) -> Followed:
    """Return a stop that the service ordered; its numbers are zero whatever the messages hold."""
    zeros = (0.0,) * len(zone.name)
    return Followed(
        zone=Zone.STOP,
        name=tuple(zone.name),
        velocity=zeros,
        speed_limit=zeros,
        reasons=tuple(zone.reasons),
        zone_message=zone,
        command_message=command,
        expires_ns=expires_ns,
    )


def decision(zone: m.Zone, command: m.VelocityCommand, expires_ns: int) -> Followed:
    """Return the decision of one tick, from its two messages."""
    if zone.zone == "stop":
        return service_stop(zone, command, expires_ns)
    return Followed(
        zone=Zone[zone.zone.upper()],
        name=tuple(zone.name),
        velocity=tuple(command.velocity),
        speed_limit=tuple(zone.speed_limit),
        reasons=tuple(zone.reasons),
        zone_message=zone,
        command_message=command,
        expires_ns=expires_ns,
    )

"""Small differences planted in the real monitor; each of them must be found."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any
from unittest import mock

import numpy as np
from msgspec.structs import replace

from ssm_service.safety import Zone

Changed = Callable[..., Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One planted difference.

    Attributes:
        name: What is wrong.
        target: Dotted name of the function that is replaced.
        change: Makes the wrong function of the right one.
        profiles: Profiles in which it can show.
    """

    name: str
    target: str
    change: Callable[[Changed], Changed]
    profiles: tuple[str, ...] = ("steps", "doubting", "iso", "tracked", "both")


@contextmanager
def planted(mutant: Mutant) -> Iterator[None]:
    """Replace the function while the context lasts."""
    with ExitStack() as stack:
        original = resolve_name(mutant.target)
        stack.enter_context(mock.patch(mutant.target, mutant.change(original)))
        yield


def _inputs(**fields: Any) -> Callable[[Changed], Changed]:
    """Return a change of ``Monitor.step`` that falsifies what it is given."""

    def change(original: Changed) -> Changed:
        return lambda self, inputs: original(self, replace(inputs, **fields))

    return change


def _received(name: str, **fields: Any) -> Callable[[Changed], Changed]:
    def change(original: Changed) -> Changed:
        def step(self: Any, inputs: Any) -> Any:
            received = getattr(inputs, name)
            changed = {key: value(received) for key, value in fields.items()}
            return original(self, replace(inputs, **{name: replace(received, **changed)}))

        return step

    return change


def _younger(received: Any) -> float | None:
    """Return an age that is fresh whenever it is one at all, and 0 whenever it was fresh."""
    age = received.age_s
    return 0.0 if age is not None and 0.0 <= age <= 0.25 else age


def _argument(name: str, value: Callable[[Any], Any]) -> Callable[[Changed], Changed]:
    """Return a change that falsifies one keyword argument."""

    def change(original: Changed) -> Changed:
        return lambda *args, **kwargs: original(*args, **{**kwargs, name: value(kwargs[name])})

    return change


def _late(original: Changed) -> Changed:
    return lambda name, config, *, age_s, invalid: original(
        name, config, age_s=None if age_s is None else age_s * 0.9, invalid=invalid
    )


def _open_edge(original: Changed) -> Changed:
    return lambda self, distance: original(self, math.nextafter(distance, math.inf))


def _no_contact(original: Changed) -> Changed:
    return lambda self, distance: min(original(self, distance), Zone.RED)


def _positional(place: int, value: Callable[[Any], Any]) -> Callable[[Changed], Changed]:
    """Return a change that falsifies one positional argument."""

    def change(original: Changed) -> Changed:
        return lambda *args, **kwargs: original(
            *[value(one) if index == place else one for index, one in enumerate(args)], **kwargs
        )

    return change


def _result(value: Callable[[Any], Any]) -> Callable[[Changed], Changed]:
    """Return a change that falsifies what is returned."""
    return lambda original: lambda *args, **kwargs: value(original(*args, **kwargs))


def _first_pair_free(allowed: Any) -> Any:
    return np.concatenate([np.full(min(1, len(allowed)), 1e3), allowed[1:]])


def _short(original: Changed) -> Changed:
    return lambda self, ticks: original(self, max(1, ticks - 1))


ISO = ("iso", "tracked", "both")
STEPS = ("steps", "doubting", "both")
STEP = "ssm_service.monitor.monitor.Monitor.step"
LIMIT = "ssm_service.monitor.command.limit_velocity"
LEVELS = "ssm_service.monitor.separation.level_speeds"

MUTANTS: tuple[Mutant, ...] = (
    Mutant(name="timeouts a ninth longer", target="ssm_service.monitor.monitor.classify", change=_late),
    Mutant(name="invalid messages do not matter", target="ssm_service.monitor.monitor.classify",
           change=_argument("invalid", lambda _: False)),
    Mutant(name="a stale source counts like an absent one", target="ssm_service.monitor.assess.forces_stop",
           change=lambda original: lambda status, config: config.required and original(status, config)),
    Mutant(name="edges belong to the farther zone", target="ssm_service.safety.ZoneProfile.zone_at",
           change=_open_edge, profiles=STEPS),
    Mutant(name="contact is only red", target="ssm_service.safety.ZoneProfile.zone_at", change=_no_contact,
           profiles=STEPS),
    Mutant(name="one tick less to recover", target="ssm_service.safety.ZoneMachine.__init__", change=_short),
    Mutant(name="a second service does not matter", target=STEP, change=_inputs(duplicate=False)),
    Mutant(name="a latch does not matter", target=STEP, change=_inputs(latched=False)),
    Mutant(name="an overrun does not matter", target=STEP, change=_inputs(overrun_s=0.0)),
    Mutant(name="red as fast as yellow", target="ssm_service.safety.ZoneProfile.joint_speed",
           change=lambda original: lambda self, zone: original(self, min(zone, Zone.YELLOW)), profiles=STEPS),
    Mutant(name="twice the acceleration", target=LIMIT, change=_argument("acceleration", lambda a: 2.0 * a)),
    Mutant(name="no margin at the joints' ends", target=LIMIT, change=_argument("margin", lambda _: 0.0)),
    Mutant(name="locked joints move", target="ssm_service.monitor.methods.Methods.wanted",
           change=_result(lambda wanted: wanted + np.eye(6)[3] / 100.0)),
    Mutant(name="the tracker's age does not matter", target=STEP,
           change=_received("obstacles", age_s=_younger), profiles=ISO),
    Mutant(name="the joints' age does not matter", target=STEP,
           change=_received("joints", age_s=lambda r: 0.0 if r.age_s is not None and 0.0 <= r.age_s <= 0.1
                            else r.age_s), profiles=ISO),
    Mutant(name="a measured period does not matter", target=STEP,
           change=_received("obstacles", period_s=lambda _: 0.0), profiles=ISO),
    Mutant(name="a measured transport does not matter", target=STEP, change=_inputs(transport_s=0.0),
           profiles=ISO),
    Mutant(name="a long tick does not matter", target=STEP, change=_inputs(tick_s=0.0), profiles=ISO),
    Mutant(name="1 % less human speed", target=LEVELS, change=_positional(1, lambda v: 0.99 * v),
           profiles=ISO),
    Mutant(name="1 % less reaction time", target=LEVELS, change=_positional(2, lambda t: 0.99 * t),
           profiles=ISO),
    Mutant(name="5 mm less of C + Z_d + Z_r", target=LEVELS, change=_positional(3, lambda z: z - 0.005),
           profiles=ISO),
    Mutant(name="one pair limits nothing", target="ssm_service.monitor.separation.max_closing_speeds",
           change=_result(_first_pair_free), profiles=ISO),
    Mutant(name="commands are not scaled by pairs", target="ssm_service.monitor.separated.greatest_scaling",
           change=lambda original: lambda *args: 1.0, profiles=ISO),
)  # fmt: skip
"""Everything that is planted; each is looked for in the profiles in which it can show."""

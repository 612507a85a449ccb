"""What one injection did, from what the processes said meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ssm_service.wire import messages as m

from .faults_rig import Event, Rig

CALM_S = 20.0
LEAD_S = 0.02


class NotCalmError(RuntimeError):
    """The robot did not come back to motion: nothing more can be injected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Before:
    """The state from which an injection starts.

    Attributes:
        watch: Number of the consumer's next event.
        plant: Likewise, of the robot's.
        health: The service's counters.
        rejected: The consumer's.
        robot_rejected: The robot's own watchdog's.
        lost: The consumer's.
    """

    watch: int
    plant: int
    health: m.Health | None
    rejected: dict[str, int]
    robot_rejected: dict[str, int]
    lost: int


def before(rig: Rig, timeout_s: float = CALM_S) -> Before:
    """Wait until all is calm and note where everything stands.

    Raises:
        NotCalmError: It does not become calm.
    """
    if not rig.calm(timeout_s):
        raise NotCalmError(f"no motion within {timeout_s:g} s: {rig.last('watch')}, {rig.last('plant')}")
    health = rig.health()
    newest = rig.last("watch")
    return Before(
        watch=rig.processes["watch"].count,
        plant=rig.processes["plant"].count,
        health=health,
        rejected=dict(newest.get("rejected", {})),
        robot_rejected=dict(rig.last("plant").get("rejected", {})),
        lost=int(newest.get("lost", 0)),
    )


def rejections(start: m.Health | None, end: m.Health | None, source: str) -> dict[str, int]:
    """Return by how much the service's counts of refusals of a source rose, by cause."""
    if start is None or end is None:
        return {}
    return _more(end.rejected.get(source, {}), start.rejected.get(source, {}))


def consumer_rejections(rig: Rig, start: Before) -> dict[str, int]:
    """Return the same of the consumer."""
    new = rig.last("watch").get("rejected", {})
    return _more(new, start.rejected)


def robot_rejections(rig: Rig, start: Before) -> dict[str, int]:
    """Return the same of the robot's own watchdog."""
    return _more(rig.last("plant").get("rejected", {}), start.robot_rejected)


def _more(new: dict[str, int], old: dict[str, int]) -> dict[str, int]:
    return {cause: number - old.get(cause, 0) for cause, number in new.items() if number > old.get(cause, 0)}


def events(rig: Rig, start: Before) -> list[Event]:
    """Return what the consumer held since, oldest first."""
    return [event for event in rig.processes["watch"].since(start.watch) if "zone" in event]


def first_stop(rig: Rig, start: Before, from_ns: int, wait_s: float, *, target: bool = False) -> Event | None:
    """Return the consumer's first stop at or after ``from_ns``, waiting for it.

    Args:
        rig: The rig.
        start: As noted before.
        from_ns: When the fault began.
        wait_s: How long to wait.
        target: Whether no motion is enough, as for faults of the target.
    """

    def stops(event: Event) -> bool:
        return event["zone"] == "stop" or (target and not event["moves"])

    return first_event(rig, start, from_ns, wait_s, stops)


def first_event(
    rig: Rig, start: Before, from_ns: int, wait_s: float, found: Callable[[Event], bool]
) -> Event | None:
    """Return the first that the consumer held at or after ``from_ns`` and ``found`` likes, waiting for it."""
    return rig.processes["watch"].wait_for(
        lambda event: "zone" in event and event["t"] >= from_ns and found(event), wait_s, start.watch
    )


def wrong(
    found: list[Event], plant: list[Event], *, allowed: Callable[[Event], bool] | None = None
) -> list[str]:
    """Return what must never be: a zone milder than yellow, a lie that was believed, motion without a leave.

    Args:
        found: What the consumer held.
        plant: What the robot held.
        allowed: Tells which lies the fault consists of.
    """
    faults = []
    for event in found:
        if event["zone"] == "green":
            faults.append("green")
        if event["believed"] and event["zone"] != "stop" and not (allowed and allowed(event)):
            faults.append("believed " + "+".join(event["believed"]))
    for role, key, those in (("watch", "expired", found), ("plant", "overdue", plant)):
        numbers = [event[key] for event in those if key in event]
        if numbers and numbers[-1] > numbers[0]:
            faults.append(f"{role}: {key}")
    return sorted(set(faults))


def reasons_of(found: list[Event], from_ns: int, until_ns: int | None = None) -> list[str]:
    """Return all reason words that the consumer was given in a while."""
    words: set[str] = set()
    for event in found:
        if event["t"] >= from_ns and (until_ns is None or event["t"] <= until_ns):
            words.update(event["reasons"])
    return sorted(words)


def moving_at(rig: Rig, start: Before, at_ns: int) -> bool:
    """Tell whether the consumer was told to go on when the fault began: otherwise nothing is learnt."""
    held = [event for event in rig.processes["watch"].since(start.watch) if "zone" in event]
    earlier = [event for event in held if event["t"] < at_ns]
    return not earlier or (earlier[-1]["zone"] != "stop" and earlier[-1]["moves"])


def milliseconds(event: Event | None, from_ns: int) -> float | None:
    """Return the time from ``from_ns`` to an event [ms]."""
    return None if event is None else (event["t"] - from_ns) * 1e-6


def result(group: str, fault: str, cell: str, *, begun: float, **values: Any) -> dict[str, Any]:
    """Return one line of the results."""
    return {
        "group": group,
        "fault": fault,
        "cell": cell,
        "took_s": round(time.monotonic() - begun, 3),
        **values,
    }

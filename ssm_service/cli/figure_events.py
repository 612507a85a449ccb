"""What makes a zone worse although nothing is near, marked along the time axis of a figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

from ..safety import Zone
from .palette import INK
from .recording import Recording

MISSING: Final = ("waiting:", "stale:", "invalid:", "duplicate:")


class Event(NamedTuple):
    """When something began, and how it is marked.

    Attributes:
        label: Its name in the legend.
        marker, colour: Its mark.
        times: When it began [s].
    """

    label: str
    marker: str
    colour: str
    times: list[float]


def events(recording: Recording) -> Iterator[Event]:
    """Yield the kinds of event that occurred."""
    late = _beginnings(recording, lambda reason: reason == "overrun")
    missing = _beginnings(recording, lambda reason: reason.startswith(MISSING))
    stops = [stop.t for stop in recording.stops]
    for event in (
        Event("late tick (overrun)", "|", "#222222", late),
        Event("an input was missing", "x", INK[Zone.RED], missing),
        Event("this consumer's own stop", "v", INK[Zone.STOP], stops),
    ):
        if event.times:
            yield event


def mark_events(axes: Any, recording: Recording) -> None:
    """Mark events at the foot of the axes, each kind in a row of its own and in the legend."""
    for row, event in enumerate(events(recording)):
        axes.plot(
            event.times, [0.03 + 0.06 * row] * len(event.times), linestyle="none", marker=event.marker,
            markersize=7, markeredgewidth=1.6, color=event.colour, label=event.label, clip_on=False,
            zorder=6, transform=axes.get_xaxis_transform(),
        )  # fmt: skip


def _beginnings(recording: Recording, matches: Callable[[str], bool]) -> list[float]:
    """Return when decisions with a matching reason began, after ones without."""
    times, before = [], False
    for row in recording.decisions:
        now = any(matches(reason) for reason in row.reasons)
        if now and not before:
            times.append(row.t)
        before = now
    return times

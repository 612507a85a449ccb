"""What a person sees of one robot while it is followed: a table on a terminal, else a line now and then."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from ..client import Followed
from ..safety import Zone
from ..wire.messages import Health
from .palette import BADGE, INK
from .words import limit_words, metres, nearest_words

FRAMES_PER_SECOND: Final = 8
HISTORY: Final = 60
BLOCKS: Final = "▁▂▃▄▅▆▇█"
BAR: Final = 12


@dataclass(slots=True, kw_only=True)
class LiveState:
    """What is to be shown; the display's own thread reads it, so every field is replaced whole.

    Attributes:
        title: What is followed.
        seconds: How long it will take [s]; ``None`` without end.
        elapsed: How long it has taken [s].
        followed: What holds now.
        position: (n,), [rad], by joint; empty where unknown.
        velocity: (n,), [rad/s], as measured; empty where unknown.
        rate: Decisions a second, over the last second; ``None`` where not measured.
        health: The service's last answer.
        history: Distance [m] and the worst zone of each slice of time.
    """

    title: str
    seconds: float | None = None
    elapsed: float = 0.0
    followed: Followed | None = None
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    rate: float | None = None
    health: Health | None = None
    history: deque[tuple[float | None, Zone]] = field(default_factory=lambda: deque(maxlen=HISTORY))


class RateMeter:
    """Counts decisions over the last second."""

    def __init__(self) -> None:
        self._times: deque[float] = deque()

    def add(self, now: float, count: int = 1) -> None:
        """Add decisions that have just come [s]."""
        self._times.extend([now] * count)

    def rate(self, now: float) -> float | None:
        """Return decisions a second [1/s]; ``None`` before there are two."""
        while self._times and now - self._times[0] > 1.0:
            self._times.popleft()
        if len(self._times) < 2 or self._times[-1] == self._times[0]:
            return None
        return (len(self._times) - 1) / (self._times[-1] - self._times[0])


class History:
    """Slices of time for the strip chart: the least distance and the worst zone of each.

    Args:
        state: Where the slices go.
        slice_s: Length of one [s].
    """

    def __init__(self, state: LiveState, slice_s: float) -> None:
        self._state = state
        self._slice_s = slice_s
        self._end = 0.0
        self._distance: float | None = None
        self._zone = Zone.GREEN

    def add(self, now: float, distance: float | None, zone: Zone) -> None:
        """Add what holds now."""
        if distance is not None and (self._distance is None or distance < self._distance):
            self._distance = distance
        self._zone = max(self._zone, zone)
        if now >= self._end:
            self._state.history.append((self._distance, self._zone))
            self._end = now + self._slice_s
            self._distance, self._zone = None, Zone.GREEN


class Display:
    """Shows a state on a terminal, from a thread of its own; does nothing where there is no terminal.

    Args:
        draw: Makes the picture.
        quiet: Show nothing in any case.
        stderr: Whether it goes there, as beside a result that goes to stdout.
    """

    def __init__(
        self, draw: Callable[[], RenderableType], *, quiet: bool = False, stderr: bool = True
    ) -> None:
        self.console = Console(stderr=stderr)
        self.shown = self.console.is_terminal and not quiet
        self._live = Live(
            get_renderable=draw,
            console=self.console,
            refresh_per_second=FRAMES_PER_SECOND,
            transient=False,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def __enter__(self) -> Display:
        if self.shown:
            self._live.start(refresh=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.shown:
            self._live.stop()


class Ticker:
    """Says when it is time for the next line."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next = time.monotonic()

    def due(self) -> bool:
        """Tell whether it is time; once for each period."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + self._period_s
        return True


def draw(state: LiveState) -> RenderableType:
    """Return the picture of a state."""
    parts: list[RenderableType] = [_head(state), Text(), _distances(state)]
    if state.history:
        parts.append(_strip(state))
    if state.followed is not None and state.followed.name:
        parts += [Text(), _joints(state, state.followed)]
    parts += [Text(), _foot(state)]
    time_words = (
        f"{state.elapsed:.1f} s" if state.seconds is None else f"{state.elapsed:.1f} of {state.seconds:g} s"
    )
    return Panel(
        Group(*parts), title=f" {state.title} ", subtitle=f" {time_words} ", title_align="left",
        subtitle_align="right", border_style="dim", padding=(1, 2), width=78,
    )  # fmt: skip


def draw_all(states: list[LiveState]) -> RenderableType:
    """Return the picture of several robots, a row each."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for title in ("robot", "zone", "distance", "nearest", "limit", "decisions/s", "reasons"):
        table.add_column(title)
    for state in states:
        followed = state.followed
        if followed is None:
            continue
        message = followed.zone_message
        table.add_row(
            state.title.rpartition(" ")[2],
            badge(followed.zone),
            metres(None if message is None else message.distance),
            "" if message is None else nearest_words(message),
            limit_words(followed.speed_limit),
            "–" if state.rate is None else f"{state.rate:.0f}",
            ", ".join(followed.reasons),
        )
    return table if states else Text("no robot found yet …", "dim")


def line(state: LiveState) -> str:
    """Return a state on one line."""
    followed = state.followed
    if followed is None:
        return f"{state.elapsed:5.1f} s  –"
    parts = [f"{state.elapsed:5.1f} s  {followed.zone.word:6}"]
    exact, estimated = source_distances(followed)
    parts.append(f"exact {metres(exact)}, estimated {metres(estimated)}")
    if state.rate is not None:
        parts.append(f"{state.rate:.0f}/s")
    if followed.reasons:
        parts.append(", ".join(followed.reasons))
    return "  ".join(parts)


def source_distances(followed: Followed) -> tuple[float | None, float | None]:
    """Return what tracked obstacles and what the sensor rings say [m]."""
    if followed.zone_message is None:
        return None, None
    sources = followed.zone_message.sources
    exact, estimated = sources.get("obstacles"), sources.get("ranges")
    return (
        None if exact is None else exact.distance,
        None if estimated is None else estimated.distance,
    )


def badge(zone: Zone) -> Text:
    """Return a zone's name in its colour."""
    return Text(f" {zone.word.upper():^8} ", BADGE[zone])


def _head(state: LiveState) -> RenderableType:
    followed = state.followed
    if followed is None:
        return Text("waiting …", "dim")
    reasons = ", ".join(followed.reasons) or "undisturbed"
    who = "  (this consumer's own watchdog)" if followed.stopped_by_consumer else ""
    return Text.assemble(badge(followed.zone), "  ", reasons, (who, "dim"))


def _distances(state: LiveState) -> RenderableType:
    grid = Table.grid(padding=(0, 3, 0, 0))
    exact, estimated = (None, None) if state.followed is None else source_distances(state.followed)
    message = None if state.followed is None else state.followed.zone_message
    grid.add_row(Text("exact", "dim"), Text(metres(exact), "bold"), Text("tracked obstacles", "dim"))
    grid.add_row(Text("estimated", "dim"), Text(metres(estimated), "bold"), Text("sensor ring", "dim"))
    grid.add_row(Text("nearest", "dim"), Text("" if message is None else nearest_words(message)), Text())
    return grid


def _strip(state: LiveState) -> RenderableType:
    """Draw the last slices: height is distance up to 1 m, colour is the zone."""
    text = Text()
    for distance, zone in list(state.history):
        level = len(BLOCKS) - 1 if distance is None else int(max(0.0, min(distance, 0.999)) * len(BLOCKS))
        text.append(BLOCKS[level] if distance is not None else "·", INK[zone])
    return text


def _joints(state: LiveState, followed: Followed) -> RenderableType:
    """Draw a row for each joint; speeds are the measured ones where known, else those commanded."""
    measured = bool(state.position)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim", show_edge=False)
    table.add_column("joint")
    for title in (*(("rad", "rad/s") if measured else ()), "command", "limit"):
        table.add_column(title, justify="right")
    table.add_column("of limit")
    for i, name in enumerate(followed.name):
        limit, command = followed.speed_limit[i], followed.velocity[i]
        numbers = [f"{command:+.3f}", f"{limit:.2f}"]
        speed = command
        if measured:
            speed = state.velocity[i]
            numbers = [f"{state.position[i]:.3f}", f"{speed:+.3f}", *numbers]
        table.add_row(name.removesuffix("_joint"), *numbers, _bar(speed, limit, followed.zone))
    return table


def _bar(speed: float, limit: float, zone: Zone) -> Text:
    if limit <= 0.0:
        return Text("─" * BAR, "dim")
    filled = min(round(abs(speed) / limit * BAR), BAR)
    return Text.assemble(("━" * filled, INK[zone]), ("─" * (BAR - filled), "dim"))


def _foot(state: LiveState) -> RenderableType:
    parts = ["– decisions/s" if state.rate is None else f"{state.rate:.0f} decisions/s"]
    health = state.health
    if health is not None and health.tick_us:
        parts.append(f"tick p50 {health.tick_us['p50']:.0f} µs, p99 {health.tick_us['p99']:.0f} µs")
        parts.append(f"{health.overruns} overruns")
    return Text("  ·  ".join(parts), "dim")

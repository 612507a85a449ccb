"""What a person sees of one robot while it is followed: a table on a terminal, else a line now and then."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Final

from rich.console import ConsoleDimensions, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from ..client import Followed
from ..safety import Zone
from ..wire.messages import Health
from .palette import BADGE, INK
from .words import counted, limit_words, metres, nearest_words

WIDTH: Final = 78
FIXED_ROWS: Final = 14
"""Rows of the roomy picture beside those of the joints."""

BORDER_ROWS: Final = 3
"""Rows of the cramped picture's border, and the cursor's."""

ZONE_WIDTH: Final = 10
ALL_COLUMNS: Final = {
    "robot": 0, "zone": 0, "distance": 0, "nearest": 80, "limit": 110, "decisions/s": 95, "reasons": 0,
}  # fmt: skip
"""Columns of the picture of several robots, and the width of the terminal from which each is shown."""

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


def draw(state: LiveState, size: ConsoleDimensions) -> RenderableType:
    """Return the picture of a state for a terminal of a size; where it is small, what matters most."""
    joints = 0 if state.followed is None else len(state.followed.name)
    roomy = size.height > FIXED_ROWS + joints and size.width >= WIDTH
    parts = _roomy(state) if roomy else _cramped(state, size.height - BORDER_ROWS)
    time_words = (
        f"{state.elapsed:.1f} s" if state.seconds is None else f"{state.elapsed:.1f} of {state.seconds:g} s"
    )
    return Panel(
        Group(*parts), title=f" {state.title} ", subtitle=f" {time_words} ", title_align="left",
        subtitle_align="right", border_style="dim", padding=(1, 2) if roomy else (0, 1), width=WIDTH,
    )  # fmt: skip


def _roomy(state: LiveState) -> list[RenderableType]:
    parts: list[RenderableType] = [_head(state), Text(), _distances(state)]
    if state.history:
        parts.append(_strip(state))
    if state.followed is not None and state.followed.name:
        parts += [Text(), _joints(state, state.followed)]
    return [*parts, Text(), _foot(state)]


def _cramped(state: LiveState, rows: int) -> list[RenderableType]:
    """Return the parts that fit into some rows, in the order of how much they matter."""
    parts: list[RenderableType] = [_head(state), _distances(state), _foot(state)]
    rows -= 5
    if state.followed is not None and state.followed.name and rows > 1:
        count = min(len(state.followed.name), rows - 1)
        parts.append(_joints(state, state.followed, count, bars=False))
        rows -= 1 + count
    if state.history and rows > 0:
        parts.append(_strip(state))
    return parts


def draw_all(states: list[LiveState], size: ConsoleDimensions) -> RenderableType:
    """Return the picture of several robots, a row each; the worst first where not all of them fit."""
    shown = [(state, state.followed) for state in states if state.followed is not None]
    if len(shown) >= size.height:
        shown.sort(key=lambda pair: pair[1].zone, reverse=True)
    columns = [name for name, least_width in ALL_COLUMNS.items() if size.width >= least_width]
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for title in columns:
        # Rich takes from the others before it shortens this one: the zone is what one looks for.
        table.add_column(title, no_wrap=title == "zone", min_width=ZONE_WIDTH if title == "zone" else None)
    for state, followed in shown:
        cells = _cells(state, followed)
        table.add_row(*(cells[title] for title in columns))
    return table if states else Text("no robot found yet …", "dim")


def _cells(state: LiveState, followed: Followed) -> dict[str, Text]:
    message = followed.zone_message
    words = {
        "robot": state.title.rpartition(" ")[2],
        "distance": metres(None if message is None else message.distance),
        "nearest": "" if message is None else nearest_words(message),
        "limit": limit_words(followed.speed_limit),
        "decisions/s": "–" if state.rate is None else f"{state.rate:.0f}",
        "reasons": ", ".join(followed.reasons),
    }
    cells = {title: Text(text, no_wrap=True, overflow="ellipsis") for title, text in words.items()}
    return {**cells, "zone": badge(followed.zone)}


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
    reasons = ", ".join(followed.reasons) or "–"
    who = "  (this consumer's own watchdog)" if followed.stopped_by_consumer else ""
    return Text.assemble(badge(followed.zone), "  ", reasons, (who, "dim"), no_wrap=True, overflow="ellipsis")


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


def _joints(
    state: LiveState, followed: Followed, count: int | None = None, *, bars: bool = True
) -> RenderableType:
    """Draw a row for each joint; speeds are the measured ones where known, else those commanded."""
    measured = bool(state.position)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim", show_edge=False)
    table.add_column("joint")
    for title in (*(("rad", "rad/s") if measured else ()), "command", "limit"):
        table.add_column(title, justify="right")
    if bars:
        table.add_column("of limit")
    for i, name in enumerate(followed.name[:count]):
        limit, command = followed.speed_limit[i], followed.velocity[i]
        numbers = [f"{command:+.3f}", f"{limit:.2f}"]
        speed = command
        if measured:
            speed = state.velocity[i]
            numbers = [f"{state.position[i]:.3f}", f"{speed:+.3f}", *numbers]
        bar = [_bar(speed, limit, followed.zone)] if bars else []
        table.add_row(name.removesuffix("_joint"), *numbers, *bar)
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
        parts.append(counted(health.overruns, "overrun"))
    return Text("  ·  ".join(parts), "dim", no_wrap=True, overflow="ellipsis")

"""Messages in words, and the names of the report's files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from ..wire.messages import Zone

FIGURES: Final = ("distance.png", "speeds.png", "path.png", "ticks.png")


def counted(count: int, what: str) -> str:
    """Return a count with its noun, e.g. ``1 overrun`` or ``2 overruns``."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def metres(distance: float | None) -> str:
    """Return a distance in words; a dash where there is none."""
    return "–" if distance is None else f"{distance:.3f} m"


def limit_words(limits: list[float] | tuple[float, ...]) -> str:
    """Return joint speed limits as one number, or as their span."""
    if not limits:
        return "–"
    low, high = min(limits), max(limits)
    return f"{low:.2f} rad/s" if low == high else f"{low:.2f}–{high:.2f} rad/s"


def nearest_words(message: Zone) -> str:
    """Return what is nearest to what; empty where nothing was seen."""
    nearest = message.nearest
    if nearest is None:
        return ""
    what = "an echo" if nearest.obstacle is None else nearest.obstacle
    return f"{what} – {nearest.link}"


def zone_line(message: Zone) -> str:
    """Return a zone on one readable line."""
    parts = [f"{message.robot}: {message.zone}"]
    if message.distance is not None:
        parts.append(f"{metres(message.distance)} ({nearest_words(message)})")
    else:
        parts.append("nothing seen")
    parts.append(f"limit {limit_words(message.speed_limit)}")
    if message.reasons:
        parts.append(", ".join(message.reasons))
    return " · ".join(parts)

"""What is known of each input: absent, fresh, stale or invalid, and which of these forces a stop."""

from __future__ import annotations

from enum import Enum

from msgspec import Struct

from ..config import SourceConfig


class SourceState(Enum):
    """State of one source at one tick; the value is the word in messages."""

    ABSENT = "absent"
    FRESH = "fresh"
    STALE = "stale"
    INVALID = "invalid"


class SourceStatus(Struct, frozen=True, kw_only=True):
    """State of one source and its reason word, if it has one.

    Attributes:
        name: ``joints``, ``ranges``, ``obstacles`` or ``target``.
        state: See ``SourceState``.
        age_s: Upper bound of the newest accepted value's age [s]; ``None`` while nothing was accepted.
    """

    name: str
    state: SourceState
    age_s: float | None

    @property
    def reason(self) -> str | None:
        """``waiting:NAME``, ``stale:NAME`` or ``invalid:NAME``; ``None`` when fresh."""
        word = {SourceState.ABSENT: "waiting", SourceState.STALE: "stale", SourceState.INVALID: "invalid"}
        return f"{word[self.state]}:{self.name}" if self.state in word else None


def classify(name: str, config: SourceConfig, *, age_s: float | None, invalid: bool) -> SourceStatus:
    """Return the status of a source.

    Args:
        name: The source's name.
        config: Its timeout.
        age_s: Upper bound of the newest accepted value's age [s], by the receiver's own clock; ``None``
            while nothing was ever accepted.
        invalid: Whether the newest message that arrived was refused. It stays so until a good one comes.
    """
    if invalid:
        state = SourceState.INVALID
    elif age_s is None:
        state = SourceState.ABSENT
    elif 0.0 <= age_s <= config.timeout_s:
        state = SourceState.FRESH
    else:
        # Also an age that is negative or not a number: a clock that cannot be trusted proves nothing.
        state = SourceState.STALE
    return SourceStatus(name=name, state=state, age_s=age_s)


def forces_stop(status: SourceStatus, config: SourceConfig) -> bool:
    """Tell whether a source of perception or joints in this state forces a protective stop.

    A required source must be fresh. An optional one may be absent; but once it has spoken it was relied
    upon, so its silence or its nonsense counts like a required one's.
    """
    if status.state is SourceState.ABSENT:
        return config.required
    return status.state is not SourceState.FRESH

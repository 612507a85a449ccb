"""From what a recorder hears to what a person is shown."""

from __future__ import annotations

from ..client import Followed
from .live import HISTORY, History, LiveState
from .meters import RateMeter
from .recording import Recorder


class Telling:
    """Keeps the displayed state up to date.

    Args:
        state: What is displayed.
        recorder: Where the numbers come from.
    """

    def __init__(self, state: LiveState, recorder: Recorder) -> None:
        self._state = state
        self._recorder = recorder
        self._meter = RateMeter()
        self._history = History(state, (state.seconds or HISTORY) / HISTORY)

    def update(self, followed: Followed) -> None:
        """Take what has come since the last call."""
        recorder, state = self._recorder, self._state
        recorder.note_stop(followed.reasons if followed.stopped_by_consumer else None)
        recorder.drain()
        recording, now = recorder.recording, recorder.elapsed
        if recording.decisions:
            self._meter.add(now, recording.decisions[-1].seq)
        state.elapsed, state.followed = now, followed
        state.rate = self._meter.rate(now)
        message = followed.zone_message
        self._history.add(now, None if message is None else message.distance, followed.zone)
        if recording.joints:
            state.position, state.velocity = recording.joints[-1].position, recording.joints[-1].velocity
        if recording.health:
            state.health = recording.health[-1].health

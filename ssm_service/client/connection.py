"""A client session that is there as soon as somebody listens."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path

import zenoh

from ..errors import NoServiceError, ServiceError
from ..wire.session import close_session, open_session, zenoh_config

RETRY_S = 0.1
"""Between two attempts to open [s]."""

DOUBT_S = 3.0
"""A session through which nobody has answered for so long is replaced; each time it takes twice as long."""

LONGEST_DOUBT_S = 60.0

CLOSING_S = 5.0
"""How long closing waits for an attempt under way [s]."""


class Connection:
    """Opens a session in the background, so that nobody has to wait for it.

    Zenoh refuses to open a client session while nobody listens, and may take seconds to say so; both are
    kept from the caller here. Once open, a session finds its way back by itself when the other end
    was restarted, subscriptions included. Not always: once in a while Zenoh keeps a session alive that
    reaches nobody any more (its issue 2767 is of this kind). So whoever asks says here whether anybody
    answered, and after ``DOUBT_S`` without an answer the session is replaced.

    Args:
        connect: Endpoints to dial; the first that answers is taken.
        zenoh_config_file: A Zenoh configuration to use instead of the package's own values.

    Raises:
        ConfigError: The file or an endpoint is not acceptable to Zenoh.
    """

    def __init__(self, connect: Sequence[str], zenoh_config_file: str | Path | None = None) -> None:
        self._connect = tuple(connect)
        self._file = zenoh_config_file
        zenoh_config("client", connect=self._connect, file=self._file)  # a bad one is the caller's to hear of
        self._session: zenoh.Session | None = None
        self._lock = threading.Lock()
        self._opened = threading.Event()
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None
        self._trouble = "nobody listens there"
        self._doubted_s: float | None = None
        self._patience_s = DOUBT_S

    @property
    def session(self) -> zenoh.Session | None:
        """The session, or ``None`` as long as there is none; asking starts the attempts to open it."""
        if self._session is None and self._thread is None and not self._closed.is_set():
            self._thread = threading.Thread(target=self._keep_opening, name="ssm-connection", daemon=True)
            self._thread.start()
        return self._session

    def wait(self, timeout_s: float) -> zenoh.Session:
        """Return the session, waiting for it if need be.

        Raises:
            NoServiceError: There is none within ``timeout_s``, or this connection was closed.
        """
        if self.session is None and not self._closed.is_set():
            self._opened.wait(timeout_s)
        if self._session is None:
            # An attempt under way may still say what its trouble was, after the connection was closed.
            trouble = "the connection was closed" if self._closed.is_set() else self._trouble
            raise NoServiceError(f"no service at {', '.join(self._connect) or self._file}: {trouble}")
        return self._session

    def answered(self) -> None:
        """Take note that somebody answered a question."""
        self._doubted_s, self._patience_s = None, DOUBT_S

    def unanswered(self, session: zenoh.Session) -> None:
        """Take note that nobody answered a question; never waits.

        Args:
            session: The session that it was asked through.
        """
        now = time.monotonic()
        with self._lock:
            if session is not self._session:
                return
            if self._doubted_s is None:
                self._doubted_s = now
            if now - self._doubted_s < self._patience_s:
                return
            self._session, self._thread, self._doubted_s = None, None, None
            self._opened.clear()
            self._patience_s = min(2.0 * self._patience_s, LONGEST_DOUBT_S)
        close_session(session, 0.0)

    def close(self) -> None:
        """Close the session; a process with an open one may never exit."""
        self._closed.set()
        with self._lock:
            session, self._session = self._session, None
        if session is not None:
            close_session(session)
        if self._thread is not None:
            # A thread that the interpreter's end finds inside Zenoh makes the whole process abort.
            self._thread.join(CLOSING_S)

    def _keep_opening(self) -> None:
        while not self._closed.is_set():
            begin = time.monotonic()
            try:
                session = open_session(zenoh_config("client", connect=self._connect, file=self._file))
            except ServiceError as error:
                self._trouble = str(error)
                self._closed.wait(max(RETRY_S - (time.monotonic() - begin), 0.01))
                continue
            with self._lock:
                if not self._closed.is_set():
                    self._session = session
                    self._opened.set()
                    return
            close_session(session)

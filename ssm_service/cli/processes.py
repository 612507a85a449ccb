"""Child processes that end with us in every case."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Final

from ..errors import ServiceError

_PR_SET_PDEATHSIG: Final = 1
GRACE_S: Final = 2.0
"""How long a child may take to end when asked, before it is killed."""

TAIL_LINES: Final = 15


class Children:
    """Commands of ``ssm`` as child processes. Use as a context manager: on leaving, all of them end.

    They run in a session of their own, so that Ctrl-C reaches only us, and we decide how they end. Should
    we be killed outright, the kernel ends them (on Linux).
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="ssm-demo-")
        self._children: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Children:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._folder.cleanup()

    @property
    def folder(self) -> Path:
        """A folder that is gone when all is over, for what children keep."""
        return Path(self._folder.name)

    def start(self, name: str, *arguments: str) -> None:
        """Start ``ssm`` with arguments; what it says is kept for the case that it fails."""
        with self._log_of(name).open("wb") as log:
            self._children[name] = subprocess.Popen(
                [sys.executable, "-m", "ssm_service.cli", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
                start_new_session=True,
                preexec_fn=_end_with_parent if sys.platform.startswith("linux") else None,
            )

    def check(self) -> None:
        """See that all of them still run.

        Raises:
            ServiceError: One has ended; with the last lines of what it said.
        """
        for name, child in self._children.items():
            status = child.poll()
            if status is not None:
                how = f"by signal {-status}" if status < 0 else f"with status {status}"
                raise ServiceError(f"the {name} ended {how}:\n{self.last_words(name)}")

    def last_words(self, name: str) -> str:
        """Return the last lines that a child wrote to stderr."""
        text = self._log_of(name).read_text(encoding="utf-8", errors="replace")
        lines = text.splitlines()[-TAIL_LINES:]
        return "\n".join(f"    {line}" for line in lines) or "    (it said nothing)"

    def stop(self) -> None:
        """End all of them: politely first, then not. A further Ctrl-C meanwhile changes nothing."""
        with _deaf(signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            running = [child for child in self._children.values() if child.poll() is None]
            for child in running:
                child.terminate()
            deadline = time.monotonic() + GRACE_S
            for child in running:
                try:
                    child.wait(max(deadline - time.monotonic(), 0.0))
                except subprocess.TimeoutExpired:
                    child.kill()
                    child.wait()

    def _log_of(self, name: str) -> Path:
        return Path(self._folder.name) / f"{name}.log"


@contextlib.contextmanager
def unwinding_on_termination() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the stack, so that every ``with`` block is left."""

    def leave(number: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    with _handling(leave, signal.SIGTERM, signal.SIGHUP):
        yield


def free_port() -> int:
    """Return a port of the loopback interface that nobody uses at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def _deaf(*numbers: signal.Signals) -> Iterator[None]:
    with _handling(signal.SIG_IGN, *numbers):
        yield


@contextlib.contextmanager
def _handling(
    handler: Callable[[int, FrameType | None], Any] | signal.Handlers, *numbers: signal.Signals
) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def _end_with_parent() -> None:
    """Run in the child before it becomes ``ssm``: ask the kernel for SIGTERM when the parent has died."""
    parent = os.getppid()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(0)

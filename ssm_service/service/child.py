"""Starting and ending the evaluating process."""

from __future__ import annotations

import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec

from ..errors import ServiceError
from .options import WorkerOptions

START_TIMEOUT_S = 30.0


class EvaluatingProcess:
    """The evaluating process, connected to the service over a socket that only this user can reach."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="ssm-")
        self.endpoint = f"unixsock-stream/{Path(self._folder.name) / 'evaluate.sock'}"
        self._process: subprocess.Popen[str] | None = None
        self._options: WorkerOptions | None = None
        self._deadline = 0.0

    def start(self, options: WorkerOptions) -> None:
        """Start it without waiting for it."""
        self._options = options
        self._deadline = time.monotonic() + START_TIMEOUT_S
        self._spawn(options)

    def ready(self) -> bool:
        """Tell, without waiting, whether it answers queries now.

        Raises:
            ServiceError: It ended, or was not ready in time.
        """
        process = self._process
        if process is None or process.stdout is None:
            return False
        if select.select([process.stdout], [], [], 0.0)[0]:
            if process.stdout.readline().strip() == "ready":
                return True
            raise ServiceError("the evaluating process ended while it was starting")
        if time.monotonic() > self._deadline:
            raise ServiceError(f"the evaluating process was not ready within {START_TIMEOUT_S:g} s")
        return False

    def restart_if_dead(self) -> bool:
        """Start it again, without waiting for it, if it has died; return whether it had."""
        if self._process is None or self._options is None or self._process.poll() is None:
            return False
        self._close_pipes()
        self._spawn(self._options)
        return True

    def _spawn(self, options: WorkerOptions) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ssm_service.service.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._process.stdin is not None:
            self._process.stdin.write(msgspec.json.encode(options).decode() + "\n")
            self._process.stdin.flush()

    def _close_pipes(self) -> None:
        if self._process is not None:
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    pipe.close()

    def stop(self) -> None:
        """End it; nothing is left running."""
        if self._process is not None:
            if self._process.stdin is not None:
                self._process.stdin.close()
            deadline = time.monotonic() + 0.3
            while self._process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.005)
            if self._process.poll() is None:
                self._process.kill()
            self._process.wait()
            self._close_pipes()
        self._folder.cleanup()

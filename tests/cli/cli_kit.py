"""The command as users run it: real processes, each with a time limit."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path

COMMAND = [sys.executable, "-m", "ssm_service.cli"]
MARK = "SSM_TEST_MARK"

Run = Callable[..., "subprocess.CompletedProcess[str]"]


class Marked:
    """Processes whose descendants can be counted, by a mark in their environment."""

    def __init__(self) -> None:
        self.mark = f"{MARK}={uuid.uuid4().hex}"
        name, value = self.mark.split("=")
        self.environment = {**os.environ, name: value}
        self._started: list[subprocess.Popen[str]] = []

    def start(self, *arguments: str, cwd: Path | None = None) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*COMMAND, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment,
            cwd=cwd,
        )
        self._started.append(process)
        return process

    def alive(self) -> dict[int, str]:
        """Return command lines by process id of all that carry the mark and still run."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if self.mark.encode() in (folder / "environ").read_bytes().split(b"\0"):
                    line = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                    if line:  # a zombie has none
                        found[int(folder.name)] = line
            except OSError:
                continue
        return found

    def wait_for(self, count: int, seconds: float = 30.0) -> dict[int, str]:
        """Wait until exactly ``count`` of them run."""
        deadline = time.monotonic() + seconds
        while len(alive := self.alive()) != count and time.monotonic() < deadline:
            time.sleep(0.02)
        return alive

    def close(self) -> None:
        for process in self._started:
            if process.poll() is None:
                process.terminate()
            process.communicate(timeout=20)
        for pid in self.alive():
            os.kill(pid, signal.SIGKILL)


def free_endpoint() -> str:
    """Return an endpoint of this machine's loopback at which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def wait_for_line(process: subprocess.Popen[str], word: str) -> str:
    """Read a process's stderr until a line has a word; pytest's time limit bounds the wait."""
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if word in line:
            return line
    raise AssertionError("".join(lines))

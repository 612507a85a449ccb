"""The processes of ``bench.soak``: the service, the simulation, a consumer, and the log of it all."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from ssm_service.cli.processes import free_port

ROOT = Path(__file__).resolve().parents[1]
ROLES = ("service", "simulation", "consumer", "evaluating")
TELLING = ("consumer", "witness")
"""Processes whose words go into the log."""

SAMPLES = "samples.jsonl"


class Log:
    """Writes one JSON line for each sample and event, at once, so that an interrupted run keeps them.

    Args:
        folder: Where ``samples.jsonl`` goes.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file: IO[str] = (folder / SAMPLES).open("w", encoding="utf-8")
        self._lock = threading.Lock()
        self._start = time.monotonic()

    def write(self, kind: str, at: float | None = None, **values: Any) -> None:
        """Write one line.

        Args:
            kind: What it is.
            at: When, ``time.monotonic`` [s]; now where left out.
            values: The rest.
        """
        t = (time.monotonic() if at is None else at) - self._start
        line = json.dumps({"kind": kind, "t": round(t, 6), **values})
        with self._lock:
            if not self._file.closed:
                self._file.write(line + "\n")
                self._file.flush()

    def close(self) -> None:
        """Close the file; what is written later is dropped."""
        with self._lock:
            self._file.close()


class Rig:
    """Starts the processes, starts them again, and knows their numbers. A context manager: all end with it.

    Args:
        log: Gets what consumer and witness say, and every start.
        folder: Where the processes' own words go.
        arguments: Of ``ssm run`` beside where it listens.
        scenario: Of the simulation.
        robot: Name of the robot on the network, and of its file.
        rate_hz: Of the service.
    """

    def __init__(
        self,
        log: Log,
        folder: Path,
        *,
        arguments: Sequence[str] = (),
        scenario: str = "crossing",
        robot: str = "ur3",
        rate_hz: float = 500.0,
    ) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.robot = robot
        self._log, self._folder = log, folder
        run = ["run", "--robot", robot, "--rate", str(rate_hz), "--listen", self.endpoint, *arguments]
        sim = ["sim", "--robot", robot, "--scenario", scenario, "--connect", self.endpoint]
        self._commands = {
            "service": [sys.executable, "-m", "ssm_service.cli", *run],
            "simulation": [sys.executable, "-m", "ssm_service.cli", *sim],
            "witness": [sys.executable, "-m", "bench.soak_witness"],
            "consumer": [sys.executable, "-m", "bench.soak_consumer", self.endpoint, robot, str(rate_hz)],
        }
        self._processes: dict[str, subprocess.Popen[str]] = {}
        # A latch, should the profile have one, is this run's own and not the user's.
        self._environment = os.environ | {"XDG_STATE_HOME": str(folder / "state")}

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, role: str) -> None:
        """Start a process, or start it again; its number goes into the log."""
        old = self._processes.get(role)
        if old is not None:
            old.wait()
            _close(old)
        with (self._folder / f"{role}.log").open("a", encoding="utf-8") as words:
            process = subprocess.Popen(
                self._commands[role],
                cwd=ROOT,
                env=self._environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE if role in TELLING else subprocess.DEVNULL,
                stderr=words,
                text=True,
                start_new_session=True,
            )
        self._processes[role] = process
        self._log.write("start", role=role, pid=process.pid)
        if role in TELLING:
            threading.Thread(target=self._hear, args=(process,), daemon=True).start()

    def pid(self, role: str) -> int | None:
        """Return a process's number; ``None`` while it does not run."""
        if role == "evaluating":
            return self._evaluating()
        process = self._processes.get(role)
        return None if process is None or process.poll() is not None else process.pid

    def revive(self) -> list[str]:
        """Start what has died again, but for the evaluating process, whose service does that; name them."""
        dead = [role for role, process in self._processes.items() if process.poll() is not None]
        for role in dead:
            self._log.write("death", role=role, status=self._processes[role].returncode)
            self.start(role)
        return dead

    def stop(self) -> None:
        """End all of them: politely, then not."""
        for process in self._processes.values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGCONT)
                process.terminate()
        deadline = time.monotonic() + 3.0
        for process in self._processes.values():
            try:
                process.wait(max(deadline - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            _close(process)

    def _hear(self, process: subprocess.Popen[str]) -> None:
        for line in process.stdout or ():
            with contextlib.suppress(ValueError):  # cut off by its death
                said = json.loads(line)
                self._log.write(said.pop("kind"), said.pop("t"), pid=process.pid, **said)

    def _evaluating(self) -> int | None:
        service = self.pid("service")
        with contextlib.suppress(OSError, ValueError):
            children = Path(f"/proc/{service}/task/{service}/children").read_text(encoding="ascii").split()
            for child in map(int, children):
                if b"ssm_service.service.worker" in Path(f"/proc/{child}/cmdline").read_bytes():
                    return child
        return None


def _close(process: subprocess.Popen[str]) -> None:
    if process.stdin is not None:
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()


def vitals(pid: int) -> dict[str, int] | None:
    """Return resident memory [bytes], descriptors and threads of a process; ``None`` if it has gone."""
    process = Path(f"/proc/{pid}")
    try:
        pages = int((process / "statm").read_text(encoding="ascii").split()[1])
        return {
            "rss": pages * os.sysconf("SC_PAGE_SIZE"),
            "fds": len(os.listdir(process / "fd")),
            "threads": len(os.listdir(process / "task")),
        }
    except (OSError, IndexError, ValueError):
        return None

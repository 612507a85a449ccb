import json
import select
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

HERE = Path(__file__).parent


class Child:
    """A process of the test's own that ends with the test, whatever happens."""

    def __init__(self, *command, env=None):
        self.process = subprocess.Popen(
            [sys.executable, *map(str, command)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=env,
        )
        ready, _, _ = select.select([self.process.stdout], [], [], 30)
        assert ready, "the process did not start"
        assert self.process.stdout.readline().strip() == "ready"

    def wish(self, **what):
        self.process.stdin.write(json.dumps(what) + "\n")
        self.process.stdin.flush()

    def kill(self):
        """kill -9; returns the time just before it [ns]."""
        now = time.monotonic_ns()
        self.process.kill()
        self.process.wait(10)
        return now

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(10)
        for pipe in (self.process.stdin, self.process.stdout):
            pipe.close()


@pytest.fixture
def endpoint():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def spawn():
    """Start a process; all are ended after the test."""
    children = []

    def start(*command):
        children.append(Child(*command))
        return children[-1]

    yield start
    for child in children:
        child.close()


@pytest.fixture
def pretended(spawn, endpoint):
    """Start a pretended service that listens, or (``listen=False``) joins the one that does."""

    def start(*, listen=True, **options):
        words = [word for key, value in options.items() for word in (f"--{key.replace('_', '-')}", value)]
        words = [word for word in words if word is not True]
        return spawn(HERE / "pretended_service.py", "--listen" if listen else "--connect", endpoint, *words)

    return start

"""From a sensor message put to the command received in a third process, at 500 and 1000 Hz, over loopback."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from bisect import bisect_left
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .common import PERCENTILES, Report, Row, figure, parser, percentiles, progress

RATES_HZ = (500, 1000)
READY_TIMEOUT_S = 60.0
KEY = "bench/floor"

Times = NDArray[np.float64]

NOTES = """\
Three processes: a sender of joints (125 Hz) and scans, the service, a receiver; loopback TCP. Both ends \
read the same monotonic clock, which Linux keeps for the whole machine.
Each scan has a reading of its own, 2 to 6 periods after the last one, at random against the ticks. The \
zone message's distance says which scan a tick knew. A scan's latency ends when the command of the first \
tick that knew it, or a later scan, arrives.
'one way' is the floor of the network: the same sizes between two processes that do nothing else, one of \
them a router as the service is. 'tick phase' is the wait for the next tick, uniform in one period. 'floors \
together' draws from the three independently; what the command takes beyond them is the tick itself and \
the company of the other messages.\
"""


class Role:
    """One process of ``bench.latency_roles``; it is ended with the block, whatever happens.

    Args:
        name: The role.
        options: Its arguments.
    """

    def __init__(self, name: str, **options: Any) -> None:
        self._name = name
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.latency_roles", name, json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._ready = threading.Event()
        self.said: list[str] = []
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def __enter__(self) -> Role:
        return self

    def __exit__(self, *_exception: object) -> None:
        self._process.kill()
        self._process.wait()
        self._listener.join()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()

    def wait_until_ready(self) -> None:
        """Wait until the process says that it is ready.

        Raises:
            RuntimeError: It ended before, or took too long.
        """
        if not self._ready.wait(READY_TIMEOUT_S) or "ready" not in self.said:
            raise RuntimeError(self._failure())

    def go(self) -> None:
        """Let a process go on that waits for a line."""
        if self._process.stdin is not None:
            self._process.stdin.write("go\n")
            self._process.stdin.flush()

    def answer(self) -> Any:
        """Close the process's stdin and return what it answers at its end.

        Raises:
            RuntimeError: It failed.
        """
        if self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError(self._failure())
        self._process.stdin.close()
        text = self._process.stdout.read()
        if self._process.wait() != 0:
            self._listener.join()
            raise RuntimeError(self._failure())
        return json.loads(text)

    def end(self) -> None:
        """Ask the process to end, and wait for it."""
        self._process.terminate()
        self._process.wait()

    def _listen(self) -> None:
        for line in self._process.stderr or ():
            self.said.append(line.rstrip())
            if self.said[-1] == "ready":
                self._ready.set()
        self._ready.set()

    def _failure(self) -> str:
        return f"the process '{self._name}' failed:\n" + "\n".join(self.said)


def free_endpoint() -> str:
    """Return an endpoint on this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def measure_service(rate_hz: float, messages: int, seed: int) -> dict[str, Any]:
    """Return what sender and receiver noted beside a service at ``rate_hz``, and what the service said."""
    endpoint = free_endpoint()
    with ExitStack() as stack:
        service = stack.enter_context(Role("serve", endpoint=endpoint, rate_hz=rate_hz))
        service.wait_until_ready()
        receiver = stack.enter_context(Role("receive", endpoint=endpoint))
        receiver.wait_until_ready()
        period_us = 1e6 / rate_hz
        sender = stack.enter_context(
            Role("send", endpoint=endpoint, messages=messages, period_us=period_us, seed=seed)
        )
        sent = sender.answer()
        received = receiver.answer()
        service.end()
    return {**sent, **received, "service": service.said}


def latencies(noted: dict[str, Any]) -> dict[str, Any]:
    """Match scans with zones and commands.

    Returns:
        ``zone`` and ``command``: latencies [ns] of all scans that were answered; ``superseded``: scans that
        no tick knew, as a later one had come by then; ``unanswered``: scans that nothing followed.
    """
    first: dict[int, tuple[int, int]] = {}
    for tick, scan, arrived in noted["zones"]:
        first.setdefault(scan, (tick, arrived))
    scans = sorted(first)
    ticks = [tick for tick, _ in noted["commands"]]
    result: dict[str, Any] = {"zone": [], "command": [], "superseded": 0, "unanswered": 0}
    for scan, sent in enumerate(noted["sent_ns"]):
        at = bisect_left(scans, scan)
        tick, arrived = first[scans[at]] if at < len(scans) else (0, 0)
        command = bisect_left(ticks, tick)
        if at == len(scans) or command == len(ticks):
            result["unanswered"] += 1
            continue
        result["superseded"] += scans[at] != scan
        result["zone"].append(arrived - sent)
        result["command"].append(noted["commands"][command][1] - sent)
    return result


def measure_one_way(size: int, messages: int, seed: int, *, inward: bool) -> list[int]:
    """Return Zenoh's own one-way latencies [ns], to a router (``inward``) or from it."""
    endpoint = free_endpoint()
    common = {"endpoint": endpoint, "key": KEY}
    load = {"size": max(size, 10), "messages": messages, "seed": seed}
    with ExitStack() as stack:
        if inward:
            taker = stack.enter_context(Role("take", mode="router", **common))
            taker.wait_until_ready()
        putter = stack.enter_context(Role("put", mode="client" if inward else "router", **common, **load))
        putter.wait_until_ready()
        if not inward:
            taker = stack.enter_context(Role("take", mode="client", **common))
            taker.wait_until_ready()
        putter.go()
        sent = putter.answer()["sent_ns"]
        arrived = taker.answer()["arrived"]
    return [time - sent[index] for index, time in arrived]


def rows_of(rate_hz: int, messages: int, seed: int) -> list[Row]:
    """Measure one rate and return its rows; ``times_ns`` in each is for the figure."""
    noted = measure_service(rate_hz, messages, seed)
    found = latencies(noted)
    if not found["command"]:
        raise RuntimeError("no scan was answered:\n" + "\n".join(noted["service"]))
    inward = np.array(measure_one_way(noted["bytes"], messages, seed, inward=True))
    outward = np.array(measure_one_way(noted["command_bytes"], messages, seed, inward=False))
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 1e9 / rate_hz, 100_000)
    together = phase + rng.choice(inward, len(phase)) + rng.choice(outward, len(phase))
    measured = {
        "command": ("scan put → command received", found["command"]),
        "zone": ("scan put → zone received", found["zone"]),
        "one_way_in": (f"floor: Zenoh one way in, {noted['bytes']} B", inward),
        "one_way_out": (f"floor: Zenoh one way out, {noted['command_bytes']} B", outward),
        "tick_phase": ("floor: tick phase", phase),
        "floors": ("floors together", together),
    }
    rows = []
    for path, (text, times) in measured.items():
        row: Row = {"rate_hz": rate_hz, "path": path, "text": text, "messages": len(times)}
        row |= {f"{name}_us": value for name, value in percentiles(times).items()}
        if path in ("command", "zone"):
            row |= {name: found[name] for name in ("superseded", "unanswered")}
            row["service"] = noted["service"]
        if path in ("tick_phase", "floors"):
            row["messages"] = None
        rows.append(row | {"times_ns": np.asarray(times, dtype=np.float64)})
    return rows


def draw(rows: list[Row], times_ns: list[Times], path: Path) -> None:
    """Draw how many commands have arrived by when, beside the floors."""

    def lines(axes: Any) -> None:
        for row, times in zip(rows, times_ns, strict=True):
            if row["path"] in ("command", "floors"):
                colour = f"C{RATES_HZ.index(row['rate_hz'])}"
                style = "-" if row["path"] == "command" else "--"
                share = np.arange(1, len(times) + 1) / len(times)
                label = f"{row['rate_hz']} Hz, {row['path']}"
                axes.plot(np.sort(times) / 1e6, share, style, color=colour, label=label)
        longest = max(row["p99_us"] for row in rows) / 1e3
        axes.set(xlim=(0.0, 1.3 * longest), xlabel="latency [ms]", ylabel="share arrived")
        axes.grid(alpha=0.3)
        axes.legend()

    figure(path, 7.0, 4.5, lines)


def main() -> None:
    """Run the benchmark."""
    arguments = parser("latency", __doc__, "messages", 3000, "scans sent at each rate").parse_args()
    rows: list[Row] = []
    with progress() as bar:
        for rate_hz in bar.track(RATES_HZ, description="rates"):
            rows += rows_of(rate_hz, arguments.messages, arguments.seed)
    times_ns = [row.pop("times_ns") for row in rows]
    notes = NOTES.splitlines()
    for row in rows:
        if row["path"] == "command":
            notes.append(
                f"{row['rate_hz']} Hz: {row['superseded']} scans superseded before a tick, "
                f"{row['unanswered']} unanswered; the service said: {' | '.join(row['service'])}"
            )
    Report(
        name="latency",
        settings={"seed": arguments.seed, "messages": arguments.messages},
        columns={
            "rate_hz": "Hz",
            "text": "path",
            "messages": "messages",
            **{f"{name}_us": f"{name} [µs]" for name in PERCENTILES},
        },
        rows=rows,
        notes=notes,
        draw=lambda path: draw(rows, times_ns, path),
    ).finish(arguments)


if __name__ == "__main__":
    main()

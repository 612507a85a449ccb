"""Lateness of the fixed-rate loop: idle and beside busy processes, with and without real-time scheduling."""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ssm_service.service import Beat, FixedRateLoop
from ssm_service.service.loop import SPIN_NS
from ssm_service.service.realtime import apply_realtime

from .common import PERCENTILES, Report, Row, figure, parser, percentiles, progress

RATES_HZ = (100, 500, 1000)
BUSY_PROCESSES = 2
SEGMENT_S = 0.4
METHODS = {"loop": "`FixedRateLoop`", "spin": "pure spin"}
NOTES = f"""\
Lateness is the time from a deadline to the tick that it was for; the tick itself does nothing.
'pure spin' is the floor: it reads the clock without ever sleeping, and its lateness at the same deadlines \
is the machine's own. Both take turns in one process, {SEGMENT_S} s each, so they see the same machine; not \
longer, as the kernel takes the processor from a real-time process that uses 95 % of a second.
Beside busy processes an ordinary spin uses up its share of the processor; a loop that sleeps does better.
The loop sleeps, and spins for the last {SPIN_NS // 1000} µs.
'skipped' counts deadlines that were left out after a hiccup; 'rate error' is that of the mean rate of the \
ticks that were made.
'busy' is beside {BUSY_PROCESSES} processes that compute without end.
'real-time' is what the service asks of the system: SCHED_FIFO, locked memory, exact timers; all rows run \
without the garbage collector.\
"""

_BURN = """
import os, sys, threading
threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
while True:
    pass
"""


class Recording:
    """Lateness of every tick, and what the mean rate needs, over all segments of one method."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.lateness_ns: list[int] = []
        self.skipped = 0
        self.intervals = 0
        self.elapsed_ns = 0
        self._first_ns: int | None = None
        self._last_ns = 0

    def tick(self, beat: Beat) -> None:
        """Record one tick; one that comes after skipped deadlines is late against the first of them."""
        if self._first_ns is None:
            self._first_ns = beat.now_ns
        else:
            self.intervals += 1
        self._last_ns = beat.now_ns
        self.skipped += beat.skipped
        self.lateness_ns.append(beat.now_ns - beat.deadline_ns + beat.skipped * self._period_ns)

    def end_segment(self) -> None:
        """Close a segment: the pause until the next one counts nowhere."""
        if self._first_ns is not None:
            self.elapsed_ns += self._last_ns - self._first_ns
        self._first_ns = None

    def to_builtins(self) -> dict[str, Any]:
        """Return the results."""
        rate_error = self.intervals * self._period_ns / self.elapsed_ns - 1.0 if self.elapsed_ns else 0.0
        return {
            "ticks": len(self.lateness_ns),
            **{f"{name}_us": value for name, value in percentiles(self.lateness_ns).items()},
            "skipped": self.skipped,
            "rate_error_percent": 100.0 * rate_error,
            "sorted_lateness_us": [ns / 1e3 for ns in sorted(self.lateness_ns)],
        }


def spin(period_ns: int, recording: Recording, end_ns: int) -> None:
    """Wait for a grid of deadlines without ever sleeping, until ``end_ns`` [monotonic ns]: the floor."""
    deadline = time.monotonic_ns() + period_ns
    while deadline < end_ns:
        now = time.monotonic_ns()
        while now < deadline:
            now = time.monotonic_ns()
        behind = (now - deadline) // period_ns
        deadline += behind * period_ns
        recording.tick(Beat(deadline, now, 0, behind))
        deadline += period_ns


def measure_here(rate_hz: int, seconds: float, realtime: bool) -> dict[str, Any]:
    """Measure one rate in this process, loop and spin in turn; its settings stay changed."""
    done, refused = apply_realtime() if realtime else ([], [])
    gc.collect()
    gc.freeze()
    gc.disable()
    period_ns = round(1e9 / rate_hz)
    loop = FixedRateLoop(period_ns)
    recordings = {method: Recording(period_ns) for method in METHODS}
    segment_s = max(min(SEGMENT_S, seconds), 3.0 / rate_hz)
    for _ in range(max(1, round(seconds / segment_s))):
        for method, recording in recordings.items():
            end_ns = time.monotonic_ns() + round(segment_s * 1e9)
            if method == "spin":
                spin(period_ns, recording, end_ns)
            else:
                running = partial(_before, end_ns - period_ns)
                loop.run(recording.tick, _nothing, running)
            recording.end_segment()
    return {
        "in_force": done,
        "refused": refused,
        "methods": {method: recording.to_builtins() for method, recording in recordings.items()},
    }


def _before(end_ns: int) -> bool:
    return time.monotonic_ns() < end_ns


def _nothing(_until_ns: int) -> None:
    pass


def measure_apart(rate_hz: int, seconds: float, realtime: bool) -> dict[str, Any]:
    """Measure one rate in a process of its own, so that its settings do not leak.

    Raises:
        RuntimeError: The process failed.
    """
    question = json.dumps({"rate_hz": rate_hz, "seconds": seconds, "realtime": realtime})
    done = subprocess.run(
        [sys.executable, "-m", "bench.loop", "--measure", question],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"the measuring process failed:\n{done.stderr}")
    result: dict[str, Any] = json.loads(done.stdout)
    return result


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep so many processes computing; they end with the block, and also should this process die."""
    burners = [
        subprocess.Popen([sys.executable, "-c", _BURN], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
        for _ in range(count)
    ]
    try:
        yield
    finally:
        for burner in burners:
            if burner.stdin is not None:
                burner.stdin.close()
            burner.wait()


def rows_of(rate_hz: int, load: str, realtime: bool, result: dict[str, Any]) -> list[Row]:
    """Return the rows of one measuring process."""
    permitted = not any(text.startswith("SCHED_FIFO") for text in result["refused"])
    scheduling = "ordinary" if not realtime else "real-time" if permitted else "real-time: not permitted"
    return [
        {
            "rate_hz": rate_hz,
            "load": load,
            "scheduling": scheduling,
            "method": method,
            "timed": METHODS[method],
            "in_force": result["in_force"],
            "refused": result["refused"],
            **measured,
        }
        for method, measured in result["methods"].items()
    ]


def draw(table: list[Row], lateness: list[list[float]], path: Path) -> None:
    """Draw how often each lateness is exceeded, at 500 Hz."""

    def lines(axes: Any) -> None:
        for row, values in zip(table, lateness, strict=True):
            if row["rate_hz"] == 500:
                style = "--" if row["method"] == "spin" else "-"
                colour = {"idle": 0, "busy": 2}[row["load"]] + (row["scheduling"] != "ordinary")
                share = 1.0 - np.arange(len(values)) / len(values)
                label = f"{row['method']}, {row['load']}, {row['scheduling']}"
                axes.plot(np.maximum(values, 0.05), share, style, color=f"C{colour}", label=label)
        axes.set(xscale="log", yscale="log", xlabel="lateness [µs]", ylabel="share of ticks as late or later")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)

    figure(path, 7.0, 4.5, lines)


def main() -> None:
    """Run the benchmark."""
    options = parser("loop", __doc__, "seconds", 20.0, "seconds of each row")
    options.add_argument("--measure", help=argparse.SUPPRESS)
    arguments = options.parse_args()
    if arguments.measure:
        print(json.dumps(measure_here(**json.loads(arguments.measure))))
        return
    table: list[Row] = []
    runs = list(product(RATES_HZ, ("idle", "busy"), (False, True)))
    results = {}
    with progress() as bar:
        task = bar.add_task("runs", total=len(runs))
        for run in random.Random(arguments.seed).sample(runs, len(runs)):
            rate_hz, load, realtime = run
            with busy(BUSY_PROCESSES if load == "busy" else 0):
                results[run] = measure_apart(rate_hz, arguments.seconds, realtime)
            bar.advance(task)
    for run in runs:
        table += rows_of(*run, results[run])
    lateness = [row.pop("sorted_lateness_us") for row in table]
    refused = sorted({text for row in table for text in row["refused"]})
    Report(
        name="loop",
        settings={"seed": arguments.seed, "seconds": arguments.seconds},
        columns={
            "rate_hz": "Hz",
            "load": "machine",
            "scheduling": "scheduling",
            "timed": "what",
            "ticks": "ticks",
            **{f"{name}_us": f"{name} [µs]" for name in PERCENTILES},
            "skipped": "skipped",
            "rate_error_percent": "rate error [%]",
        },
        rows=table,
        notes=[*NOTES.splitlines(), *(f"Not permitted here: {text}." for text in refused)],
        draw=lambda path: draw(table, lateness, path),
    ).finish(arguments)


if __name__ == "__main__":
    main()

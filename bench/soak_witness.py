"""The witness of ``bench.soak``: how late does an ordinary thread come to its turn on this machine?

A thread on each processor sleeps for a moment, again and again, and writes a JSON line whenever it was woken
so late that what waits for an ordinary thread (Zenoh's, at either end) may have been dropped. On each, as a
virtual machine may lose one of its processors for a while and keep the other. It ends when its stdin does.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time

from .soak_samples import HELD_UP_S

SLEEP_S = 0.002


def watch(processor: int) -> None:
    """Watch one processor for good."""
    os.sched_setaffinity(0, {processor})
    before = time.monotonic()
    while True:
        time.sleep(SLEEP_S)
        now = time.monotonic()
        if now - before - SLEEP_S >= 0.5 * HELD_UP_S:
            line = {"kind": "late", "t": now, "late_s": now - before, "processor": processor}
            sys.stdout.write(json.dumps(line) + "\n")
            sys.stdout.flush()
        before = now


def main() -> None:
    """Watch until the end of stdin."""
    for processor in os.sched_getaffinity(0):
        threading.Thread(target=watch, args=(processor,), daemon=True).start()
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    main()

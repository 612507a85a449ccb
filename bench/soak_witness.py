"""The witness of ``bench.soak``: how late does an ordinary thread come to its turn on this machine?

It sleeps for a moment, again and again, and writes a JSON line whenever it was woken so late that what waits
for an ordinary thread (Zenoh's, at either end) may have been dropped. It ends when its stdin does.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time

from .soak_samples import HELD_UP_S

SLEEP_S = 0.002


def main() -> None:
    """Watch until the end of stdin."""
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
    before = time.monotonic()
    while True:
        time.sleep(SLEEP_S)
        now = time.monotonic()
        if now - before - SLEEP_S >= 0.5 * HELD_UP_S:
            print(json.dumps({"kind": "late", "t": now, "late_s": now - before}), flush=True)
        before = now


if __name__ == "__main__":
    main()

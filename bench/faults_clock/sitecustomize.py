"""Lets ``bench.faults`` shift the wall clock of its own child processes, and of nobody else.

Python imports a module of this name at its start from ``PYTHONPATH``. Where ``SSM_BENCH_CLOCK`` names a file
of eight bytes, ``time.time`` and ``time.time_ns`` are off by the nanoseconds in it, from the moment in which
they are written. The machine's clock, the monotonic clock and what is not Python are left alone.
"""

import mmap
import os
import struct
import time

if "SSM_BENCH_CLOCK" in os.environ:
    with open(os.environ["SSM_BENCH_CLOCK"], "r+b") as file:
        shared = mmap.mmap(file.fileno(), 8)
    true_ns = time.time_ns

    def time_ns() -> int:
        """Return the shifted time [ns]."""
        return true_ns() + int(struct.unpack_from("<q", shared)[0])

    time.time_ns = time_ns
    time.time = lambda: time_ns() * 1e-9

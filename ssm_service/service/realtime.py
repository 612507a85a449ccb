"""What the operating system can do for a steady loop; what it does not permit is said, not hidden."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time

COLLECT_EVERY_NS = 10_000_000_000
COLLECT_NEEDS_NS = 1_000_000
"""Free time [ns] before the next deadline below which the garbage collector is not run."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK = 29
_M_ARENA_MAX = -8
ARENAS = 2
"""Of the C library's allocator, for all threads of a process together."""

FIFO_PRIORITY = 50


def apply_realtime() -> tuple[list[str], list[str]]:
    """Ask for real-time scheduling, locked memory, exact timers and a still garbage collector.

    Only the calling thread gets the real-time priority, and no child process inherits it.

    Returns:
        What is in force, and what was refused with the reason.
    """
    done: list[str] = []
    refused: list[str] = []
    for name, step in (
        # Locking takes all pages at once, a tenth of a second that no other loop should have to wait for.
        ("memory locked", _lock_memory),
        (f"SCHED_FIFO {FIFO_PRIORITY}", _schedule),
        ("timer slack 1 ns", _timer_slack),
    ):
        try:
            step()
            done.append(name)
        except (OSError, AttributeError) as error:
            refused.append(f"{name} ({error})")
    gc.collect()
    gc.freeze()
    gc.disable()
    done.append("garbage collector frozen")
    return done, refused


class SpareTimeCollector:
    """Collects garbage where a fixed-rate loop has time left: cycles would pile up while the collector rests.

    What is there when this is made is left out, so a run takes some tens of microseconds.
    """

    def __init__(self) -> None:
        gc.collect()
        gc.freeze()
        self._next_ns = time.monotonic_ns() + COLLECT_EVERY_NS

    def work(self, until_ns: int) -> None:
        """Collect if it is due and the time suffices.

        Args:
            until_ns: The next deadline by the monotonic clock [ns].
        """
        now = time.monotonic_ns()
        if now >= self._next_ns and until_ns - now > COLLECT_NEEDS_NS:
            gc.collect()
            self._next_ns = now + COLLECT_EVERY_NS


def few_arenas() -> None:
    """Have all threads share ``ARENAS`` arenas; to be called before the first thread is made.

    By default each of Zenoh's threads gets one of its own. What it frees stays with it, and where memory is
    locked also with the process: over hours, each arena keeps the most that its thread ever had in use. Where
    the C library has no such setting, nothing happens.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_ARENA_MAX, ARENAS)


def _schedule() -> None:
    if not sys.platform.startswith("linux"):
        raise OSError("only on Linux")
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(FIFO_PRIORITY))


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        raise OSError(os.strerror(ctypes.get_errno()))


def _timer_slack() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) != 0:
        raise OSError(os.strerror(ctypes.get_errno()))

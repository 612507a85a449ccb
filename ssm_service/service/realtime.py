"""What the operating system can do for a steady loop; what it does not permit is said, not hidden."""

from __future__ import annotations

import ctypes
import gc
import os
import sys

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK = 29
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
        (f"SCHED_FIFO {FIFO_PRIORITY}", _schedule),
        ("memory locked", _lock_memory),
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

"""A sweep: many pure pieces of work, each kept as a file, done in any order by any executor."""

from __future__ import annotations

import hashlib
import importlib
import json
import multiprocessing
import os
import signal
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]
Work = Callable[[Any], Arrays]

_ROOT = Path(__file__).resolve().parents[1]
_PACKAGES = ("pin", "coal", "numpy", "scipy", "numba", "clarabel", "example-robot-data")
_SOURCES = (
    "bench/sweep.py",
    "bench/triangulation*.py",
    "robots/*.toml",
    "ssm_service/config/*.py",
    "ssm_service/model/*.py",
    "ssm_service/perception/*.py",
)
_AHEAD = 2  # pieces that wait for each worker: enough to keep it busy, few to throw away


@dataclass(frozen=True, slots=True, kw_only=True)
class Store:
    """The pieces that are done, one file each, ``NNNNNN.npz``.

    A piece appears under its name all at once or not at all. The folder is that of one ``key``.

    Attributes:
        folder: Where they are.
    """

    folder: Path

    def load(self, index: int) -> Arrays | None:
        """Return a piece, or None where it is not there or cannot be read."""
        try:
            with self._path(index).open("rb") as file, np.load(file, allow_pickle=False) as kept:
                return {name: kept[name] for name in kept.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def save(self, index: int, arrays: Arrays) -> None:
        """Keep a piece."""
        self.folder.mkdir(parents=True, exist_ok=True)
        final = self._path(index)
        partial = final.with_name(f"{final.name}.{os.getpid()}.partial")
        with partial.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(final)

    def missing(self, count: int) -> list[int]:
        """Return which of ``count`` pieces are still to be done."""
        return [index for index in range(count) if self.load(index) is None]

    def _path(self, index: int) -> Path:
        return self.folder / f"{index:06d}.npz"


def key(settings: Mapping[str, Any]) -> str:
    """Return the name of the folder of a sweep: it changes with the settings, the code and the packages.

    Args:
        settings: JSON values.
    """
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for name in _PACKAGES:
        digest.update(f"{name} {version(name)}\n".encode())
    for pattern in _SOURCES:
        for path in sorted(_ROOT.glob(pattern)):
            digest.update(path.relative_to(_ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def complete(
    work: Work,
    tasks: Sequence[Any],
    store: Store,
    executor: Executor,
    workers: int = 1,
    done: Callable[[Any], None] = lambda task: None,
) -> None:
    """Do the tasks that ``store`` does not hold yet, in any order.

    Args:
        work: Does one task. It depends on nothing but the task, and can be pickled, as can the tasks.
        tasks: All of them; their places name their files.
        store: Takes the results; written by this process alone, so that workers need no common disk.
        executor: Any executor of ``concurrent.futures``.
        workers: How many tasks it does at once.
        done: Called with each task that is done, the ones done earlier first.
    """
    missing = store.missing(len(tasks))
    for index in sorted(set(range(len(tasks))) - set(missing)):
        done(tasks[index])
    queue = iter(missing)
    running: dict[Future[Arrays], int] = {}
    try:
        while True:
            while len(running) < _AHEAD * workers and (following := next(queue, None)) is not None:
                running[executor.submit(work, tasks[following])] = following
            if not running:
                return
            ended = wait(running, return_when=FIRST_COMPLETED).done
            for future in sorted(ended, key=lambda one: one.exception() is not None):  # failures last
                index = running.pop(future)
                store.save(index, future.result())
                done(tasks[index])
    finally:
        for future in running:
            future.cancel()


def merged(store: Store, indices: Sequence[int]) -> Arrays:
    """Return pieces joined along their first axis in the order of ``indices``, however they were made.

    Raises:
        FileNotFoundError: A piece is missing.
    """
    pieces = []
    for index, piece in ((index, store.load(index)) for index in indices):
        if piece is None:
            raise FileNotFoundError(f"piece {index} of {store.folder}")
        pieces.append(piece)
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


class Here(Executor):
    """Does each task at once in the process that submits it."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Do it and return a future that is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def local(workers: int) -> Iterator[Executor]:
    """Give processes of this machine, which end with this one, also if it is killed; 0: this one."""
    if workers == 0:
        yield Here()
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_obey_parent) as executor:
        yield executor


@contextmanager
def dask(address: str) -> Iterator[tuple[Executor, int]]:
    """Give a Dask cluster by its scheduler's address, and the number of its threads.

    Needs the extra: ``pip install ssm-service[dask]``. The workers need the package and this folder, too.

    Raises:
        TimeoutError: Nobody answers there.
    """
    distributed: Any = importlib.import_module("distributed")  # an extra, and without types
    try:
        client = distributed.Client(address, timeout=30)
    except OSError as error:
        raise TimeoutError(str(error)) from error
    with client:
        threads = sum(client.nthreads().values())
        yield client.get_executor(pure=False), max(1, threads)


def _obey_parent() -> None:
    """Leave Ctrl-C to the parent, and end with it: a process that waits for work would outlive a kill."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

"""A sweep is its settings' and nothing else's: not the workers', nor the order's, nor an interruption's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench import sweep

ROOT = Path(__file__).resolve().parents[2]


def piece(task):
    rng = np.random.default_rng(task)
    return {"x": rng.random(3), "n": np.array([task, task, task])}


def failing(task):
    if task == 3:
        raise ValueError("three")
    return piece(task)


class Noting(sweep.Here):
    """Notes what it is given."""

    def __init__(self):
        self.submitted = []

    def submit(self, fn, /, *args, **kwargs):
        self.submitted.append(args)
        return super().submit(fn, *args, **kwargs)


def test_all_pieces_are_there_in_order(tmp_path):
    store = sweep.Store(folder=tmp_path / "new")
    seen = []
    sweep.complete(piece, list(range(7)), store, sweep.Here(), workers=3, done=seen.append)
    assert sorted(seen) == list(range(7))
    assert sweep.merged(store, range(7))["n"].tolist() == [n for n in range(7) for _ in range(3)]
    expected = np.concatenate([piece(n)["x"] for n in (5, 2)])
    np.testing.assert_array_equal(sweep.merged(store, (5, 2))["x"], expected)


def test_only_what_is_missing_is_done(tmp_path):
    store = sweep.Store(folder=tmp_path)
    sweep.complete(piece, list(range(4)), store, sweep.Here())
    (tmp_path / "000001.npz").unlink()
    (tmp_path / "000002.npz").write_bytes((tmp_path / "000002.npz").read_bytes()[:100])
    (tmp_path / "000003.npz").write_bytes(b"")
    executor, seen = Noting(), []
    sweep.complete(piece, list(range(5)), store, executor, done=seen.append)
    assert [task for (task,) in executor.submitted] == [1, 2, 3, 4]
    assert sorted(seen) == list(range(5))
    assert store.missing(5) == []


def test_a_piece_that_fails_ends_the_sweep_and_leaves_the_others(tmp_path):
    store = sweep.Store(folder=tmp_path)
    with pytest.raises(ValueError, match="three"):
        sweep.complete(failing, list(range(9)), store, sweep.Here())
    assert store.missing(9)[0] == 3
    with pytest.raises(FileNotFoundError):
        sweep.merged(store, range(9))


def test_no_more_is_submitted_than_the_workers_need(tmp_path):
    waiting: list[Future] = []

    class Lazy(sweep.Here):
        def submit(self, fn, /, *args, **kwargs):
            if len(waiting) == 4:
                raise RuntimeError("too many")
            future: Future = Future()
            waiting.append(future)
            if len(waiting) == 4:
                for other, value in zip(waiting, range(4), strict=True):
                    other.set_result(piece(value))
                waiting.clear()
            return future

    sweep.complete(piece, list(range(8)), sweep.Store(folder=tmp_path), Lazy(), workers=2)
    assert sweep.Store(folder=tmp_path).missing(8) == []


def test_the_folder_changes_with_the_settings():
    assert sweep.key({"seed": 1}) == sweep.key({"seed": 1})
    assert sweep.key({"seed": 1}) != sweep.key({"seed": 2})


def alive(process):
    return (
        Path(f"/proc/{process}").exists() and "Z" not in Path(f"/proc/{process}/stat").read_text().split()[2]
    )


def test_the_processes_end_with_a_parent_that_is_killed():
    code = (
        "import os, sys; from bench import sweep\n"
        "with sweep.local(1) as executor:\n"
        "    print(executor.submit(os.getpid).result(), flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as parent:
        child = int(parent.stdout.readline())
        assert alive(child)
        os.kill(parent.pid, signal.SIGKILL)
        deadline = time.monotonic() + 20.0
        while alive(child) and time.monotonic() < deadline:
            time.sleep(0.02)
    assert not alive(child)

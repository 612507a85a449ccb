"""The latch's file: what was latched outlives the process, and what cannot be read or written is said."""

from __future__ import annotations

import json
import os
import resource
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from service_kit import wait_for

from ssm_service.config import LatchConfig
from ssm_service.service import latch_file
from ssm_service.service.integrity import IntegrityWatch, integrity_watch
from ssm_service.service.latch_file import (
    LatchFile,
    LatchState,
    load_latch,
    put_whole,
    state_file,
    state_of,
)

SECOND = 1_000_000_000
INTERVAL = 60.0
LATCH = LatchConfig(interval_s=INTERVAL)


class Said:
    def __init__(self) -> None:
        self.lines: list[str] = []
        self.warnings: list[str] = []

    def watch(self, path: Path, config: LatchConfig | None = LATCH) -> IntegrityWatch:
        return integrity_watch(config, path, self.lines.append, self.warnings.append)


@pytest.fixture
def said() -> Said:
    return Said()


def content(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text())


def test_where_it_is_kept(monkeypatch, tmp_path):
    assert state_file(tmp_path, "ur3") == tmp_path / "ur3.json"
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_file(None, "ur3") == tmp_path / "ssm-service" / "ur3.json"
    monkeypatch.setenv("HOME", "/home/somebody")
    for useless in ("", "relative/path"):
        monkeypatch.setenv("XDG_STATE_HOME", useless)
        assert state_file(None, "ur3") == Path("/home/somebody/.local/state/ssm-service/ur3.json")
    monkeypatch.delenv("XDG_STATE_HOME")
    assert state_file(None, "a.b") == Path("/home/somebody/.local/state/ssm-service/a.b.json")


def test_without_a_latch_errors_are_counted_and_nothing_is_kept(said, tmp_path):
    watch = said.watch(tmp_path / "x.json", None)
    for _ in range(3):
        watch.add("corruption", "in/joints", 0)
    assert (watch.counts, watch.latched, watch.reset()) == ({"corruption": 3}, None, None)
    watch.close()
    assert list(tmp_path.iterdir()) == []


def test_what_was_latched_is_so_after_a_restart_and_until_a_reset(said, tmp_path):
    path = tmp_path / "new" / "ur3.json"
    watch = said.watch(path)
    for now in (5, 7):
        watch.add("corruption", "in/joints", time.monotonic_ns() - 10 * SECOND + now)
    assert watch.latched == "corruption on in/joints, 0.0 s after corruption on in/joints"
    wait_for(lambda: path.exists() and content(path)["latched"])  # soon, not at the end
    again = said.watch(path)
    assert again.latched == watch.latched
    assert again.reset() == watch.latched
    assert again.latched is None
    again.close()
    assert said.watch(path).latched is None
    assert said.warnings == []
    assert any("until `ssm reset`" in line for line in said.lines)
    assert any("from before" in line for line in said.lines)
    assert any(line.startswith("reset: corruption") for line in said.lines)


def test_an_error_before_a_restart_and_one_after_latch(said, tmp_path):
    path = tmp_path / "ur3.json"
    watch = said.watch(path)
    watch.add("masquerade", "in/target", time.monotonic_ns())
    watch.close()
    again = said.watch(path)
    assert again.latched is None
    again.add("corruption", "in/joints", time.monotonic_ns())
    assert again.latched is not None
    assert "after masquerade on in/target" in again.latched
    again.close()


@pytest.mark.parametrize(("ago_s", "latches"), [(50.0, True), (70.0, False), (-1e6, True)])
def test_the_time_of_an_error_outlives_the_process_and_the_future_counts_as_now(tmp_path, ago_s, latches):
    path = tmp_path / "ur3.json"
    at_ns = time.time_ns() - int(ago_s * SECOND)
    path.write_text(json.dumps({"fault": "corruption", "where": "in/joints", "at_ns": at_ns}))
    latch = load_latch(path, INTERVAL)
    assert latch.last is not None
    assert latch.last.at_s <= time.monotonic()
    latch.error("corruption", "in/joints", time.monotonic())
    assert (latch.latched is not None) == latches


def test_a_state_comes_back_as_it_was(tmp_path):
    latch = load_latch(tmp_path / "none.json", INTERVAL)
    assert state_of(latch) == LatchState()
    latch.error("corruption", "in/joints", time.monotonic() - 30.0)
    kept = state_of(latch)
    assert (kept.latched, kept.fault, kept.where) == (None, "corruption", "in/joints")
    assert abs(kept.at_ns - (time.time_ns() - 30 * SECOND)) < 5 * SECOND


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"\xff",
        b"null",
        b"[" * 10_000,
        b'{"latched": 1}',
        b'{"latchd": null}',
        b'{"at_ns": "yesterday", "fault": "x"}',
        b'{"at_ns": 1e999}',
        b'{"fault": "\\ud800"}',
        b" " * 70_000 + b"{}",
    ],
    ids=lambda text: repr(text[:20]),
)
def test_what_cannot_be_read_is_latched(tmp_path, text):
    path = tmp_path / "ur3.json"
    path.write_bytes(text)
    latched = load_latch(path, INTERVAL).latched
    assert latched is not None
    assert "cannot be read" in latched


def test_a_folder_in_its_place_is_latched(tmp_path):
    (tmp_path / "ur3.json").mkdir()
    assert "cannot be read" in str(load_latch(tmp_path / "ur3.json", INTERVAL).latched)


def test_a_file_in_the_folders_place_holds_nothing_and_is_said(said, tmp_path):
    (tmp_path / "file").write_text("")
    watch = said.watch(tmp_path / "file" / "ur3.json")
    assert watch.latched is None
    wait_for(lambda: said.warnings)
    assert "would not outlive" in said.warnings[0]
    for _ in range(2):
        watch.add("corruption", "in/joints", time.monotonic_ns())
    assert watch.latched is not None  # in memory
    watch.close()


@contextmanager
def full_disk() -> Iterator[None]:
    """No file of this process may take a byte."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_is_said_and_written_once_there_is_room(said, tmp_path, monkeypatch):
    path = tmp_path / "ur3.json"
    monkeypatch.setattr(latch_file, "RETRY_S", 0.02)
    with full_disk():
        watch = said.watch(path)
        for _ in range(2):
            watch.add("corruption", "in/joints", time.monotonic_ns())
        wait_for(lambda: len(said.warnings) > 2)
        left = list(tmp_path.iterdir())
    assert set(said.warnings) == {f"a latched stop would not outlive this process: {path}: File too large"}
    assert left == []  # no half of a file
    wait_for(path.exists)
    assert content(path)["latched"] == watch.latched
    watch.close()


def test_a_new_state_does_not_wait_for_the_next_attempt_at_an_older_one(said, tmp_path, monkeypatch):
    path = tmp_path / "ur3.json"
    monkeypatch.setattr(latch_file, "RETRY_S", 300.0)
    with full_disk():
        watch = said.watch(path)
        wait_for(lambda: said.warnings)
    for _ in range(2):
        watch.add("corruption", "in/joints", time.monotonic_ns())
    wait_for(lambda: path.exists() and content(path)["latched"] == watch.latched)
    watch.close()


def test_a_disk_that_does_not_take_it_is_said_and_it_is_written_again(said, tmp_path, monkeypatch):
    path, refusing, real, asked = tmp_path / "ur3.json", threading.Event(), os.fsync, []

    def fsync(number: int) -> None:
        asked.append(os.fstat(number).st_ino)
        if refusing.is_set():
            raise OSError(5, "Input/output error")
        real(number)

    refusing.set()
    monkeypatch.setattr(latch_file.os, "fsync", fsync)
    monkeypatch.setattr(latch_file, "RETRY_S", 0.02)
    watch = said.watch(path)
    wait_for(lambda: len(said.warnings) > 2)
    assert set(said.warnings) == {
        f"a latched stop would not outlive this process: {path}: Input/output error"
    }
    assert (
        len(set(asked)) > 1
    )  # a file written anew: what failed to reach the disk is not tried again as it is
    refusing.clear()
    wait_for(lambda: tmp_path.stat().st_ino in asked)
    watch.close()


def test_a_latch_does_not_wait_for_the_disk_to_take_what_came_before(said, tmp_path, monkeypatch):
    path, slow = tmp_path / "ur3.json", threading.Event()
    monkeypatch.setattr(latch_file.os, "fsync", lambda _number: slow.wait(10.0))
    watch = said.watch(path)
    watch.add("corruption", "in/joints", time.monotonic_ns())
    wait_for(lambda: path.exists() and content(path)["fault"] == "corruption")
    watch.add("corruption", "in/joints", time.monotonic_ns())
    wait_for(lambda: content(path)["latched"] is not None)
    slow.set()
    watch.close()


def test_an_end_does_not_wait_for_a_disk_that_stays_full(said, tmp_path, monkeypatch):
    def fsync(_number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(latch_file.os, "fsync", fsync)
    watch = said.watch(tmp_path / "ur3.json")
    begin = time.monotonic()
    watch.close()
    assert time.monotonic() - begin < 3.0


def test_a_state_that_waits_is_written_at_the_end_and_only_the_newest(tmp_path):
    path = tmp_path / "ur3.json"
    file = LatchFile(path, lambda _: None, lambda _: None)
    for number in range(100):
        file.save(LatchState(latched=str(number)))
    file.close(5.0)
    assert content(path)["latched"] == "99"


def test_a_file_is_in_place_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a" / "b" / "x.json"
    put_whole(path, b"one")
    put_whole(path, b"two")
    assert path.read_bytes() == b"two"
    assert [one.name for one in path.parent.iterdir()] == ["x.json"]

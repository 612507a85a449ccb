"""The soak's verdict finds what it is for, in logs made for it, also in one that was cut off; and it runs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bench.soak_consumer import Account
from bench.soak_faults import REST_SHARE, WEIGHTS, schedule
from bench.soak_rig import SAMPLES
from bench.soak_samples import Run, read
from bench.soak_verdict import verdict
from ssm_service.wire import messages as m

ROOT = Path(__file__).resolve().parents[2]
MIB = 2**20


def log(folder: Path, minutes: float = 40.0, *, leak: float = 0.0, fds: int = 0, **more: Any) -> Run:
    """Write a log of a service without a fault, but for what is asked for; return it as it is read.

    ``leak`` [MiB/h] and ``fds`` more descriptors at the end; ``more`` gives events by kind.
    """
    random = np.random.default_rng(3)
    events: list[dict[str, Any]] = [{"kind": "settings", "t": 0.0, "seed": 1}]
    seconds = int(60 * minutes)
    for t in range(0, seconds, 2):
        threads = 10 + int(random.integers(0, 4))
        rss = int((100 + 8 * threads + leak * t / 3600 + 0.2 * random.standard_normal()) * MIB)
        service = {"pid": 7, "rss": rss, "fds": 20 + (fds if t > seconds / 2 else 0), "threads": threads}
        events.append({"kind": "sample", "t": float(t), "service": service, "load": 2.0})
        health = {"producer": "a", "uptime_s": 10.0 + t, "rate_hz": 500.0, "ticks": 500 * t - t, "skipped": t}
        events.append(
            {"kind": "health", "t": t + 0.5, **health, "overruns": t // 2, "tick_us": {"p50": 300.0}}
        )
        counters = {"pid": 9, "messages": 500 * t, "overruns": t // 2, "long": t // 4, "pause_s": 0.002}
        events.append({"kind": "consumer", "t": t + 0.7, **counters})
    for kind, found in more.items():
        events += [{"kind": kind, **event} for event in found]
    folder.mkdir(exist_ok=True)
    (folder / SAMPLES).write_text("".join(json.dumps(event) + "\n" for event in events), encoding="utf-8")
    return read(folder)


def answers(run: Run) -> dict[str, bool | None]:
    return {finding.what: finding.ok for finding in verdict(run)}


FAULT = {"t": 100.0, "what": "stop consumer", "ended": 0.3, "done": True}
GAP = {"t": 100.5, "after": 7, "next": 90, "pause_s": 0.3}


def test_a_run_as_it_must_be(tmp_path: Path) -> None:
    found = answers(log(tmp_path, fault=[FAULT], gap=[GAP]))
    wanted = {"memory, service", "descriptors, service", "sequence gaps", "deadlines", "overruns", "deaths"}
    assert {what for what, ok in found.items() if ok} == wanted
    assert {ok for what, ok in found.items() if what not in wanted} == {None}


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("memory, service", {"leak": 6.0}),
        ("descriptors, service", {"fds": 1}),
        ("sequence gaps", {"gap": [{**GAP, "pause_s": 0.001}]}),
        ("overruns", {"unreported": [{"t": 5.0, "pid": 9, "seq": 3}]}),
        ("deaths", {"death": [{"t": 5.0, "role": "service", "status": -11}]}),
        (
            "deadlines",
            {
                "health": [
                    {
                        "t": 2400.0 + k,
                        "producer": "a",
                        "uptime_s": 2410.0 + k,
                        "rate_hz": 500.0,
                        "ticks": 500 * (2400 + k) - 5,
                        "skipped": 0,
                        "overruns": 0,
                    }
                    for k in range(12)
                ]
            },
        ),
    ],
)
def test_what_is_wrong_is_found_and_nothing_else(tmp_path: Path, what: str, change: dict[str, Any]) -> None:
    found = answers(log(tmp_path, **change))
    assert [name for name, ok in found.items() if ok is False] == [what]


def test_a_gap_may_have_three_causes(tmp_path: Path) -> None:
    late = {"t": 200.0, "late_s": 0.05}
    for gap, ok in (({"t": 100.5}, True), ({"t": 200.3}, True), ({"t": 300.0, "pause_s": 0.03}, True)):
        run = log(tmp_path, 1.0, fault=[FAULT], late=[late], gap=[{**GAP, "pause_s": 0.0, **gap}])
        assert answers(run)["sequence gaps"] is ok
    run = log(tmp_path, 1.0, fault=[FAULT], late=[late], gap=[{**GAP, "t": 300.0, "pause_s": 0.0}])
    assert answers(run)["sequence gaps"] is False


def test_of_a_short_run_no_slope_is_said(tmp_path: Path) -> None:
    assert answers(log(tmp_path, 5.0, leak=600.0))["memory, service"] is None


def test_the_schedule_is_its_seeds_and_rests(tmp_path: Path) -> None:
    faults = list(schedule(5, 7200.0))
    assert faults == list(schedule(5, 7200.0))
    assert faults != list(schedule(6, 7200.0))
    assert {fault.what for fault in faults} == set(WEIGHTS)
    assert "kill service" in {fault.what for fault in schedule(5, 7200.0, kill_service=True)}
    ends = [fault.at_s + fault.lasts_s for fault in faults]
    assert all(later.at_s > end for end, later in zip(ends, faults[1:], strict=False))
    resting = [fault for fault in faults if fault.at_s % 240.0 > 240.0 * (1.0 - REST_SHARE)]
    assert not resting
    assert all(0.01 <= fault.lasts_s <= 0.5 for fault in faults if fault.what.startswith("stop"))


def zone(seq: int, at_ms: float, *reasons: str, producer: str = "a") -> m.Zone:
    return m.Zone(
        producer=producer,
        seq=seq,
        stamp_ns=int(at_ms * 1e6),
        valid_for_ns=20_000_000,
        robot="ur3",
        profile="kang2022",
        zone="green",
        distance=None,
        name=[],
        speed_limit=[],
        speed_scaling=1.0,
        nearest=None,
        sources={},
        reaction=None,
        reasons=list(reasons),
    )


def test_the_consumers_account() -> None:
    account = Account(2_000_000)
    told = [event for number in range(5, 9) for event in account.take(zone(number, 2.0 * number))]
    assert told == []
    assert account.take(zone(12, 24.0)) == [{"kind": "gap", "after": 8, "next": 12}]
    assert account.take(zone(13, 40.0, "overrun")) == []  # it says so itself
    assert account.take(zone(14, 60.0)) == []  # its own work took so long …
    assert account.take(zone(15, 62.0, "overrun")) == []  # … and the next one says so
    assert account.take(zone(16, 80.0)) == []
    assert account.take(zone(17, 82.0)) == [{"kind": "unreported", "seq": 16}]
    assert account.take(zone(3, 500.0, producer="b")) == []  # another service
    assert (account.messages, account.overruns, account.long) == (11, 2, 3)


@pytest.mark.alone
def test_a_short_real_run_and_the_report_of_one_that_was_cut_off(tmp_path: Path) -> None:
    """Whether the machine let every message through is not judged here."""
    command = [sys.executable, "-m", "bench.soak", "--json", "--every", "0.3"]
    run = [*command, "--minutes", "0.05", "--out", str(tmp_path)]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=110)
    assert done.returncode in (0, 1), done.stderr
    found = {row["what"]: row for row in json.loads(done.stdout)["rows"]}
    assert found["deaths"]["ok"] is True, done.stderr
    assert found["deadlines"]["ok"] is True
    assert {path.name for path in tmp_path.iterdir()} >= {"soak.md", "soak.json", "soak.png", SAMPLES}
    text = (tmp_path / SAMPLES).read_text(encoding="utf-8")
    (tmp_path / SAMPLES).write_text(text[: len(text) - 20], encoding="utf-8")
    again = [*command, "--report", str(tmp_path)]
    done = subprocess.run(again, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode in (0, 1), done.stderr
    assert {row["what"] for row in json.loads(done.stdout)["rows"]} == set(found)

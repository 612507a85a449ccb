"""The faults that the bench makes are faults, its bounds are what they say, and a small run works."""

import json
import random
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
import zenoh

from bench import faults_inputs, faults_wire
from bench.faults import Results, missing, tasks
from bench.faults_bounds import Bounds
from bench.faults_chaos import FAULTS
from bench.faults_forge import Message, Stranger, corrupted, masked, misdirected
from bench.faults_memory import LANES, PATTERNS, cells, chunk
from bench.faults_report import report
from bench.faults_rig import ROBOT
from ssm_service.config import load_robot_config
from ssm_service.errors import InputError
from ssm_service.wire import Heard, SealedDecoder, encoding_of, seal
from ssm_service.wire import messages as m

ROOT = Path(__file__).resolve().parents[2]
KEY = "ssm/arm/in/ranges"


def good(seq=7, after=None):
    payload = msgspec.json.encode(m.Ranges(producer="driver", seq=seq, stamp_ns=1, ranges=[0.2, 0.3, None]))
    attachment = seal(KEY, "driver", seq, payload, after)
    return Message(
        key=KEY, payload=payload, encoding=zenoh.Encoding(encoding_of(m.Ranges)), attachment=attachment
    )


def opened(message, key=KEY):
    return SealedDecoder(m.Ranges, key).decode(message.payload, message.attachment, required=True)


def test_a_good_message_is_one():
    assert opened(good(after=Heard("service", 3))).after == Heard("service", 3)


@pytest.mark.parametrize("bits", [1, 2, 8, 32, None])
def test_a_corrupted_message_differs_and_is_refused(bits):
    rng = random.Random(1)
    for _ in range(200):
        spoilt = corrupted(good(), rng, bits)
        assert (spoilt.payload, spoilt.attachment.lower()) != (good().payload, good().attachment.lower())
        with pytest.raises(InputError):
            opened(spoilt)


def test_a_stranger_is_in_due_form_but_somebody_else():
    stranger = Stranger()
    told = [opened(stranger.message(good(after=Heard("service", 3)), "ranges")) for _ in range(3)]
    assert {one.message.producer for one in told} == {stranger.producer}
    assert [one.message.seq for one in told] == [1, 2, 3]
    assert {one.after for one in told} == {Heard("service", 3)}
    assert told[0].message.ranges == [None] * 3


def test_a_mask_says_the_producers_name_and_has_no_right_checksum():
    rng = random.Random(1)
    for _ in range(30):
        mask = masked(good(), "ranges", rng, right=False)
        assert (mask.fields["producer"], mask.fields["seq"]) == ("driver", 8)
        with pytest.raises(InputError):
            opened(mask)
    assert opened(masked(good(), "ranges", rng, right=True)).message.seq == 8


def test_a_misdirected_message_is_right_elsewhere_only():
    rng = random.Random(1)
    message = misdirected(good(), "ranges", rng, [])
    with pytest.raises(InputError):
        opened(message)
    assert opened(message, "ssm/elsewhere/in/ranges").message.seq == 8


def test_every_cell_is_there_and_nothing_is_accepted_in_it():
    every = list(cells())
    assert {(lane, fault) for lane, fault, _ in every} >= {(lane, f) for lane in LANES[:-1] for f in FAULTS}
    assert {pattern for _, _, pattern in every} == set(PATTERNS)
    for line in chunk(every, 3, 1):
        assert line["wrong"] == [], line
        assert line["noticed"] == line["messages"] >= 3, line


def test_the_bounds_are_those_of_their_formulas():
    bounds = Bounds.of(ROBOT, 100.0)
    file = load_robot_config(ROBOT).file
    way, valid, look = file.reaction.transport_s, 0.030, 0.002
    assert bounds.refused_ms() == pytest.approx(1e3 * (2 * way + 2 * valid + look))
    for name in ("joints", "ranges", "obstacles", "target"):
        timeout = getattr(file.sources, name).timeout_s
        assert bounds.stale_ms(name) == pytest.approx(1e3 * (timeout + way + 2 * valid + look))
    assert bounds.watchdog_ms() == pytest.approx(1e3 * (way + valid + look))
    assert bounds.starved_ms(0.25) == pytest.approx(bounds.refused_ms() + 250.0)


def test_every_fault_is_made_as_often_as_asked():
    made = [task.fault for task in tasks("wire", 30, 0, 1)]
    assert {fault: made.count(fault) for fault in made} == dict.fromkeys(FAULTS, 30)
    shots = list(faults_wire.shots(30, 1))
    for lane in faults_wire.LANES:
        assert any(shot.lane == lane for shot in shots)
    assert [task.fault for task in tasks("input", 0, 2, 1)] == [*faults_inputs.NAMES] * 2


def line(fault, **changes):
    base = {
        "group": "wire",
        "fault": fault,
        "cell": "joints single",
        "messages": 2,
        "noticed": 2,
        "by": {"corrupt": 2},
        "stop_due": True,
        "stop_ms": 10.0,
        "bound_ms": 100.0,
        "late": False,
        "wrong": [],
        "recovered": True,
    }
    return base | changes


def test_an_interrupted_run_goes_on_where_it_was(tmp_path):
    path = tmp_path / "lines.jsonl"
    results = Results(path)
    results.add(line("corruption"))
    results.add(line("corruption", void=True))
    path.write_text(path.read_text(encoding="utf-8") + '{"group": "wi', encoding="utf-8")
    again = Results(path)
    left = missing(tasks("wire", 2, 0, 1), again)
    assert [task.fault for task in left].count("corruption") == 1
    assert [task.fault for task in left].count("loss") == 2


def test_the_table_counts_what_it_says():
    lines = [
        line("corruption"),
        line("corruption", noticed=1, stop_ms=150.0, late=True, wrong=["green"], recovered=False),
        line("corruption", stop_due=False, stop_ms=900.0, bound_ms=None),
        line("corruption", void=True, error="no motion"),
    ]
    arguments = type("A", (), {"seed": 1, "injections": 1, "processes": 1, "in_process": 1, "profile": "p"})
    (row,) = report(arguments, lines, interrupted=True).rows
    assert (row["injected"], row["messages"], row["noticed"], row["late"]) == (3, 6, 2, 1)
    assert (row["stop_ms"], row["bound_ms"]) == (150.0, 100.0)
    assert row["wrong"] == "green ×1"
    assert row["recovered"] == 2


CHOSEN = ("corruption", "masquerade", "loss", "minus_one:ranges", "jump", "pause:service", "latch")


@pytest.mark.timeout(240)
def test_a_small_run_over_real_processes(tmp_path):
    command = [sys.executable, "-m", "bench.faults", "--json", "--injections", "1", "--processes", "1"]
    command += ["--only", "wire", "input", "process", "--faults", *CHOSEN, "--lines", str(tmp_path / "lines")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=220)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    rows = {row["fault"]: row for row in document["rows"]}
    wanted = {f"wire: {name}" for name in CHOSEN[:3]} | {"input: minus_one:ranges", "input: jump"}
    assert set(rows) == wanted | {"process: pause:service"}, done.stdout
    for row in rows.values():
        assert row["injected"] == row["noticed"] == row["recovered"] == 1, row
        assert row["wrong"] == 0, row

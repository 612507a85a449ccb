"""``ssm demo`` as a user runs it: what it reports, and that nothing stays behind."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest
from cli_kit import Marked, wait_for_line

FIGURES = ["distance.png", "speeds.png", "path.png", "ticks.png"]


def test_it_reports_what_it_measured(marked: Marked, tmp_path: Path):
    demo = marked.start("demo", "--seconds", "4", "--out", "report", "--rate", "200", cwd=tmp_path)
    out, err = demo.communicate(timeout=100)
    assert demo.returncode == 0, err
    assert not marked.alive()
    for word in (
        "zones",
        "least distance",
        "decisions/s",
        "commands",
        "measured speed",
        "report/summary.json",
    ):
        assert word in out
    summary = json.loads((tmp_path / "report" / "summary.json").read_text())
    assert summary["figures"] == FIGURES
    for name in FIGURES:
        data = (tmp_path / "report" / name).read_bytes()
        assert data.startswith(b"\x89PNG")
        assert len(data) > 10_000
    assert 4.0 <= summary["seconds"] < 6.0
    decisions = summary["decisions"]
    assert 100.0 < decisions["mean_rate_hz"] < 210.0
    assert decisions["received"] + decisions["lost"] > 500
    assert decisions["refused"] == {}
    assert sum(summary["zones"].values()) == pytest.approx(1.0)
    assert summary["zones"]["stop"] < 0.5
    assert 0.0 < summary["least_exact_distance_m"] < 2.0
    limits = summary["joint_speed_limits"]
    assert limits["joint_states"] > 200
    assert limits["above_a_limit_otherwise"]["joint_states"] == 0
    assert limits["commands_within_share"] == 1.0
    assert summary["service"]["tick_us"]["p50"] > 0.0
    assert summary["service"]["rate_hz"] == 200.0


def test_it_shows_any_profile_and_keeps_no_latch_of_its_own(marked: Marked, tmp_path: Path):
    state = tmp_path / "state"
    options = ["--seconds", "2", "--out", "report", "--rate", "200", "--profile", "iso"]
    marked.environment["XDG_STATE_HOME"] = str(state)
    demo = marked.start("demo", *options, cwd=tmp_path)
    out, err = demo.communicate(timeout=100)
    assert demo.returncode == 0, err
    assert "safe in any direction" in out
    assert json.loads((tmp_path / "report" / "summary.json").read_text())["profile"] == "iso"
    assert not state.exists()
    refused = marked.start("demo", "--profile", "isso", "--out", "report", cwd=tmp_path)
    out, err = refused.communicate(timeout=100)
    assert refused.returncode == 2
    assert "did you mean 'iso'" in err


def test_ctrl_c_ends_it_early_with_a_report_and_nothing_stays_behind(marked: Marked, tmp_path: Path):
    demo = marked.start("demo", "--seconds", "60", "--json", cwd=tmp_path)
    wait_for_line(demo, "following")
    assert len(marked.wait_for(4)) == 4  # demo, service, its evaluating process, simulation
    demo.send_signal(signal.SIGINT)
    out, err = demo.communicate(timeout=60)
    assert demo.returncode == 0, err
    assert json.loads(out)["seconds"] < 30.0
    assert "Traceback" not in err
    assert not marked.alive()


def test_ctrl_c_during_the_start_leaves_no_folder_behind(marked: Marked, tmp_path: Path):
    demo = marked.start("demo", "--out", "new/report", cwd=tmp_path)
    wait_for_line(demo, "starting")
    demo.send_signal(signal.SIGINT)
    demo.communicate(timeout=30)
    assert demo.returncode == 130
    assert list(tmp_path.iterdir()) == []
    assert not marked.alive()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nothing_stays_behind_when_it_is_ended_from_outside(marked: Marked, tmp_path: Path, number: int):
    demo = marked.start("demo", "--seconds", "60", cwd=tmp_path)
    wait_for_line(demo, "following")
    demo.send_signal(number)
    demo.communicate(timeout=30)
    assert demo.returncode != 0
    assert not marked.wait_for(0)


@pytest.mark.parametrize("command", ["run", "sim"])
def test_the_crash_of_a_child_is_a_failure_with_its_words(marked: Marked, tmp_path: Path, command: str):
    demo = marked.start("demo", "--seconds", "60", cwd=tmp_path)
    wait_for_line(demo, "following")
    child = next(pid for pid, line in marked.alive().items() if f"ssm_service.cli {command} " in line)
    os.kill(child, signal.SIGKILL)
    _, err = demo.communicate(timeout=30)
    assert demo.returncode == 1
    assert "ended by signal 9" in err
    assert "Traceback" not in err
    assert not (tmp_path / "ssm-report").exists()
    assert not marked.wait_for(0)


def test_a_service_that_cannot_start_is_a_failure_with_its_words(marked: Marked, tmp_path: Path):
    ur3 = Path(__file__).resolve().parents[2] / "robots" / "ur3.toml"
    robot = tmp_path / "a b.toml"  # a name that no key can have
    robot.write_text(ur3.read_text())
    demo = marked.start("demo", "--seconds", "5", "--robot", str(robot), cwd=tmp_path)
    _, err = demo.communicate(timeout=60)
    assert demo.returncode == 2
    assert "'a b'" in err
    assert not marked.alive()

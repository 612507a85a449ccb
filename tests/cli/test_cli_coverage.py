"""``ssm coverage`` as users run it, with small settings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_kit import Run

from ssm_service.config.load import robots_directory

QUICK = ("--resolution", "0.03", "--distance", "0.2")


def test_summary_says_what_cannot_be_seen_and_what_silence_is_worth(ssm: Run) -> None:
    done = ssm("coverage", *QUICK)
    assert done.returncode == 0, done.stderr
    assert "forearm_link: 8 sensors in 1 ring" in done.stdout
    assert "a ball of 50 mm can touch it unseen" in done.stdout
    assert "no sensors on: base_link, shoulder_link, upper_arm_link" in done.stdout
    assert "a silence justifies: 0.000 m/s" in done.stdout
    assert "no other link stands in a sensor's way" in done.stdout


def test_json_is_the_same_twice_and_has_a_bound_on_each_share(ssm: Run) -> None:
    first, second = (ssm("coverage", "--json", *QUICK) for _ in range(2))
    assert first.returncode == 0, first.stderr
    assert first.stdout == second.stdout
    report = json.loads(first.stdout)
    link = report["links"]["forearm_link"]
    assert report["radius_m"] == 0.05
    assert report["reading_error_m"] == 0.06
    assert link["clear_distance"]["proved_m"] == 0.0
    assert link["clear_distance"]["no_blind_spot_to_distance"] is False
    assert link["largest_unseen_touching_ball"]["at_most_m"] is None
    for table in ("places_by_gap", "ring_plane_by_gap", "ring_band_by_gap"):
        for row in link[table]:
            cells = [row[key] for key in ("unseen", "by_one", "by_two", "by_more")]
            assert sum(cell["share"] for cell in cells) == pytest.approx(1.0, abs=1e-9)
            assert all(0.0 <= cell["error"] <= 1.0 for cell in cells)
    speed = link["speed"]
    assert speed["greatest_m_s"] == 0.0
    assert speed["stopping_time_s"] == 0.159
    # 1.14 m less 1.6·(0.18 + 0.159), over 0.18 + 0.159/2
    assert speed["greatest_if_nothing_were_unseen_m_s"] == pytest.approx((1.14 - 0.5424) / 0.2595, abs=1e-9)


def test_the_covered_design_is_proved_on_the_command_line(ssm: Run) -> None:
    done = ssm("coverage", "--robot", "ur3_covered", "--json", "--resolution", "0.03", timeout=110.0)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert list(report["links"]) == ["upper_arm_link", "forearm_link"]
    for link in report["links"].values():
        assert link["clear_distance"]["no_blind_spot_to_distance"] is True
        assert link["clear_distance"]["proved_m"] >= 0.355
        assert link["largest_unseen_touching_ball"]["at_most_m"] < 0.05
        assert link["speed"]["greatest_m_s"] > 0.0


def test_report_folder_has_numbers_and_three_figures_a_link(ssm: Run, tmp_path: Path) -> None:
    done = ssm("coverage", "--out", "report", *QUICK)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "report" / "coverage.json").read_text())
    assert report["figures"] == [f"{kind}-forearm_link.png" for kind in ("polar", "surface", "unseen")]
    for name in report["figures"]:
        assert (tmp_path / "report" / name).read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in (tmp_path / "report").iterdir()) == sorted(
        ["coverage.json", *report["figures"]]
    )


def test_without_stopping_data_no_speed_is_made_up(ssm: Run, tmp_path: Path) -> None:
    text = (robots_directory() / "ur3.toml").read_text()
    text, _, _ = text.partition("# S_p of")  # the profile that needs them
    lines = text.splitlines()
    kept = [line for line in lines if "distance_rad" not in line and not line.startswith("[stopping]")]
    (tmp_path / "mine.toml").write_text("\n".join(kept))
    done = ssm("coverage", "--robot", "./mine.toml", *QUICK)
    assert done.returncode == 0, done.stderr
    assert "no speed can be said: the robot file has no stopping data" in done.stdout
    given = ssm("coverage", "--robot", "./mine.toml", "--json", "--stopping-time", "0.3", *QUICK)
    assert json.loads(given.stdout)["links"]["forearm_link"]["speed"]["stopping_time_s"] == 0.3


def test_at_a_configuration_the_arm_stands_in_the_way(ssm: Run) -> None:
    done = ssm("coverage", "--position", "0,-1.2,2.4,0,0,0", "--json", *QUICK)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["position"] == [0.0, -1.2, 2.4, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--radius", "0"), "--radius"),
        (("--distance", "nan"), "--distance"),
        (("--resolution", "0.0001"), "--resolution"),
        (("--position", "a,b,c,d,e,f"), "--position"),
        (("--robot", "nobody"), "--robot"),
    ],
)
def test_wrong_usage_ends_with_2_and_names_the_option(
    ssm: Run, arguments: tuple[str, ...], named: str
) -> None:
    done = ssm("coverage", *arguments)
    assert done.returncode == 2
    assert named in done.stderr
    assert "Traceback" not in done.stderr


def test_a_folder_that_cannot_be_made_is_wrong_usage(ssm: Run, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    done = ssm("coverage", "--out", "taken", *QUICK)
    assert done.returncode == 2
    assert "--out" in done.stderr

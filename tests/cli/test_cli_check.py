"""``ssm check``: faults, weak points, and files that cannot be read."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ssm_service.cli.check_robot import check_robot
from ssm_service.cli.check_zenoh import check_zenoh
from ssm_service.cli.faults import Removed, steps_of
from ssm_service.errors import ConfigError

UR3 = Path(__file__).resolve().parents[2] / "robots" / "ur3.toml"


def variant(folder: Path, *changes: tuple[str, str]) -> Path:
    """Return a copy of the UR3's file with each text replaced by another."""
    text = UR3.read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    file = folder / "arm.toml"
    file.write_text(text, encoding="utf-8")
    return file


def found(file: Path, level: str) -> dict[str, str]:
    return {f.key: f.text for f in check_robot(str(file)).findings if f.level == level}


def test_a_shipped_robot_has_no_fault_and_its_weak_points_are_named(ssm):
    done = ssm("check", "ur3", "--json")
    assert done.returncode == 0
    report = json.loads(done.stdout)
    assert (report["kind"], report["faults"]) == ("robot", 0)
    keys = {finding["key"] for finding in report["findings"] if finding["level"] == "weak"}
    assert {"rings[0]", "sources.obstacles.required", "sources.ranges.timeout_s"} <= keys
    assert report["weak"] == len([f for f in report["findings"] if f["level"] == "weak"])


def test_words_are_one_line_a_finding(ssm):
    done = ssm("check")
    assert done.returncode == 0
    first, *rest, last = done.stdout.splitlines()
    assert first == str(UR3)
    assert {line.split()[0] for line in rest} <= {"ok", "weak", "note"}
    assert last.startswith("0 faults, ")


def test_a_wrong_key_is_a_fault_with_what_is_allowed(ssm, tmp_path):
    file = variant(tmp_path, ('parent_frame = "forearm_link"', 'parent_frame = "forarm_link"'))
    done = ssm("check", str(file))
    assert done.returncode == 1
    assert "fault rings[0].parent_frame" in done.stdout
    assert "forearm_link" in done.stdout


def test_all_faults_are_found_by_their_own_names_both_in_the_file_and_against_the_urdf(tmp_path):
    ring = UR3.read_text().partition("[[rings]]")[2].partition("# The paper's scene")[0]
    file = variant(
        tmp_path,
        ('parent_frame = "forearm_link"', 'parent_frame = "forarm_link"'),
        ("timeout_s = 0.4", "timeout_s = -0.4"),
        ("[joints.locked]", 'frob = 3\nlinks = ["nolink"]\n[joints.locked]\nfoo = 3.0'),
        ("[limits]", "[[rings]]" + ring.replace('name = "forearm"', 'name = "b"\nradius = 1') + "[limits]"),
    )
    report = check_robot(str(file))
    faults = [finding.key for finding in report.findings if finding.level == "fault"]
    assert faults[0] == "frob"
    assert set(faults) == {
        "frob", "rings[1].radius", "sources.ranges.timeout_s", "joints.locked.foo", "links[0]",
        "rings[0].parent_frame",
    }  # fmt: skip
    assert len(faults) == len(set(faults))
    assert report.findings[-1].level == "note"
    assert "check again" in report.findings[-1].text


def test_an_entry_of_a_list_keeps_its_number_after_another_was_taken_out():
    removed = Removed()
    document = {"rings": [{"a": 1}, {"b": 2}, {"c": 3}]}
    document = removed.without(document, ["rings", 0, "missing"])
    assert document == {"rings": [{"b": 2}, {"c": 3}]}
    assert removed.original(["rings", 0, "b"]) == "rings[1].b"
    document = removed.without(document, ["rings", 1])
    assert document == {"rings": [{"b": 2}]}
    assert removed.original(["rings", 0]) == "rings[1]"
    assert removed.without({"a": 1}, ["b"]) is None


def test_the_steps_of_a_key_path():
    assert steps_of('rings[10].a-b."c.d"[0]') == ["rings", 10, "a-b", "c.d", 0]


@pytest.mark.parametrize(
    ("old", "new", "level", "key", "words"),
    [
        ("range_max_m = 1.2", "range_max_m = 0.3", "fault", "rings[0].range_max_m", "0.355"),
        ("range_max_m = 1.2", "range_max_m = 0.36", "weak", "rings[0].range_max_m", "0.3 m"),
        ("count = 8", "count = 8\nrange_min_m = 0.2", "fault", "rings[0].range_min_m", "silence"),
        ("timeout_s = 0.4", "timeout_s = 0.16", "fault", "sources.ranges.timeout_s", "stale"),
        ("timeout_s = 0.4", "timeout_s = 0.2", "weak", "sources.ranges.timeout_s", "lost message"),
        ("joint_speed_rad_s = 0.24", "joint_speed_rad_s = 9.0", "fault",
         "profiles.kang2022.yellow.joint_speed_rad_s", "slows nothing"),
        ("[limits]", "[limits]\nvelocity_rad_s = { elbow_joint = 50.0 }", "weak",
         "limits.velocity_rad_s.elbow_joint", "no effect"),
        ("[joints.locked]", 'links = ["forearm_link"]\n[joints.locked]', "weak", "links", "wrist_3_link"),
        ("reading_error_m = 0.06", "reading_error_m = 0.02", "weak", "assumptions.reading_error_m",
         "not sound"),
        ("recovery_ticks = 100  ", "disagree_margin_m = 0.1\nrecovery_ticks = 100  ", "weak",
         "profiles.kang2022.uncovered", "counts as free"),
    ],
)  # fmt: skip
def test_what_is_thin_is_said(tmp_path, old, new, level, key, words):
    findings = found(variant(tmp_path, (old, new)), level)
    assert words in findings[key]


def test_a_file_that_is_no_toml_cannot_be_read(ssm, tmp_path):
    file = tmp_path / "arm.toml"
    file.write_text("urdf = ")
    done = ssm("check", str(file))
    assert (done.returncode, done.stdout) == (2, "")
    assert "arm.toml" in done.stderr


TIGHT = """{
  mode: "router",
  listen: { endpoints: ["tcp/127.0.0.1:7447"] },
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  transport: { link: { tx: { lease: 100, queue: { size: { real_time: 16, interactive_high: 16 } } } } },
}"""


def zenoh_file(folder: Path, text: str) -> Path:
    file = folder / "zenoh.json5"
    file.write_text(text)
    return file


def test_a_tight_network_has_neither_faults_nor_weak_points(ssm, tmp_path):
    done = ssm("check", str(zenoh_file(tmp_path, TIGHT)), "--json")
    report = json.loads(done.stdout)
    assert (done.returncode, report["kind"], report["faults"], report["weak"]) == (0, "zenoh", 0, 0)


@pytest.mark.parametrize(
    ("old", "new", "level", "key"),
    [
        ("tcp/127.0.0.1:7447", "tcp/0.0.0.0:7447", "weak", "listen/endpoints"),
        ("tcp/127.0.0.1:7447", "tcp/0.0.0.0:7447", "weak", "access_control"),
        ("tcp/127.0.0.1:7447", "tcp/[::]:7447", "weak", "listen/endpoints"),
        ("tcp/127.0.0.1:7447", "tls/0.0.0.0:7447", "fault", "transport/link/tls/listen_certificate"),
        ("tcp/127.0.0.1:7447", "tls/0.0.0.0:7447", "weak", "transport/link/tls/enable_mtls"),
        (
            "multicast: { enabled: false }",
            "multicast: { enabled: true }",
            "weak",
            "scouting/multicast/enabled",
        ),
        ("multicast: { enabled: false }, ", "", "weak", "scouting/multicast/enabled"),
        ("gossip: { enabled: false }", "", "weak", "scouting/gossip/enabled"),
        ("lease: 100", "lease: 10000", "weak", "transport/link/tx/lease"),
        ("real_time: 16", "real_time: 2", "weak", "transport/link/tx/queue/size/real_time"),
        (
            "interactive_high: 16",
            "interactive_high: 2",
            "weak",
            "transport/link/tx/queue/size/interactive_high",
        ),
        ('listen: { endpoints: ["tcp/127.0.0.1:7447"] },', "", "weak", "listen/endpoints"),
        ("tcp/127.0.0.1:7447", "tcp/127.example.org:7447", "weak", "listen/endpoints"),
        ("  scouting", '  connect: { endpoints: ["tcp/router:1"] }, scouting', "weak", "connect/endpoints"),
        ("tcp/127.0.0.1:7447", "tls/0.0.0.0:7447", "weak", "transport/link/tls/close_link_on_expiration"),
        (
            "scouting:",
            'access_control: { enabled: true, default_permission: "allow", rules: [] }, scouting:',
            "weak",
            "access_control/default_permission",
        ),
    ],
)
def test_each_opening_of_the_network_is_named(tmp_path, old, new, level, key):
    assert TIGHT.count(old) == 1
    report = check_zenoh(zenoh_file(tmp_path, TIGHT.replace(old, new)))
    assert (level, key) in {(finding.level, finding.key) for finding in report.findings}


@pytest.mark.parametrize("text", ["{", "{ listn: {} }", '{ listen: { endpoints: ["nonsense"] } }'])
def test_what_zenoh_does_not_read_is_an_error(tmp_path, text):
    with pytest.raises(ConfigError, match=r"zenoh\.json5"):
        check_zenoh(zenoh_file(tmp_path, text))

"""The numbers of a recording, against ones worked out by hand."""

from __future__ import annotations

import pytest

from ssm_service.cli.recording import CommandRow, DecisionRow, JointRow, Recording, StopRow
from ssm_service.cli.summary import limits_obeyed, summarise, zone_shares
from ssm_service.cli.summary_words import summary_lines
from ssm_service.safety import Zone


def decision(t: float, seq: int, zone: Zone = Zone.GREEN, limit: float = 1.0, **fields) -> DecisionRow:
    values = {"exact": None, "estimated": None, "reasons": (), **fields}
    return DecisionRow(t=t, seq=seq, zone=zone, limit=(limit,), **values)


def recording(**fields) -> Recording:
    return Recording(robot="arm", joint_names=("joint",), **fields)


def test_nothing_recorded_is_nothing_measured():
    summary = summarise(recording())
    assert set(summary["zones"].values()) == {None}
    assert summary["decisions"]["received"] == 0
    for key in ("mean_rate_hz", "worst_gap_s"):
        assert summary["decisions"][key] is None
    assert summary["least_exact_distance_m"] is None
    assert summary["joint_speed_limits"]["obeyed_share"] is None
    assert summary["joint_speed_limits"]["commands_within_share"] is None
    assert summary["service"] is None
    assert all("None" not in line for line in summary_lines(summary))


def test_a_decision_holds_until_the_next_one_arrives():
    rows = [decision(0.0, 1), decision(1.0, 2, Zone.RED), decision(1.5, 3, Zone.STOP), decision(4.0, 4)]
    assert zone_shares(recording(decisions=rows)) == {
        "green": 0.25, "yellow": 0.0, "red": 0.125, "stop": 0.625,
    }  # fmt: skip


def test_rate_gaps_changes_and_distances():
    rows = [
        decision(0.0, 1, exact=0.5),
        decision(0.1, 2, Zone.RED, exact=0.2, estimated=0.3, reasons=("distance",)),
        decision(0.4, 5, Zone.RED, estimated=0.1, reasons=("distance", "recovering")),
        decision(0.5, 6),
    ]
    summary = summarise(recording(decisions=rows, seconds=0.6))
    assert summary["zone_changes"] == 2
    assert summary["decisions"]["mean_rate_hz"] == pytest.approx(6.0)
    assert summary["decisions"]["worst_gap_s"] == pytest.approx(0.3)
    assert (summary["decisions"]["sequence_gaps"], summary["decisions"]["lost"]) == (1, 2)
    assert (summary["least_exact_distance_m"], summary["least_estimated_distance_m"]) == (0.2, 0.1)
    assert summary["reasons"] == {"distance": 2, "recovering": 1}


def test_speeds_are_compared_with_the_limit_known_at_that_time():
    decisions = [decision(1.0, 1, limit=0.5), decision(2.0, 2, Zone.RED, limit=0.2)]
    speeds = [(0.5, 9.0), (1.0, 0.5), (1.9, -0.5), (2.0, -0.3), (2.2, 0.25), (2.3, 0.2), (2.4, 0.0)]
    joints = [JointRow(t, (0.0,), (v,)) for t, v in speeds]
    limits = limits_obeyed(recording(decisions=decisions, joints=joints))
    assert limits["joint_states"] == 6
    assert limits["obeyed_share"] == pytest.approx(4 / 6)
    assert limits["greatest_excess_rad_s"] == pytest.approx(0.1)
    assert limits["longest_excess_s"] == pytest.approx(0.3)


def test_commands_are_compared_with_their_own_tick():
    decisions = [decision(0.0, 1, limit=0.5), decision(0.1, 2, limit=0.2)]
    commands = [CommandRow(0.0, 1, (0.5,)), CommandRow(0.1, 2, (0.3,)), CommandRow(0.2, 3, (9.0,))]
    limits = limits_obeyed(recording(decisions=decisions, commands=commands))
    assert limits["commands_within_share"] == 0.5


def test_the_watchdogs_own_stops_are_counted():
    stops = [StopRow(0.0, 0.25, ("stale:service",)), StopRow(1.0, 1.5, ("stale:service",))]
    assert summarise(recording(stops=stops))["watchdog_stops"] == {
        "count": 2, "seconds": 0.75, "reasons": {"stale:service": 2},
    }  # fmt: skip

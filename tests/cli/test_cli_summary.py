"""The numbers of a recording, against ones worked out by hand."""

from __future__ import annotations

from collections import Counter

import pytest

from ssm_service.cli.limits import limits_obeyed
from ssm_service.cli.recording import CommandRow, DecisionRow, JointRow, Recording, StopRow
from ssm_service.cli.summary import summarise, zone_shares
from ssm_service.cli.summary_words import summary_lines
from ssm_service.safety import Zone


def decision(t: float, seq: int, zone: Zone = Zone.GREEN, limit: float = 1.0, **fields) -> DecisionRow:
    values = {"exact": None, "estimated": None, "reasons": (), **fields}
    return DecisionRow(t=t, seq=seq, zone=zone, limit=(limit,), **values)


def recording(**fields) -> Recording:
    return Recording(robot="arm", joint_names=("joint",), **fields)


def words(rows: Recording) -> list[str]:
    return " ".join(summary_lines(summarise(rows))).split()


def test_nothing_recorded_is_nothing_measured():
    summary = summarise(recording())
    assert set(summary["zones"].values()) == {None}
    assert summary["decisions"]["received"] == 0
    for key in ("mean_rate_hz", "worst_gap_s"):
        assert summary["decisions"][key] is None
    assert summary["least_exact_distance_m"] is None
    assert summary["joint_speed_limits"]["joint_states_within_share"] is None
    assert summary["machine_too_busy"] is False
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
    speeds = [(0.5, 9.0), (1.0, 0.5), (1.9, -0.5), (2.0, -0.3), (2.2, 0.25), (2.25, 0.2), (2.4, 0.0)]
    joints = [JointRow(t, (0.0,), (v,)) for t, v in speeds]
    rows = recording(decisions=decisions, joints=joints)
    limits = limits_obeyed(rows)
    assert limits["joint_states"] == 6
    assert limits["joint_states_within_share"] == pytest.approx(4 / 6)
    braking = limits["above_a_limit_that_had_just_fallen"]
    assert braking["joint_states"] == 2
    assert braking["longest_after_the_fall_s"] == pytest.approx(0.2)
    assert braking["greatest_excess_rad_s"] == pytest.approx(0.1)
    assert limits["above_a_limit_otherwise"] == {"joint_states": 0, "greatest_excess_rad_s": None}
    assert "never above a limit otherwise" in " ".join(words(rows))


def test_what_is_too_fast_without_a_limit_that_fell_is_not_put_down_to_braking():
    # A limit that rises, or that fell long ago, excuses nothing.
    decisions = [decision(0.0, 1, limit=0.5), decision(1.0, 2, limit=0.2), decision(2.0, 3, limit=0.3)]
    speeds = [(0.5, 0.6), (1.31, 0.25), (2.1, 0.4)]
    rows = recording(decisions=decisions, joints=[JointRow(t, (0.0,), (v,)) for t, v in speeds])
    limits = limits_obeyed(rows)
    assert limits["above_a_limit_that_had_just_fallen"]["joint_states"] == 0
    otherwise = limits["above_a_limit_otherwise"]
    assert otherwise["joint_states"] == 3
    assert otherwise["greatest_excess_rad_s"] == pytest.approx(0.1)
    said = " ".join(words(rows))
    assert "TOO FAST" in said
    assert "never" not in said


def test_each_joint_is_judged_by_its_own_limit():
    def both(t: float, seq: int, *limit: float) -> DecisionRow:
        return decision(t, seq)._replace(limit=limit)

    decisions = [both(0.0, 1, 1.0, 1.0), both(1.0, 2, 0.5, 1.0)]
    joints = [JointRow(1.1, (0.0, 0.0), (0.4, 1.2))]
    limits = limits_obeyed(Recording(robot="arm", joint_names=("a", "b"), decisions=decisions, joints=joints))
    assert limits["above_a_limit_that_had_just_fallen"]["joint_states"] == 0
    assert limits["above_a_limit_otherwise"]["joint_states"] == 1


def test_commands_are_compared_with_their_own_tick():
    decisions = [decision(0.0, 1, limit=0.5), decision(0.1, 2, limit=0.2)]
    commands = [CommandRow(0.0, 1, (0.5,)), CommandRow(0.1, 2, (0.3,)), CommandRow(0.2, 3, (9.0,))]
    limits = limits_obeyed(recording(decisions=decisions, commands=commands))
    assert limits["commands_within_share"] == 0.5


def test_a_profile_that_does_not_slow_a_retreat_is_not_called_too_fast():
    decisions = [decision(0.0, 1, limit=0.2)]
    commands, joints = [CommandRow(0.0, 1, (0.5,))], [JointRow(1.0, (0.0,), (0.5,))]
    rows = recording(decisions=decisions, commands=commands, joints=joints)
    assert "TOO FAST" in " ".join(words(rows))
    rows.directed = True
    said = " ".join(words(rows))
    assert "TOO FAST" not in said
    assert "0.0 % of 1 within the limits that are safe in any direction" in said


def test_the_watchdogs_own_stops_are_counted():
    stops = [StopRow(0.0, 0.25, ("stale:service",)), StopRow(1.0, 1.5, ("stale:service",))]
    assert summarise(recording(stops=stops))["watchdog_stops"] == {
        "count": 2, "seconds": 0.75, "reasons": {"stale:service": 2},
    }  # fmt: skip


def test_refused_messages_are_told():
    rows = recording(decisions=[decision(0.0, 1)], refused=Counter(wrong_encoding=2, not_json=1))
    assert "refused 3 messages: wrong_encoding (2), not_json (1)" in " ".join(words(rows))
    assert "refused" not in words(recording(decisions=[decision(0.0, 1)]))


@pytest.mark.parametrize(("stops", "busy"), [(0, False), (3, False), (4, True)])
def test_many_troubles_are_put_down_to_the_machine(stops, busy):
    rows = recording(
        decisions=[decision(0.002 * i, i) for i in range(1000)],
        stops=[StopRow(0.1 * i, 0.1 * i + 0.01, ("stale:service",)) for i in range(stops)],
    )
    summary = summarise(rows) | {"asked_rate_hz": 500.0}
    assert summary["machine_too_busy"] is busy
    said = " ".join(summary_lines(summary))
    assert ("--rate 200" in said) is busy
    assert ("worst gap 2.0 ms); try" in " ".join(said.split())) is busy


def test_lines_fit_80_columns_and_one_is_not_plural():
    rows = recording(
        decisions=[decision(0.0, 1, reasons=tuple(f"stale:source{i}" for i in range(20))), decision(1.0, 2)],
        stops=[StopRow(0.0, 0.1, ("stale:service",))],
    )
    lines = summary_lines(summarise(rows))
    assert max(map(len, lines)) <= 80
    assert "1 stop of" in " ".join(words(rows))
    assert {line[:16].strip() for line in lines} >= {"", "time", "reasons"}

"""What a person sees while robots are followed: rates, and pictures for terminals of any size."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console, ConsoleDimensions, RenderableType

from ssm_service.cli.figure_events import events
from ssm_service.cli.live import LiveState, draw, draw_all
from ssm_service.cli.meters import RateMeter
from ssm_service.cli.recording import DecisionRow, Reader, Recording, StopRow
from ssm_service.cli.report import FIGURES, ReportFolder
from ssm_service.client import Followed
from ssm_service.errors import ConfigError, InputError
from ssm_service.safety import Zone
from ssm_service.wire import encoding_of
from ssm_service.wire import messages as m

JOINTS = tuple(f"joint_{i}" for i in range(6))


def state(name: str = "ur3", zone: Zone = Zone.YELLOW, reasons: tuple[str, ...] = ("distance",)) -> LiveState:
    numbers = (0.24,) * len(JOINTS)
    followed = Followed(zone=zone, name=JOINTS, velocity=numbers, speed_limit=numbers, reasons=reasons)
    return LiveState(title=f"ssm watch · {name}", followed=followed, rate=498.0)


def rows_of(picture: RenderableType, width: int, height: int) -> list[str]:
    console = Console(width=width, height=height, force_terminal=False, record=False)
    with console.capture() as capture:
        console.print(picture)
    return capture.get().splitlines()


def test_the_rate_is_that_of_the_decisions_however_rarely_one_looks():
    meter = RateMeter()
    for look in range(100):  # every 12 ms, at 500 decisions a second
        meter.add(0.012 * look, 6 * look, "a")
    assert meter.rate(0.012 * 99) == pytest.approx(500.0)


def test_a_restarted_service_is_measured_anew():
    meter = RateMeter()
    meter.add(0.0, 1000, "a")
    meter.add(0.1, 1050, "a")
    meter.add(0.2, 3, "b")
    assert meter.rate(0.2) is None
    meter.add(0.4, 103, "b")
    assert meter.rate(0.4) == pytest.approx(500.0)
    assert meter.rate(9.0) is None


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_the_zones_word_is_never_shortened(width):
    states = [state("a-robot-with-a-long-name", reasons=("stale:obstacles", "waiting:ranges", "overrun"))]
    rows = rows_of(draw_all(states, ConsoleDimensions(width, 20)), width, 20)
    assert len(rows) == 2
    assert " YELLOW " in rows[1]
    assert max(map(len, rows)) <= width


def test_where_not_all_robots_fit_the_worst_come_first():
    states = [state(f"r{i}", Zone.GREEN) for i in range(20)] + [state("bad", Zone.STOP)]
    assert "bad" in rows_of(draw_all(states, ConsoleDimensions(60, 14)), 60, 14)[1]
    assert "r0" in rows_of(draw_all(states, ConsoleDimensions(60, 40)), 60, 40)[1]


@pytest.mark.parametrize(("width", "height"), [(60, 14), (40, 8), (80, 24), (100, 20), (100, 40)])
def test_the_picture_fits_the_terminal_with_zone_and_distances_first(width, height):
    shown = state()
    shown.history.extend([(0.3, Zone.RED)] * 60)
    rows = rows_of(draw(shown, ConsoleDimensions(width, height)), width, height)
    assert len(rows) < height
    assert max(map(len, rows)) <= width
    words = "\n".join(rows)
    assert words.index("YELLOW") < words.index("exact") < words.index("decisions/s")
    assert ("joint_0" in words) is (height >= 14)
    assert ("joint_5" in words) is (height > 14)


def test_green_without_reasons_is_not_explained():
    assert "undisturbed" not in "\n".join(rows_of(draw(state(reasons=()), ConsoleDimensions(80, 40)), 80, 40))


def row(t: float, *reasons: str) -> DecisionRow:
    return DecisionRow(t, round(1e3 * t), Zone.YELLOW, None, None, (1.0,), reasons)


def test_the_beginnings_of_overruns_and_stops_are_marked():
    rows = [row(0.0), row(1.0, "overrun"), row(1.1, "overrun"), row(1.2, "recovering"), row(2.0, "overrun")]
    rows += [row(3.0, "stale:joints", "stale:ranges"), row(3.1, "distance", "stale:ranges"), row(4.0)]
    stops = [StopRow(5.0, 5.1, ("stale:service",))]
    recording = Recording(robot="arm", joint_names=("joint",), decisions=rows, stops=stops)
    assert {event.label: event.times for event in events(recording)} == {
        "late tick (overrun)": [1.0, 2.0],
        "an input was missing": [3.0],
        "this consumer's own stop": [5.0],
    }
    assert not list(events(Recording(robot="arm", joint_names=("joint",), decisions=[row(0.0, "distance")])))


def test_an_old_report_does_not_outlive_a_run_that_fails(tmp_path: Path):
    for name in (*FIGURES, "summary.json", "notes.txt"):
        (tmp_path / name).write_text("old")
    with pytest.raises(RuntimeError), ReportFolder(tmp_path):
        raise RuntimeError
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_folders_that_were_made_for_nothing_are_removed_and_no_others(tmp_path: Path):
    with ReportFolder(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="--out"), ReportFolder(tmp_path / "file"):
        pass
    assert (tmp_path / "file").exists()


class Sample:
    """What a recorder reads of a Zenoh sample."""

    def __init__(self, encoding: str, payload: bytes) -> None:
        import zenoh

        self.kind = zenoh.SampleKind.PUT
        self.encoding = encoding
        self.payload = zenoh.ZBytes(payload)


OBSTACLES = b'{"producer": "a", "seq": 1, "stamp_ns": 1, "obstacles": []}'


@pytest.mark.parametrize("encoding", [encoding_of(m.Obstacles), "application/json", "zenoh/bytes"])
def test_a_sample_that_names_its_schema_or_none_is_read(encoding):
    assert Reader(m.Obstacles).read(Sample(encoding, OBSTACLES)) == m.Obstacles(
        producer="a", seq=1, stamp_ns=1, obstacles=[]
    )


def test_a_sample_that_names_another_schema_is_refused_though_it_could_be_read():
    with pytest.raises(InputError) as refused:
        Reader(m.Obstacles).read(Sample(encoding_of(m.JointState), OBSTACLES))
    assert refused.value.cause == "wrong_encoding"

"""What the service measures: ages that are proved, periods, ticks, and the transport by echoes."""

from __future__ import annotations

import json
import time
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from msgspec.structs import replace
from service_kit import crc
from test_service_parts import MS, Channels, age

from ssm_service.model import Robot
from ssm_service.service.echoes import MAX_CONSUMERS
from ssm_service.service.publications import KEPT, Publications
from ssm_service.service.statistics import INTERVALS, Intervals, RecentGreatest
from ssm_service.wire import Heard
from ssm_service.wire.latch import Latch

SECOND = 1_000 * MS


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.load("ur3")


def with_sources(robot: Robot, **changes: Any) -> Any:
    """Return a robot whose joints source differs; nothing else of it is needed here."""
    file = robot.config.file
    joints = replace(file.sources.joints, **changes)
    config = SimpleNamespace(file=replace(file, sources=replace(file.sources, joints=joints)))
    names = ("joint_names", "position_lower", "position_upper", "velocity_limit", "rings", "sensor_count")
    return SimpleNamespace(config=config, **{name: getattr(robot, name) for name in names})


def published(channels: Channels, *ticks: tuple[int, float]) -> None:
    for seq, ms in ticks:
        channels.publications.add(seq, channels.begin + int(ms * MS))


class TestPublications:
    def test_a_tick_is_known_by_service_and_number(self) -> None:
        publications = Publications("me", 5)
        assert publications.time_of(Heard("me", 0)) is None  # nothing was published yet
        for seq in range(1, 4):
            publications.add(seq, 10 * seq)
        assert [publications.time_of(Heard("me", seq)) for seq in (1, 2, 3)] == [10, 20, 30]
        assert publications.time_of(Heard("me", 4)) is None
        assert publications.time_of(Heard("me", 10**18)) is None
        assert publications.time_of(Heard("earlier run", 2)) is None

    def test_one_that_is_no_longer_remembered_is_as_old_as_the_service(self) -> None:
        publications = Publications("me", 5)
        for seq in range(KEPT + 10):
            publications.add(seq, 1000 + seq)
        assert publications.time_of(Heard("me", 9)) == 5
        assert publications.time_of(Heard("me", 10)) == 1010
        assert publications.time_of(Heard("me", KEPT + 9)) == 1000 + KEPT + 9


class TestProvedAges:
    def test_an_age_counts_from_the_publication_of_the_tick_that_was_heard(self, robot: Robot) -> None:
        channels = Channels(robot)
        published(channels, (1, 0), (2, 30))
        channels.read(50)
        channels.session.arrive("joints", 1, after="service/1")
        assert age(channels.read(52)) == pytest.approx(52)
        channels.session.arrive("joints", 2, after="service/2")
        assert age(channels.read(54)) == pytest.approx(24)

    def test_it_is_never_younger_than_its_arrival_tells(self, robot: Robot) -> None:
        channels = Channels(robot)
        published(channels, (1, 90))
        channels.read(10)
        channels.session.arrive("joints", 1, after="service/1")
        assert age(channels.read(100)) == pytest.approx(90)

    @pytest.mark.parametrize("after", ["", "another/1", "service/7"])
    def test_a_tick_that_proves_nothing_leaves_the_bound_of_the_arrival(
        self, robot: Robot, after: str
    ) -> None:
        channels = Channels(robot)
        published(channels, (1, 0))
        channels.read(50)
        channels.session.arrive("joints", 1, after=after)
        assert age(channels.read(52)) == pytest.approx(2)

    @pytest.mark.parametrize("after", ["", "another/1", "service/7"])
    def test_where_a_proof_is_wanted_it_is_refused(self, robot: Robot, after: str) -> None:
        channels = Channels(with_sources(robot, prove_age=True))
        published(channels, (1, 0))
        channels.read(50)
        channels.session.arrive("joints", 1, after=after)
        assert channels.read(52).joints.value is None
        assert channels.refusals("joints") == {"unproved": 1}
        assert channels.watch.counts == {}  # a service that has just started is no fault of the network
        channels.session.arrive("joints", 1, after="service/1")
        assert age(channels.read(54)) == pytest.approx(54)

    def test_a_delayed_message_is_old_however_late_it_arrives(self, robot: Robot) -> None:
        """Held up by the network for a second, with nothing in the way to show it but the tick it names."""
        channels = Channels(robot)
        published(channels, (1, 0))
        for ms in range(0, 1000, 50):
            channels.read(ms)
        channels.session.arrive("joints", 1, after="service/1")
        assert age(channels.read(1000)) == pytest.approx(1000)


class TestChecksums:
    def test_what_comes_without_is_refused_where_it_is_due(self, robot: Robot) -> None:
        channels = Channels(robot)
        channels.read(0)
        channels.session.arrive("joints", 1, attachment=None)
        inputs = channels.read(2)
        assert inputs.joints.value is None
        assert inputs.joints.invalid
        assert channels.refusals("joints") == {"missing_crc": 1}
        assert channels.watch.counts == {"masquerade": 1}

    def test_a_simple_driver_needs_none_but_one_that_is_there_is_checked(self, robot: Robot) -> None:
        channels = Channels(with_sources(robot, integrity="none"))
        channels.session.arrive("joints", 1, attachment=None)
        assert channels.read(2).joints.value is not None
        channels.session.arrive("joints", 2, attachment=b"crc32=00000000")
        assert channels.read(4).joints.invalid
        channels.session.arrive("joints", 3, attachment=b"")
        assert channels.read(6).joints.invalid
        assert channels.refusals("joints") == {"corrupt": 1, "bad_attachment": 1}
        channels.session.arrive("joints", 4)
        assert not channels.read(8).joints.invalid

    def test_who_has_sent_one_goes_on_sending_it(self, robot: Robot) -> None:
        channels = Channels(with_sources(robot, integrity="none"))
        channels.session.arrive("joints", 1)
        channels.session.arrive("joints", 2, attachment=None)
        channels.session.arrive("joints", 3)
        assert channels.read(2).joints.value is not None
        assert channels.refusals("joints") == {"missing_crc": 1}
        assert channels.watch.counts == {"masquerade": 1}
        channels.read(500)
        channels.session.arrive("joints", 1, "simple", attachment=None)  # another one, once that is silent
        assert not channels.read(502).joints.invalid

    def test_every_fault_has_its_name(self, robot: Robot) -> None:
        channels = Channels(robot)
        channels.read(0)
        channels.session.arrive("joints", 5)
        channels.session.arrive("joints", 5)
        channels.session.arrive("joints", 4)
        channels.session.arrive("joints", 6, "stranger")
        channels.session.arrive("joints", 7, attachment=b"crc32=12345678")
        channels.session.arrive("joints", 8, attachment=None)
        channels.session.arrive("joints", 9, text=b'{"producer": "driver", "seq": 9}')  # a driver's mistake
        channels.session.arrive("joints", 20)
        assert not channels.read(2).joints.invalid
        faults = ("repetition", "sequence", "insertion", "corruption", "masquerade")
        assert channels.watch.counts == dict.fromkeys(faults, 1)
        assert channels.channels.sources["joints"].gate.lost == 14


class TestPeriods:
    def test_the_longest_of_the_last_intervals(self) -> None:
        intervals = Intervals(10**6)
        assert intervals.greatest_ns == 0
        intervals.add(100)
        assert intervals.greatest_ns == 0
        intervals.add(110)
        intervals.add(150)
        intervals.add(155)
        assert intervals.greatest_ns == 40
        for index in range(INTERVALS):
            intervals.add(160 + 5 * index)
        assert intervals.greatest_ns == 5

    def test_a_silence_is_no_period(self) -> None:
        intervals = Intervals(1000)
        for now in (0, 10, 20, 1020):
            intervals.add(now)
        assert intervals.greatest_ns == 1000
        intervals.add(2021)
        assert intervals.greatest_ns == 0
        intervals.add(2031)
        assert intervals.greatest_ns == 10

    def test_each_source_has_its_own(self, robot: Robot) -> None:
        channels = Channels(robot)
        assert channels.read(0).joints.period_s == 0.0
        for seq, ms in enumerate((10, 18, 26, 50, 58)):
            channels.session.arrive("joints", seq)
            if seq % 2 == 0:
                channels.session.arrive("obstacles", seq)
            inputs = channels.read(ms)
        assert inputs.joints.period_s == pytest.approx(0.024)
        assert inputs.obstacles.period_s == pytest.approx(0.032)
        assert inputs.target.period_s == 0.0


class TestRecentGreatest:
    def test_it_counts_for_one_window_at_least_and_for_two_at_most(self) -> None:
        for begin in range(0, 1000, 37):
            recent = RecentGreatest(1000)
            assert recent.at(begin) is None
            recent.add(3, begin)
            recent.add(7, begin + 500)
            recent.add(5, begin + 900)
            assert all(recent.at(begin + after) == 7 for after in range(900, 1500, 50))
            recent.add(2, begin + 1600)
            assert recent.at(begin + 1600) in (5, 7)
            assert recent.at(begin + 2600) in (2, 5)
            assert recent.at(begin + 3600) is None

    def test_a_greater_one_counts_at_once(self) -> None:
        recent = RecentGreatest(1000)
        recent.add(1, 10_000)
        recent.add(4, 10_999)
        recent.add(2, 11_000)
        assert recent.at(11_000) == 4
        recent.add(9, 11_001)
        assert recent.at(11_002) == 9
        assert recent.at(100_000) is None


class Echoed(Channels):
    """A service that published tick n at n × 10 ms."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        published(self, *((tick, 10.0 * tick) for tick in range(100)))

    def echo(
        self,
        seq: int,
        tick: int,
        held_ms: float = 0.0,
        *,
        producer: str = "consumer",
        service: str = "service",
        attachment: bytes | None = b"right",
        **changed: Any,
    ) -> None:
        fields = {
            "producer": producer,
            "seq": seq,
            "stamp_ns": 0,
            "service": service,
            "tick": tick,
            "held_ns": int(held_ms * MS),
        }
        payload = json.dumps({**fields, **changed}).encode()
        if attachment == b"right":
            attachment = crc("ssm/ur3/in/echo", payload)
        self.session.waiting["echo"].append(
            SimpleNamespace(
                kind=zenoh.SampleKind.PUT,
                encoding=zenoh.Encoding.APPLICATION_JSON,
                payload=SimpleNamespace(to_bytes=lambda: payload),
                attachment=None if attachment is None else SimpleNamespace(to_bytes=lambda: attachment),
            )
        )

    def transport(self, ms: float) -> float:
        return self.read(ms).transport_s * 1e3


class TestEchoes:
    def test_the_transport_is_what_the_echo_took_less_what_it_was_held(self, robot: Robot) -> None:
        service = Echoed(robot)
        assert service.transport(100) == 0.0
        service.echo(0, tick=10, held_ms=3)
        assert service.transport(108) == pytest.approx(5)
        assert service.channels.echoes.transport_s(service.begin + 109 * MS) == {
            "consumer": pytest.approx(0.005)
        }

    def test_the_greatest_of_all_consumers_and_of_the_last_second_counts(self, robot: Robot) -> None:
        service = Echoed(robot)
        service.echo(0, tick=10, producer="near")
        service.echo(0, tick=10, held_ms=-0.0, producer="far")
        assert service.transport(102) == pytest.approx(2)
        service.echo(1, tick=10, producer="far")
        assert service.transport(150) == pytest.approx(50)
        service.echo(2, tick=20, producer="far")
        assert service.transport(201) == pytest.approx(50)
        assert service.transport(900) == pytest.approx(50)
        assert service.transport(3200) == 0.0

    def test_a_forged_one_can_only_raise_it(self, robot: Robot) -> None:
        service = Echoed(robot)
        service.echo(0, tick=10, held_ms=10**6, producer="forger")
        assert service.transport(110) == 0.0
        assert service.channels.echoes.transport_s(service.begin + 110 * MS) == {"forger": 0.0}
        service.echo(0, tick=10)
        assert service.transport(120) == pytest.approx(20)
        for seq, held in enumerate((10**6, 0.0, 2**62 / MS), start=1):
            service.echo(seq, tick=12, held_ms=held)
        assert service.transport(121) == pytest.approx(20)
        service.echo(9, tick=0)
        assert service.transport(122) == pytest.approx(122)

    @pytest.mark.parametrize(
        ("changed", "cause", "fault"),
        [
            ({"attachment": None}, "missing_crc", "masquerade"),
            ({"attachment": b"crc32=12345678"}, "corrupt", "corruption"),
            ({"service": "another"}, "unknown_tick", ""),
            ({"tick": 100}, "unknown_tick", ""),
            ({"held_ns": -1}, "out_of_range", ""),
            ({"seq": 5}, "old_seq", "repetition"),
            ({"seq": 4}, "old_seq", "sequence"),
        ],
    )
    def test_a_bad_one_is_refused_and_counts_for_nothing(
        self, robot: Robot, changed: dict[str, Any], cause: str, fault: str
    ) -> None:
        service = Echoed(robot)
        service.echo(5, tick=10)
        assert service.transport(101) == pytest.approx(1)
        service.echo(**{"seq": 6, "tick": 11, **changed})
        assert service.transport(180) == pytest.approx(1)
        assert service.refusals("echo") == {cause: 1}
        assert service.watch.counts == ({fault: 1} if fault else {})

    def test_the_number_of_consumers_is_bounded_and_silent_ones_give_way(self, robot: Robot) -> None:
        service = Echoed(robot)
        for index in range(1000):
            service.echo(0, tick=10, producer=f"consumer {index}")
        service.transport(101)
        assert len(service.channels.echoes.transport_s(service.begin + 101 * MS)) == MAX_CONSUMERS
        assert service.refusals("echo") == {"too_many": 1000 - MAX_CONSUMERS}
        service.echo(1, tick=10, producer="consumer 0")
        service.echo(0, tick=99, producer="late")
        assert service.transport(5000) == pytest.approx(5000 - 100)
        heard = service.channels.echoes.transport_s(service.begin + 5000 * MS)
        assert set(heard) == {"consumer 0", "late"}

    def test_a_flood_of_echoes_leaves_the_others_their_share(self, robot: Robot) -> None:
        service = Echoed(robot)
        service.channels._budget_ns = 5 * MS
        service.read(0)
        for seq in range(3000):
            service.echo(seq, tick=10, attachment=b"x" * 400)
        service.session.arrive("joints", 1)
        begin = time.monotonic()
        assert service.read(2).joints.value is not None
        assert time.monotonic() - begin < 0.1


def test_two_errors_hold_the_zone_at_stop_in_the_tick_that_reads_them(robot: Robot) -> None:
    channels = Channels(robot)
    assert not channels.read(0).latched
    channels.watch._latch = Latch(60.0)
    channels.session.arrive("joints", 1, attachment=None)
    assert not channels.read(2).latched
    channels.session.arrive("target", 1, attachment=b"x")
    inputs = channels.read(4)
    assert inputs.latched
    assert channels.read(1e6).latched
    channels.watch.reset()
    assert not channels.read(2e6).latched

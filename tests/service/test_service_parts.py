"""The parts of the service alone: ages, budgets, the loop, with a hand-held clock where one counts."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zenoh
from msgspec.structs import replace
from service_kit import HEALTHY, alive, crc, wait_for

from ssm_service.errors import ConfigError, InputError
from ssm_service.model import Robot
from ssm_service.monitor import Decision, Inputs, Monitor
from ssm_service.safety import Zone
from ssm_service.service import Beat, FixedRateLoop, Service, ServiceOptions
from ssm_service.service.child import EvaluatingProcess
from ssm_service.service.inputs import InputChannels, Surroundings
from ssm_service.service.integrity import IntegrityWatch
from ssm_service.service.outputs import stopped
from ssm_service.service.publications import Publications
from ssm_service.service.statistics import Rejections, Timings
from ssm_service.wire import Keys
from ssm_service.wire.session import open_session, zenoh_config

MS = 1_000_000


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.load("ur3")


class FakeSession:
    """A session whose channels are lists that the test fills."""

    def __init__(self) -> None:
        self.waiting: dict[str, list[Any]] = {}

    def declare_subscriber(self, key: str, _channel: Any) -> Any:
        queue = self.waiting.setdefault(key.rpartition("/")[2], [])
        return SimpleNamespace(handler=SimpleNamespace(try_recv=lambda: queue.pop(0) if queue else None))

    def arrive(
        self,
        source: str,
        seq: int,
        producer: str = "driver",
        text: bytes | None = None,
        *,
        after: str = "",
        attachment: bytes | None = b"right",
    ) -> None:
        head = {"producer": producer, "seq": seq, "stamp_ns": 0}
        payload = json.dumps({**head, **HEALTHY[source][1]}).encode() if text is None else text
        if attachment == b"right":
            attachment = crc(f"ssm/ur3/in/{source}", payload, after)
        sample = SimpleNamespace(
            kind=zenoh.SampleKind.PUT,
            encoding=zenoh.Encoding.APPLICATION_JSON,
            payload=SimpleNamespace(to_bytes=lambda: payload),
            attachment=None if attachment is None else SimpleNamespace(to_bytes=lambda: attachment),
        )
        self.waiting[source].append(sample)


class Channels:
    """Input channels with a clock that the test moves, in ms from their making."""

    def __init__(self, robot: Robot, budget_ns: int = 10**12) -> None:
        self.session = FakeSession()
        self.begin = time.monotonic_ns()
        self.publications = Publications("service", self.begin)
        self.watch = IntegrityWatch()
        shared = Surroundings(
            robot=robot,
            session=self.session,  # type: ignore[arg-type]
            keys=Keys("ur3"),
            publications=self.publications,
            watch=self.watch,
        )
        self.channels = InputChannels(shared, budget_ns)

    def read(self, ms: float) -> Inputs:
        return self.channels.read(self.begin + int(ms * MS), overrun_s=0.0, duplicate=False)

    def refusals(self, source: str) -> dict[str, int]:
        return dict(self.channels.rejections.counts.get(source, {}))


def age(inputs: Inputs, source: str = "joints") -> float:
    return getattr(inputs, source).age_s * 1e3


def test_an_age_is_counted_from_when_the_channel_was_last_seen_empty(robot):
    channels = Channels(robot)
    channels.read(10)
    channels.session.arrive("joints", 1)
    assert age(channels.read(12)) == pytest.approx(2)
    assert age(channels.read(20)) == pytest.approx(10)
    channels.session.arrive("joints", 2)
    assert age(channels.read(22)) == pytest.approx(2)


def test_a_pause_of_our_own_makes_what_waited_as_old_as_the_pause(robot):
    channels = Channels(robot)
    channels.read(10)
    channels.session.arrive("joints", 1)
    assert age(channels.read(1010)) == pytest.approx(1000)
    assert age(channels.read(1012)) == pytest.approx(1002)


def test_what_did_not_fit_into_the_budget_keeps_its_age(robot):
    channels = Channels(robot, budget_ns=0)  # one message of a source in a tick
    channels.read(10)
    for seq in range(5):
        channels.session.arrive("joints", seq)
    for tick in range(5):
        assert age(channels.read(12 + 2 * tick)) == pytest.approx(2 + 2 * tick)
    # The channel was empty after the fifth, but that was seen only when a read found nothing left.
    channels.read(22)
    channels.session.arrive("joints", 9)
    assert age(channels.read(24)) == pytest.approx(2)


def test_a_refused_message_refreshes_nothing_and_is_counted(robot):
    channels = Channels(robot)
    channels.read(0)
    channels.session.arrive("joints", 5)
    assert not channels.read(2).joints.invalid
    for index, text in enumerate((b"", b"{}", b"x", None)):
        channels.session.arrive("joints", 5, text=text)
        inputs = channels.read(10 + index)
        assert inputs.joints.invalid
        assert age(inputs) == pytest.approx(10 + index)
    assert channels.refusals("joints") == {"not_json": 2, "missing_field": 1, "old_seq": 1}
    channels.session.arrive("joints", 6)
    assert not channels.read(20).joints.invalid


def test_a_refusal_is_over_after_the_timeout_at_most(robot):
    channels = Channels(robot)
    channels.read(0)
    channels.session.arrive("obstacles", 1, text=b"nonsense")
    assert channels.read(1).obstacles.invalid
    assert channels.read(250).obstacles.invalid
    assert not channels.read(252).obstacles.invalid
    assert channels.read(252).obstacles.value is None


def test_a_second_producer_must_have_come_a_timeout_after_the_first(robot):
    """Both waited for 0.3 s in the same queue: nothing says that the first was silent."""
    channels = Channels(robot)
    channels.read(0)
    channels.session.arrive("joints", 1, "good")
    channels.read(2)
    channels.session.arrive("joints", 1, "stranger")
    channels.session.arrive("joints", 2, "good")
    inputs = channels.read(302)
    assert channels.refusals("joints") == {"second_producer": 1}
    assert age(inputs) == pytest.approx(300)
    channels.read(500)
    channels.session.arrive("joints", 1, "stranger")
    assert age(channels.read(502)) == pytest.approx(2)


def test_a_flood_on_one_key_leaves_the_others_their_share(robot):
    channels = Channels(robot, budget_ns=4 * MS)
    channels.read(0)
    for seq in range(3000):
        channels.session.arrive("joints", seq, text=b"[" * 5000)
    for source in ("ranges", "obstacles", "target"):
        channels.session.arrive(source, 1)
    begin = time.monotonic()
    inputs = channels.read(2)
    assert time.monotonic() - begin < 0.1
    for source in ("ranges", "obstacles", "target"):
        assert getattr(inputs, source).value is not None


def test_counters_and_their_words_stay_bounded():
    rejections = Rejections()
    for index in range(10_000):
        rejections.add("joints", "not_json", f"{index} " + "x" * 10_000)
    assert rejections.counts == {"joints": {"not_json": 10_000}}
    assert len(rejections.last["joints"]) == 300


def test_timings_before_and_after_the_first():
    timings = Timings()
    assert timings.summary() == {}
    timings.add(1000)
    assert timings.summary() == {"p50": 1.0, "p99": 1.0, "max": 1.0}
    for value in range(20_000):
        timings.add(value * 1000)
    assert timings.summary()["p50"] == pytest.approx(17_500, abs=1)


def test_the_loop_skips_after_a_hiccup_and_stays_on_its_grid():
    period = 5 * MS
    loop, beats = FixedRateLoop(period), []

    def tick(beat):
        beats.append(beat)
        if len(beats) == 5:
            time.sleep(0.0521)

    loop.run(tick, lambda _: None, lambda: len(beats) < 12)
    assert {(beat.deadline_ns - beats[0].deadline_ns) % period for beat in beats} == {0}
    late = beats[5]
    assert late.skipped >= 9
    assert late.overrun_ns >= 9 * period - period
    assert all(b.deadline_ns > a.deadline_ns for a, b in itertools.pairwise(beats))
    for before, after in itertools.pairwise(beats):
        assert after.deadline_ns - before.deadline_ns == (1 + after.skipped) * period


def test_a_stop_keeps_what_was_seen_and_nothing_that_moves(robot):
    decision = Monitor(robot).step(Inputs())
    stop = stopped(decision, "overrun", tick=7)
    assert (stop.tick, stop.zone.word, stop.reasons, stop.speed_scaling) == (7, "stop", ("overrun",), 0.0)
    assert not np.any(stop.speed_limit)
    assert not np.any(stop.velocity)


@pytest.fixture
def service(robot):
    """A service in this process that has decided its first tick; the test makes it tick."""
    worker = SimpleNamespace(restart_if_dead=lambda: False)
    with open_session(zenoh_config("router")) as session:
        yield Service(robot, session, ServiceOptions(), lambda _: None, worker)  # type: ignore[arg-type]


def ticked(service: Service, step: Callable[[Inputs], Decision]) -> Decision:
    """Let the service tick once with another monitor; return what it published."""
    service._monitor.step = step  # type: ignore[method-assign]
    now = time.monotonic_ns()
    service._tick(Beat(now, now, 0, 0))
    assert service._outputs.last is not None
    published = json.loads(service._outputs.zone_reply.payload)
    assert (published["seq"], published["zone"]) == (
        service._outputs.last.tick,
        service._outputs.last.zone.word,
    )
    return service._outputs.last


def test_a_decision_that_grew_old_in_the_middle_of_its_tick_is_a_stop(service):
    green = replace(service._outputs.last, zone=Zone.GREEN, reasons=())
    seen: list[float] = []

    def step(inputs: Inputs, pause: float = 0.0) -> Decision:
        seen.append(inputs.overrun_s)
        time.sleep(pause)
        return replace(green, tick=1 + len(seen))

    assert ticked(service, step).zone is Zone.GREEN
    stop = ticked(service, lambda inputs: step(inputs, 0.03))
    assert (stop.tick, stop.zone, stop.reasons) == (3, Zone.STOP, ("overrun",))
    assert ticked(service, step).zone is Zone.GREEN  # only since this monitor does not look at the overrun
    ticked(service, step)
    assert seen[:2] == [0.0, 0.0]
    assert 0.03 <= seen[2] < 0.5
    assert seen[3] == 0.0


def test_a_monitor_that_fails_is_a_stop_and_one_warning(service):
    first, known = service._outputs.last, len(service.warnings)

    def step(_: Inputs) -> Decision:
        raise InputError("not_finite", "position", "nan", "finite numbers")

    for index in range(200):
        decision = ticked(service, step)
        assert (decision.tick, decision.zone, decision.reasons) == (2 + index, Zone.STOP, ("internal",))
    assert first.tick == 1
    assert len(service.warnings) == known + 1
    for index in range(1000):
        service.warn(str(index))
    assert len(service.warnings) == 50


@pytest.mark.parametrize("rate", [0.0, 49.9, 1000.1, float("nan"), float("inf"), -500.0])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ConfigError):
        ServiceOptions(rate_hz=rate)


def test_ending_a_child_that_is_dead_already_is_no_error():
    child = EvaluatingProcess()
    child._process = subprocess.Popen(
        [sys.executable, "-c", "pass"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    pid = child._process.pid
    wait_for(lambda: not alive(pid))
    child.stop()
    child.stop()

"""The service: a clock and a network round the monitor."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable
from importlib.metadata import version

import msgspec
import zenoh

from ..errors import SsmError
from ..model import Robot
from ..monitor import Decision, Monitor, weaknesses
from ..wire import Keys, encoding_of, seal
from ..wire import messages as m
from .child import EvaluatingProcess
from .duplicates import ForeignOutputs, refuse_duplicate
from .inputs import InputChannels, Surroundings
from .integrity import integrity_watch
from .latch_file import state_file
from .loop import Beat, FixedRateLoop
from .options import ServiceOptions
from .outputs import Outputs, stopped
from .publications import Publications
from .queries import JSON, Reply, StoredReplies
from .realtime import SpareTimeCollector
from .separations import SeparationOutput
from .statistics import RecentGreatest, Timings, resident_bytes

DRAIN_SHARE = 0.3
"""Share of a period that draining the inputs may take."""

MAX_WARNINGS = 50

TICK_WINDOW_NS = 1_000_000_000
"""For how long the longest tick counts, at least [ns]."""


class Service:
    """One robot's service on an open session.

    Args:
        robot: The robot.
        session: A session in mode ``router``.
        options: Name, profile, rate and duration.
        log: Where lines for people go.
        worker: The evaluating process; it is started again should it die.

    Raises:
        ConfigError: The name or the profile is not acceptable.
        DuplicateServiceError: Another service answers for the same robot.
    """

    def __init__(
        self,
        robot: Robot,
        session: zenoh.Session,
        options: ServiceOptions,
        log: Callable[[str], None],
        worker: EvaluatingProcess,
    ) -> None:
        self._options = options
        self._log = log
        self._worker = worker
        self._keys = Keys(options.name or robot.name)
        period_ns = round(1e9 / options.rate_hz)
        self._monitor = Monitor(robot, profile=options.profile, period_s=period_ns * 1e-9)
        self._loop = FixedRateLoop(period_ns)
        refuse_duplicate(session, self._keys)
        self.producer = uuid.uuid4().hex
        self.warnings: list[str] = []
        self._integrity = integrity_watch(
            self._monitor.profile.config.latch,
            state_file(options.state, self._keys.robot),
            self._log,
            self.warn,
        )
        self._publications = Publications(self.producer, time.monotonic_ns())
        shared = Surroundings(
            robot=robot,
            session=session,
            keys=self._keys,
            publications=self._publications,
            watch=self._integrity,
        )
        self._inputs = InputChannels(shared, int(DRAIN_SHARE * period_ns), self._monitor.range_reader)
        self._outputs = Outputs(
            session,
            self._keys,
            producer=self.producer,
            profile=self._monitor.profile.name,
            valid_for_ns=round(self._monitor.valid_for_s * 1e9),
            joint_names=list(robot.joint_names),
        )
        self._separations = SeparationOutput(
            session, self._keys, producer=self.producer, profile=self._monitor.profile.name
        )
        self._foreign = ForeignOutputs(session, self._keys)
        self._encoder = msgspec.json.Encoder()
        config = self._encoder.encode(self._configuration())
        self._config = Reply(config, JSON, seal(self._keys.output("config"), "", 0, config))
        self._tick_times, self._lateness = Timings(), Timings()
        self._tick_lengths = RecentGreatest(TICK_WINDOW_NS)
        self._ticks = self._skipped = self._overruns = self._held_up_ns = 0
        for weakness in weaknesses(robot, self._monitor.profile.name, period_s=self._monitor.period_s):
            self.warn(str(weakness))
        self._collector = SpareTimeCollector()
        self._started_ns = time.monotonic_ns()
        self._stopping = False
        # One tick that knows nothing, so that a query has a true answer from the start.
        self._tick(Beat(self._started_ns, self._started_ns, 0, 0))
        self._separations.work(self._outputs.last, self._started_ns)
        self._replies = self._stored_replies(session)
        self._token = session.liveliness().declare_token(self._keys.alive)

    def run(self) -> None:
        """Run until ``stop`` is called or the time is over; a last ``stop`` is published in every case."""
        end = None if self._options.seconds is None else time.monotonic() + self._options.seconds
        try:
            self._loop.run(
                self._tick,
                self._idle,
                lambda: not self._stopping and (end is None or time.monotonic() < end),
            )
        finally:
            self._outputs.publish_stop("shutdown")
            self._token.undeclare()  # type: ignore[no-untyped-call]
            self._integrity.close()

    @property
    def stopping(self) -> bool:
        """Whether the loop was asked to end."""
        return self._stopping

    def answer_for(self, duration_ns: int) -> None:
        """Answer queries for some time [ns] before the loop runs; everything is still a stop."""
        self._replies.serve(time.monotonic_ns() + duration_ns)
        time.sleep(duration_ns * 1e-9)

    def stop(self) -> None:
        """Ask the loop to end; safe to call from a signal handler."""
        self._stopping = True

    def warn(self, text: str) -> None:
        """Say something, once, to people now, and to everyone who asks for ``health`` later."""
        if text not in self.warnings and len(self.warnings) < MAX_WARNINGS:
            self.warnings.append(text)
            self._log(text)

    @property
    def summary(self) -> str:
        """One line on how the loop did."""
        late, tick = self._lateness.summary(), self._tick_times.summary()
        return (
            f"{self._ticks} ticks, {self._overruns} overruns, {self._skipped} skipped; "
            f"tick p50 {tick.get('p50', 0):.0f} µs, p99 {tick.get('p99', 0):.0f} µs; "
            f"lateness p50 {late.get('p50', 0):.1f} µs, p99 {late.get('p99', 0):.0f} µs (last ticks)"
        )

    def _tick(self, beat: Beat) -> None:
        if beat.skipped:
            self._overruns += 1
            self._skipped += beat.skipped
        heard_before = self._foreign.ever_heard
        duplicate = self._foreign.heard(beat.now_ns)
        overrun_ns = max(beat.overrun_ns, self._held_up_ns)
        inputs = self._inputs.read(
            beat.now_ns,
            overrun_s=overrun_ns * 1e-9,
            duplicate=duplicate,
            tick_s=(self._tick_lengths.at(beat.now_ns) or 0) * 1e-9,
        )
        try:
            decision = self._monitor.step(inputs)
        except SsmError as error:
            # Whatever the monitor cannot decide is a stop; the inputs were checked, so this is ours to mend.
            decision = self._internal_stop(error)
        decision = self._if_still_new(decision, beat)
        self._publications.add(decision.tick, time.monotonic_ns())
        self._outputs.publish(decision)
        published_ns = time.monotonic_ns()
        self._tick_lengths.add(published_ns - beat.now_ns, published_ns)
        self._ticks += 1
        if duplicate and not heard_before:
            self.warn(f"another service publishes as '{self._keys.robot}': stop until one of the two ends")
        self._lateness.add(beat.now_ns - beat.deadline_ns)
        self._tick_times.add(time.monotonic_ns() - beat.now_ns)

    def _if_still_new(self, decision: Decision, beat: Beat) -> Decision:
        """Return the decision, or a stop where this process stood still while it was being made."""
        took_ns = time.monotonic_ns() - beat.now_ns
        late = took_ns > self._outputs.valid_for_ns
        self._held_up_ns = took_ns if late else 0
        return stopped(decision, "overrun", tick=decision.tick) if late else decision

    def _idle(self, until_ns: int) -> None:
        self._separations.work(self._outputs.last, time.monotonic_ns())
        self._replies.serve(until_ns)
        if self._ticks % round(self._options.rate_hz) == 0:
            self._look_after_worker()
        self._collector.work(until_ns)

    def _look_after_worker(self) -> None:
        try:
            if self._worker.restart_if_dead():
                self.warn("the evaluating process died and was started again")
        except OSError as error:
            self.warn(f"the evaluating process died and could not be started: {error}")

    def _internal_stop(self, error: SsmError) -> Decision:
        self.warn(f"the monitor failed and the zone is stop: {error}")
        if self._outputs.last is None:
            raise error
        return stopped(self._outputs.last, "internal", tick=self._outputs.last.tick + 1)

    def _stored_replies(self, session: zenoh.Session) -> StoredReplies:
        return StoredReplies(
            session,
            self._keys,
            {
                "zone": lambda: self._outputs.zone_reply,
                "command": lambda: self._outputs.command_reply,
                "config": lambda: self._config,
                "separation": lambda: self._separations.reply,
                "health": lambda: self._sealed("health", self._health()),
                "reset": lambda: self._sealed("reset", self._reset()),
            },
            by_name=frozenset({"reset"}),
        )

    def _sealed(self, name: str, message: m.Health | m.ResetReply) -> Reply:
        payload = self._encoder.encode(message)
        attachment = seal(self._keys.output(name), message.producer, message.seq, payload)
        return Reply(payload, encoding_of(type(message)), attachment)

    def _reset(self) -> m.ResetReply:
        return m.ResetReply(
            producer=self.producer,
            seq=self._ticks,
            stamp_ns=time.time_ns(),
            robot=self._keys.robot,
            cleared=self._integrity.reset(),
        )

    def _configuration(self) -> dict[str, object]:
        robot = self._monitor.robot
        return {
            "robot": self._keys.robot,
            "profile": self._monitor.profile.name,
            "rate_hz": self._options.rate_hz,
            "valid_for_ns": round(self._monitor.valid_for_s * 1e9),
            "joint_names": list(robot.joint_names),
            "sensor_count": robot.sensor_count,
            "robot_file": robot.config.to_builtins(),
        }

    def _health(self) -> m.Health:
        now_ns = time.monotonic_ns()
        sources = self._inputs.sources
        return m.Health(
            producer=self.producer,
            seq=self._ticks,
            stamp_ns=time.time_ns(),
            robot=self._keys.robot,
            version=version("ssm-service"),
            uptime_s=(now_ns - self._started_ns) * 1e-9,
            rate_hz=self._options.rate_hz,
            ticks=self._ticks,
            skipped=self._skipped,
            overruns=self._overruns,
            tick_us=self._tick_times.summary(),
            lateness_us=self._lateness.summary(),
            accepted={name: source.accepted for name, source in sources.items()},
            rejected={name: dict(counts) for name, counts in self._inputs.rejections.counts.items()},
            last_rejection=self._inputs.rejections.last,
            lost={name: source.gate.lost for name, source in sources.items()},
            age_s={name: source.received(now_ns).age_s for name, source in sources.items()},
            queries=dict(self._replies.answered),
            integrity={name: source.integrity for name, source in sources.items()},
            integrity_errors=dict(self._integrity.counts),
            latched=self._integrity.latched,
            transport_s=self._inputs.echoes.transport_s(now_ns),
            memory_bytes=resident_bytes(),
            warnings=self.warnings,
        )

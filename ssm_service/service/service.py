"""The service: a clock and a network round the monitor."""

from __future__ import annotations

import signal
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import version
from types import FrameType

import msgspec
import numpy as np
import zenoh

from ..errors import DuplicateServiceError, SsmError
from ..model import Robot
from ..monitor import Decision, Monitor
from ..safety import Zone
from ..wire import Keys, command_message, encoding_of, zone_message
from ..wire import messages as m
from ..wire.session import DEFAULT_ENDPOINT, open_session, zenoh_config
from .child import EvaluatingProcess
from .inputs import InputChannels
from .loop import Beat, FixedRateLoop
from .options import ServiceOptions, WorkerOptions
from .queries import JSON, StoredReplies
from .realtime import apply_realtime
from .statistics import Timings

DRAIN_SHARE = 0.3
"""Share of a period that draining the inputs may take."""

DUPLICATE_HOLD_NS = 500_000_000
"""How long [ns] after a foreign message on our own keys the reason ``duplicate:service`` stays."""


class Service:
    """One robot's service on an open session. Use as ``with Service(...) as service: service.run()``.

    Args:
        robot: The robot.
        session: A session in mode ``router``.
        options: Name, profile and rate.
        log: Where lines for people go.
        worker: The evaluating process; it is started again should it die.
    """

    def __init__(
        self,
        robot: Robot,
        session: zenoh.Session,
        options: ServiceOptions,
        log: Callable[[str], None],
        worker: EvaluatingProcess,
    ) -> None:
        self._worker = worker
        self._options = options
        self._log = log
        self._name = options.name or robot.name
        self._keys = Keys(self._name)
        self._joint_names = list(robot.joint_names)
        period_ns = round(1e9 / options.rate_hz)
        self._monitor = Monitor(robot, profile=options.profile, period_s=period_ns * 1e-9)
        self._valid_for_ns = round(self._monitor.valid_for_s * 1e9)
        self._loop = FixedRateLoop(period_ns)
        self._refuse_duplicate(session)
        self.producer = uuid.uuid4().hex
        self._inputs = InputChannels(robot, session, self._keys, int(DRAIN_SHARE * period_ns))
        self._publishers = {
            name: session.declare_publisher(
                self._keys.output(name),
                encoding=encoding_of(kind),
                express=True,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for name, kind in (("zone", m.Zone), ("command", m.VelocityCommand))
        }
        self._foreign = session.declare_subscriber(
            self._keys.output("zone"), zenoh.handlers.RingChannel(1), allowed_origin=zenoh.Locality.REMOTE
        )
        self._foreign_ns: int | None = None
        self._encoder = msgspec.json.Encoder()
        self._latest = {"zone": b"", "command": b""}
        self._config = self._encoder.encode(
            {
                "robot": self._name,
                "profile": self._monitor.profile.name,
                "rate_hz": options.rate_hz,
                "valid_for_ns": self._valid_for_ns,
                "joint_names": self._joint_names,
                "sensor_count": robot.sensor_count,
                "robot_file": robot.config.to_builtins(),
            }
        )
        self._tick_times, self._lateness = Timings(), Timings()
        self._ticks = self._skipped = self._overruns = 0
        self.warnings: list[str] = []
        self._started_ns = time.monotonic_ns()
        self._overrun_ns = 0
        self._stopping = False
        self._decision: Decision | None = None
        self._publish_first_stop()
        self._replies = StoredReplies(
            session,
            self._keys,
            {
                "zone": lambda: (self._latest["zone"], encoding_of(m.Zone)),
                "command": lambda: (self._latest["command"], encoding_of(m.VelocityCommand)),
                "config": lambda: (self._config, JSON),
                "health": lambda: (self._health(), encoding_of(m.Health)),
            },
        )
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
            self._publish_last_stop()
            self._token.undeclare()  # type: ignore[no-untyped-call]

    def stop(self) -> None:
        """Ask the loop to end; safe to call from a signal handler."""
        self._stopping = True

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
        inputs = self._inputs.read(
            beat.now_ns, overrun_s=beat.overrun_ns * 1e-9, duplicate=self._duplicate(beat.now_ns)
        )
        try:
            decision = self._monitor.step(inputs)
        except SsmError as error:
            # Whatever the monitor cannot decide is a stop; the inputs were checked, so this is ours to mend.
            decision = self._internal_stop(error)
        self._decision = decision
        self._publish(decision)
        self._ticks += 1
        self._lateness.add(beat.now_ns - beat.deadline_ns)
        self._tick_times.add(time.monotonic_ns() - beat.now_ns)

    def _idle(self, until_ns: int) -> None:
        self._replies.serve(until_ns)
        if self._ticks % round(self._options.rate_hz) == 0 and self._worker.restart_if_dead():
            self.warnings.append("the evaluating process died and was started again")
            self._log(self.warnings[-1])

    def _publish(self, decision: Decision) -> None:
        stamp_ns = time.time_ns()
        zone = zone_message(
            decision,
            producer=self.producer,
            stamp_ns=stamp_ns,
            valid_for_ns=self._valid_for_ns,
            robot=self._name,
            profile=self._monitor.profile.name,
            name=self._joint_names,
        )
        command = command_message(
            decision,
            producer=self.producer,
            stamp_ns=stamp_ns,
            valid_for_ns=self._valid_for_ns,
            robot=self._name,
            name=self._joint_names,
        )
        self._latest = {"zone": self._encoder.encode(zone), "command": self._encoder.encode(command)}
        self._publishers["zone"].put(self._latest["zone"])
        self._publishers["command"].put(self._latest["command"])

    def _publish_first_stop(self) -> None:
        """Decide one tick that knows nothing, so that a query has a true answer from the start."""
        self._tick(Beat(time.monotonic_ns(), time.monotonic_ns(), 0, 0))

    def _publish_last_stop(self) -> None:
        if self._decision is not None:
            self._publish(_stopped(self._decision, "shutdown"))

    def _internal_stop(self, error: SsmError) -> Decision:
        if len(self.warnings) < 20:
            self.warnings.append(f"the monitor failed and the zone is stop: {error}")
            self._log(self.warnings[-1])
        if self._decision is None:
            raise error
        return _stopped(self._decision, "internal")

    def _duplicate(self, now_ns: int) -> bool:
        if self._foreign.handler.try_recv() is not None:
            if self._foreign_ns is None:
                text = f"another service publishes as '{self._name}': both stop until one of them ends"
                self.warnings.append(text)
                self._log(text)
            self._foreign_ns = now_ns
        return self._foreign_ns is not None and now_ns - self._foreign_ns <= DUPLICATE_HOLD_NS

    def _refuse_duplicate(self, session: zenoh.Session) -> None:
        key = self._keys.output("zone")
        for reply in session.get(key, timeout=1.0):
            if reply.ok is not None:
                raise DuplicateServiceError(
                    f"a service for '{self._name}' already answers on {key}; give this one another --name"
                )

    def _health(self) -> bytes:
        now_ns = time.monotonic_ns()
        sources = self._inputs.sources
        return self._encoder.encode(
            m.Health(
                producer=self.producer,
                seq=self._ticks,
                stamp_ns=time.time_ns(),
                robot=self._name,
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
                warnings=self.warnings,
            )
        )


def _stopped(decision: Decision, reason: str) -> Decision:
    """Return the next decision after ``decision``: a protective stop."""
    return replace(
        decision,
        tick=decision.tick + 1,
        zone=Zone.STOP,
        momentary_zone=Zone.STOP,
        speed_limit=np.zeros_like(decision.speed_limit),
        speed_scaling=0.0,
        velocity=np.zeros_like(decision.velocity),
        reasons=(reason,),
    )


def run_service(options: ServiceOptions, log: Callable[[str], None]) -> None:
    """Run one service until SIGINT, SIGTERM or the end of its time.

    Raises:
        ConfigError: The robot file, the profile or an endpoint is wrong.
        ServiceError: The network could not be opened.
        DuplicateServiceError: Another service answers for the same robot.
    """
    robot = Robot.load(options.robot)
    worker = EvaluatingProcess()
    try:
        listen = list(options.listen)
        if not (listen or options.connect or options.zenoh_config):
            listen = [DEFAULT_ENDPOINT]
        config = zenoh_config(
            "router",
            listen=[*listen, worker.endpoint],
            connect=options.connect,
            file=options.zenoh_config,
        )
        with open_session(config) as session:
            service = Service(robot, session, options, log, worker)
            _on_signals(service)
            worker.start(
                WorkerOptions(
                    robot_file=robot.config.path,
                    profile=options.profile or robot.config.file.default_profile,
                    name=options.name or robot.name,
                    endpoint=worker.endpoint,
                )
            )
            _announce(service, robot, options, listen, log)
            service.run()
            log(f"ended: {service.summary}")
    finally:
        worker.stop()


def _on_signals(service: Service) -> None:
    def stop(_number: int, _frame: FrameType | None) -> None:
        service.stop()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)


def _announce(
    service: Service, robot: Robot, options: ServiceOptions, listen: Sequence[str], log: Callable[[str], None]
) -> None:
    done, refused = apply_realtime()
    where = [f"listening on {', '.join(listen)}"] if listen else []
    where += [f"connected to {', '.join(options.connect)}"] if options.connect else []
    place = "; ".join(where) or "endpoints as in the file"
    log(f"{options.name or robot.name}: {options.rate_hz:g} Hz, {place}")
    log(f"in force: {', '.join(done)}")
    if refused:
        service.warnings.append(f"not permitted: {'; '.join(refused)}")
        log(service.warnings[-1])
    log("ready")
    sys.stderr.flush()

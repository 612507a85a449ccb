"""``ssm run``: session, evaluating process and signals round one service."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

from ..model import Robot
from ..wire.session import DEFAULT_ENDPOINT, close_session, open_session, zenoh_config
from .child import EvaluatingProcess
from .options import ServiceOptions, WorkerOptions
from .realtime import apply_realtime
from .service import Service

WAIT_NS = 10_000_000


def run_service(options: ServiceOptions, log: Callable[[str], None]) -> None:
    """Run one service until SIGINT, SIGTERM or the end of its time.

    Raises:
        ConfigError: The robot file, the profile, the name or an endpoint is wrong.
        ServiceError: The network could not be opened, or the evaluating process not started.
        DuplicateServiceError: Another service answers for the same robot.
    """
    robot = Robot.load(options.robot)
    listen = list(options.listen)
    if not (listen or options.connect or options.zenoh_config):
        listen = [DEFAULT_ENDPOINT]
    worker = EvaluatingProcess()
    try:
        config = zenoh_config(
            "router", listen=[*listen, worker.endpoint], connect=options.connect, file=options.zenoh_config
        )
        session = open_session(config)
        try:
            service = Service(robot, session, options, log, worker)
            _stop_on_signals(service)
            worker.start(
                WorkerOptions(
                    robot_file=robot.config.path,
                    profile=options.profile or robot.config.file.default_profile,
                    name=options.name or robot.name,
                    endpoint=worker.endpoint,
                )
            )
            _wait_for(worker, service)
            where = [f"listening on {', '.join(listen)}"] if listen else []
            where += [f"connected to {', '.join(options.connect)}"] if options.connect else []
            place = "; ".join(where) or f"endpoints as in {options.zenoh_config}"
            log(f"{options.name or robot.name}: {options.rate_hz:g} Hz, {place}")
            _apply_realtime(service, log)
            log("ready")
            service.run()
            log(f"ended: {service.summary}")
        finally:
            close_session(session)
    finally:
        worker.stop()


def _wait_for(worker: EvaluatingProcess, service: Service) -> None:
    """Wait for the evaluating process; meanwhile queries are answered, with the stop that holds."""
    while not (worker.ready() or service.stopping):
        service.answer_for(WAIT_NS)


def _stop_on_signals(service: Service) -> None:
    def stop(_number: int, _frame: FrameType | None) -> None:
        service.stop()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)


def _apply_realtime(service: Service, log: Callable[[str], None]) -> None:
    done, refused = apply_realtime()
    log(f"in force: {', '.join(done)}")
    if refused:
        service.warn(f"not permitted: {'; '.join(refused)}")

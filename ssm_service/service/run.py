"""``ssm run``: session, evaluating process and signals round one service."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

import zenoh

from ..errors import ConfigError
from ..model import Robot
from ..wire.exposure import exposures, unchecked_rights
from ..wire.session import DEFAULT_ENDPOINT, close_session, open_session, zenoh_config
from .child import EvaluatingProcess
from .options import ServiceOptions, WorkerOptions
from .realtime import apply_realtime, few_arenas
from .service import Service

WAIT_NS = 10_000_000


def run_service(options: ServiceOptions, log: Callable[[str], None]) -> None:
    """Run one service until SIGINT, SIGTERM or the end of its time.

    Raises:
        ConfigError: The robot file, the profile, the name or an endpoint is wrong, or an endpoint beyond this
            machine is not under mutual TLS and ``insecure`` is not set.
        ServiceError: The network could not be opened, or the evaluating process not started.
        DuplicateServiceError: Another service answers for the same robot.
    """
    few_arenas()
    robot = Robot.load(options.robot)
    listen = list(options.listen)
    if not (listen or options.connect or options.zenoh_config):
        listen = [DEFAULT_ENDPOINT]
    worker = EvaluatingProcess()
    try:
        config = zenoh_config(
            "router", listen=[*listen, worker.endpoint], connect=options.connect, file=options.zenoh_config
        )
        weak = _weak_endpoints(config, options)
        session = open_session(config)
        try:
            service = Service(robot, session, options, log, worker)
            for text in weak:
                service.warn(text)
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


def _weak_endpoints(config: zenoh.Config, options: ServiceOptions) -> list[str]:
    """Return what is to be said of endpoints at which nobody has to prove who they are.

    Raises:
        ConfigError: There are some, and the options do not say ``insecure``.
    """
    found = exposures(config)
    if found and not options.insecure:
        first = found[0]
        of_options = {"listen/endpoints": options.listen, "connect/endpoints": options.connect}
        option = "--listen" if first.key == "listen/endpoints" else "--connect"
        by_option = first.endpoint in of_options[first.key]
        raise ConfigError(
            option if by_option else options.zenoh_config or option,
            "" if by_option else first.key,
            f"{first.endpoint}, {first.why}",
            "this machine only (127.0.0.1, ::1, localhost, a unix socket); or mutual TLS, which "
            "`ssm keys init` sets up; or --insecure, and then whoever reaches the network can send inputs",
        )
    texts = [f"insecure: {one}: whoever reaches it can send inputs and read all" for one in found]
    if not found and unchecked_rights(config):
        texts.append("access_control does not deny by default: every certificate may do everything")
    return texts


def _wait_for(worker: EvaluatingProcess, service: Service) -> None:
    """Wait for the evaluating process; meanwhile queries are answered, with the stop that holds."""
    while not (worker.ready() or service.stopping):
        service.answer_for(WAIT_NS)


def _stop_on_signals(service: Service) -> None:
    def stop(_number: int, _frame: FrameType | None) -> None:
        """Ask the loop to end."""
        service.stop()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)


def _apply_realtime(service: Service, log: Callable[[str], None]) -> None:
    done, refused = apply_realtime()
    log(f"in force: {', '.join(done)}")
    if refused:
        service.warn(f"not permitted: {'; '.join(refused)}")

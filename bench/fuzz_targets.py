"""What is fuzzed: every door that bytes come in by, and what must hold behind it.

A target takes any bytes. It returns whether they were accepted, and raises ``Broken`` where what must hold
does not; an ``SsmError`` is a refusal, and any other exception has got past the door.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import tempfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ssm_service.cli.check_zenoh import check_zenoh
from ssm_service.client.accept import check
from ssm_service.client.chunks import outputs
from ssm_service.client.watchdog import Watchdog
from ssm_service.config import load_robot_config, robot_names
from ssm_service.config.load import robots_directory
from ssm_service.errors import SsmError
from ssm_service.model import Robot
from ssm_service.monitor import Inputs, Monitor, Received
from ssm_service.safety import Zone
from ssm_service.service.latch_file import load_latch
from ssm_service.simulation import load_scenario
from ssm_service.simulation.load import list_scenarios, scenarios_directory
from ssm_service.wire import VALUES, Decoder, SealedDecoder, opened, seal
from ssm_service.wire import messages as m

from .fuzz_mutations import Mutator, mutate_bytes, mutate_json, mutate_toml
from .fuzz_seeds import ATTACHED, DOCKER, EVALUATE, LATCH, answers, samples, zones

KEY = "ssm/ur3/in/joints"


class Broken(AssertionError):
    """Something that must hold behind a door does not."""


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """One door.

    Attributes:
        name: Its name.
        run: Takes bytes; see the module.
        seeds: Valid inputs to start from.
        mutate: Changes an input with its structure in mind.
        slow_s: How long one input may take [s].
    """

    name: str
    run: Callable[[bytes], bool]
    seeds: Callable[[], list[bytes]]
    mutate: Mutator
    slow_s: float = 2.0


def require(holds: bool, text: str) -> None:
    """Raise ``Broken`` with a text where something does not hold."""
    if not holds:
        raise Broken(text)


def finite(value: Any, *, endless: bool = False) -> bool:
    """Tell whether every number inside a value is finite; where ``endless``, +∞ may stand for 'no echo'."""
    if isinstance(value, np.ndarray):
        return bool(np.all(np.isfinite(value) | (np.isposinf(value) & endless)))
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, msgspec.Struct):
        return all(finite(getattr(value, name), endless=endless) for name in value.__struct_fields__)
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        return all(finite(getattr(value, name), endless=endless) for name in names)
    if isinstance(value, dict):
        return all(finite(inner, endless=endless) for inner in value.values())
    if isinstance(value, list | tuple):
        return all(finite(inner, endless=endless) for inner in value)
    return True


@cache
def robot() -> Robot:
    """Return the robot that everything is fuzzed for."""
    return Robot.load("ur3")


@cache
def monitor() -> Monitor:
    """Return a monitor in a state that is not reset: any state is a good one to break."""
    return Monitor(robot())


def decoding(kind: type[m.Message]) -> Callable[[bytes], bool]:
    """Return a target: bytes to one message, and the same again from what that encodes to."""
    plain, explaining = Decoder(kind), Decoder(kind, explain=True)

    def run(data: bytes) -> bool:
        try:
            message = plain.decode(data)
        except SsmError as error:
            _clear(error)
            with contextlib.suppress(SsmError):
                explaining.decode(data)
                raise Broken("refused without an explanation, accepted with one") from None
            return False
        require(finite(msgspec.to_builtins(message)), f"not finite: {message}")
        require(explaining.decode(data) == message, "another message with an explanation")
        require(plain.decode(msgspec.json.encode(message)) == message, "another message when sent again")
        return True

    return run


def _clear(error: SsmError) -> None:
    require(0 < len(str(error)) < 1000, f"a refusal of {len(str(error))} characters")


def taking(name: str) -> Callable[[bytes], bool]:
    """Return a target: an input message from bytes to a tick of the monitor, as the service does it.

    What is refused makes its source invalid, which is a stop; what is accepted leaves every number finite.
    """
    decoder: SealedDecoder[Any] = SealedDecoder(m.INPUTS[name], f"ssm/ur3/in/{name}")
    good = {each: json.loads(samples()[f"message/{kind.__name__}"][0]) for each, kind in m.INPUTS.items()}
    values = {
        each: VALUES[each](robot(), msgspec.convert(good[each], kind))  # type: ignore[operator]
        for each, kind in m.INPUTS.items()
    }

    def run(data: bytes) -> bool:
        received = {each: Received(value=value, age_s=0.001) for each, value in values.items()}
        try:
            message = decoder.decode(data, None, required=False).message
            received[name] = Received(value=VALUES[name](robot(), message), age_s=0.001)  # type: ignore[operator]
            accepted = True
        except SsmError as error:
            _clear(error)
            received[name] = Received(value=values[name], age_s=0.001, invalid=True)
            accepted = False
        require(finite(received[name].value, endless=name == "ranges"), "a value that is not finite")
        decision = monitor().step(Inputs(**received))
        require(finite(decision), f"a decision that is not finite: {decision}")
        require(bool((np.abs(decision.velocity) <= robot().velocity_limit + 1e-9).all()), "too fast")
        if not accepted and name != "target":
            require(decision.zone is Zone.STOP, f"{decision.zone.word} though {name} was refused")
        if decision.zone is Zone.STOP:
            require(not decision.velocity.any(), "a velocity in a stop")
        return accepted

    return run


def attached(data: bytes) -> bool:
    """Take the first line as an attachment, the rest as payload: only the right checksum opens it."""
    attachment, _, payload = data.partition(b"\n")
    try:
        heard = opened(KEY, "driver", 7, payload, attachment, required=True)
    except SsmError as error:
        _clear(error)
        return False
    after = "" if heard is None else str(heard)
    right = zlib.crc32(f"{KEY}\ndriver\n7\n{after}\n".encode() + payload)
    require(int(attachment[6:14], 16) == right, "opened with another checksum")
    require(
        opened(KEY, "driver", 7, payload, seal(KEY, "driver", 7, payload, heard), required=True) == heard,
        "seal",
    )
    return True


def consuming(data: bytes) -> bool:
    """Take a service's zone, as a consumer does that has no proof of any age: it stays at stop."""
    watchdog = Watchdog("ur3")
    try:
        zone = Decoder(m.Zone).decode(data)
        check(zone, "ur3")
        watchdog.take(zone, 0, 1)
        accepted = True
    except SsmError as error:
        _clear(error)
        accepted = False
    state = watchdog.state(2)
    require(state.zone is Zone.STOP and not any(state.velocity), "believed without a proof")
    return accepted


def answered(data: bytes) -> bool:
    """Take a service's answer to ``evaluate``, as the client does."""
    try:
        found = outputs(data, 1)
    except SsmError as error:
        _clear(error)
        return False
    require(finite(msgspec.to_builtins(found)), "an answer that is not finite")
    return True


def written(suffix: str, load: Callable[[Path], Any]) -> Callable[[bytes], bool]:
    """Return a target: bytes as a file that is loaded."""
    folder = tempfile.TemporaryDirectory(prefix="fuzz-")

    def run(data: bytes) -> bool:
        path = Path(folder.name) / f"input{suffix}"
        path.write_bytes(data)
        try:
            made = load(path)
        except SsmError as error:
            _clear(error)
            return False
        require(finite(made), f"not finite: {made}")
        return True

    return run


def latched(path: Path) -> None:
    """Load a latch: whatever is no state of ours is latched."""
    latch = load_latch(path, 3600.0)
    try:
        state = json.loads(path.read_bytes())
        ours = isinstance(state, dict) and state.keys() <= {"latched", "fault", "where", "at_ns"}
    except (ValueError, RecursionError):
        ours = False
    require(ours or latch.latched is not None, "a file that cannot be read is no latch")


@cache
def _lines() -> tuple[list[bytes], Iterator[tuple[int, Any]]]:
    """Return where to put bytes for ``ssm evaluate``, and the answers of its own function."""
    from io import BytesIO

    from ssm_service.cli.evaluate import LINE_LIMIT, _answered
    from ssm_service.cli.lines import Line, read_lines

    waiting: list[bytes] = []

    def lines() -> Iterator[Line]:
        while True:
            yield from read_lines(BytesIO(waiting.pop()), LINE_LIMIT)
            yield Line(0, b"{}", False)  # refused: it tells where one input ends

    return waiting, _answered("ur3", None, lines())


def evaluated(data: bytes) -> bool:
    """Take bytes as the lines of ``ssm evaluate``: each is answered, in finite numbers or with an error."""
    waiting, answers_ = _lines()
    waiting.append(data)
    accepted = False
    for number, answer in answers_:
        if number == 0:
            return accepted
        _output(answer)
        accepted |= isinstance(answer, m.EvaluateOutput)
    raise Broken("ssm evaluate has ended")


def _output(answer: m.EvaluateOutput | m.EvaluateError) -> None:
    require(finite(msgspec.to_builtins(answer)), "not finite")
    if isinstance(answer, m.EvaluateError):
        require(0 < len(answer.error) < 1000, f"an error of {len(answer.error)} characters")
        return
    for pair in answer.pairs:
        require(abs(math.hypot(*pair.normal) - 1.0) < 1e-6, f"a normal of {pair.normal}")
    if answer.zone == "stop":
        require(not any(answer.speed_limit) and answer.speed_scaling == 0.0, "a speed in a stop")
        require(answer.command is None or not any(answer.command.velocity), "a velocity in a stop")


class _Query:
    """A query as the evaluating process sees it, without a network."""

    def __init__(self, data: bytes) -> None:
        self.payload = self
        self._data = data
        self.replies: list[bytes] = []
        self.errors: list[bytes] = []

    def to_bytes(self) -> bytes:
        return self._data

    def reply(self, _key: str, payload: bytes, **_options: Any) -> None:
        self.replies.append(payload)

    def reply_err(self, payload: bytes, **_options: Any) -> None:
        self.errors.append(payload)


PREPARING_S = 100.0
"""The longest that inner loops may take to compile [s]."""


class _Session:
    """A session on which nothing ever comes."""

    def declare_subscriber(self, *_arguments: Any) -> None:
        return None

    declare_queryable = declare_subscriber


@cache
def _worker() -> Any:
    from ssm_service.service import worker
    from ssm_service.service.options import WorkerOptions

    worker.FILL_AFTER_S = 1e6  # a table that would take this process's time
    config = load_robot_config("ur3")
    options = WorkerOptions(
        robot_file=config.path, profile=config.file.default_profile, name="ur3", endpoint="none"
    )
    made = worker.EvaluatingWorker(options, _Session())  # type: ignore[arg-type]
    made.wait_prepared(PREPARING_S)
    return made


def asked(name: str) -> Callable[[bytes], bool]:
    """Return a target: bytes as the payload of a query to the evaluating process."""

    def run(data: bytes) -> bool:
        query = _Query(data)
        _worker()._answer(name, query)
        require(len(query.replies) + len(query.errors) == 1, "not one answer")
        for error in query.errors:
            require(b"internal error" not in error, error.decode())
        for reply in query.replies:
            require(finite(msgspec.json.decode(reply)), "a reply that is not finite")
        if name == "evaluate" and query.replies:
            return any(
                isinstance(answer, m.EvaluateOutput)
                for answer in outputs(query.replies[0], len(msgspec.json.decode(query.replies[0])))
            )
        return bool(query.replies)

    return run


@cache
def targets() -> dict[str, Target]:
    """Return every target by name."""
    found: dict[str, Target] = {}

    def add(
        name: str, run: Callable[[bytes], bool], seeds: Callable[[], list[bytes]], mutate: Mutator
    ) -> None:
        found[name] = Target(name=name, run=run, seeds=seeds, mutate=mutate)

    for kind in m.ALL:
        name = f"message/{kind.__name__}"
        add(name, decoding(kind), lambda name=name: samples()[name], mutate_json)  # type: ignore[misc]
    for source, kind in m.INPUTS.items():
        name = f"message/{kind.__name__}"
        add(f"input/{source}", taking(source), lambda name=name: samples()[name], mutate_json)  # type: ignore[misc]
    add("attachment", attached, lambda: ATTACHED, mutate_bytes)
    add("consumer", consuming, zones, mutate_json)
    add("answer", answered, answers, mutate_json)
    robots, scenes = robots_directory(), scenarios_directory()
    add("robot", written(".toml", load_robot_config), lambda: _files(robots, robot_names()), mutate_toml)
    add(
        "scenario",
        written(".toml", lambda path: load_scenario(path, robot())),
        lambda: _files(scenes, list_scenarios()),
        mutate_toml,
    )
    add("zenoh", written(".json5", check_zenoh), lambda: DOCKER, mutate_toml)
    add("latch", written(".json", latched), lambda: LATCH, mutate_json)
    add("evaluate/lines", evaluated, lambda: EVALUATE, mutate_json)
    add("evaluate/query", asked("evaluate"), lambda: [b"[" + line + b"]" for line in EVALUATE], mutate_json)
    add("frames/query", asked("frames"), lambda: samples()["message/FramesRequest"], mutate_json)
    return found


def _files(folder: Path, names: list[str]) -> list[bytes]:
    return [(folder / f"{name}.toml").read_bytes() for name in names]

"""``ssm evaluate``: what would the service say? JSON lines in, JSON lines out."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from ..errors import ConfigError, InputError
from .lines import Line, opened, read_chunks, read_lines
from .options import (
    ConnectOption,
    NameOption,
    ProfileOption,
    RobotOption,
    TimeoutOption,
    ZenohConfigOption,
    checked_timeout,
    endpoints,
)
from .output import FAILED, log

if TYPE_CHECKING:
    from ..client import Client
    from ..wire import Decoder
    from ..wire.messages import EvaluateError, EvaluateInput, EvaluateOutput

LINE_LIMIT = 4 * 1024 * 1024
"""Greatest line [bytes]."""

CHUNK = 64
"""Most questions in one query to a running service."""


def evaluate(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="JSON lines; stdin if left out.", show_default=False),
    ] = None,
    robot: RobotOption = "ur3",
    profile: ProfileOption = None,
    remote: Annotated[
        bool, typer.Option("--remote", help="Ask a running service instead of answering here.")
    ] = False,
    name: NameOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 10.0,
) -> None:
    """Say what the service would say to each snapshot: JSON lines in, JSON lines out, in the same order.

    A line that cannot be evaluated yields an error on its line, the others
    are still answered, and the exit status is 1. Without --remote no network
    is used.
    """
    checked_timeout(timeout)
    if remote and profile is not None:
        raise ConfigError(
            "--profile", "", profile, "no --profile with --remote: the service's own is in force"
        )
    if not remote and (name or connect or zenoh_config):
        raise ConfigError("--name, --connect, --zenoh-config", "", "one of them", "--remote beside it")
    with opened(file) as stream:
        if stream.isatty():
            log("reading JSON lines from the terminal; Ctrl-D ends")
        if remote:
            from ..client import Client

            where = endpoints(connect, zenoh_config)
            asked = name or Path(robot).stem
            with Client(asked, connect=where, zenoh_config=zenoh_config, timeout_s=timeout) as client:
                failed = _print(_asked(client, read_chunks(stream, LINE_LIMIT, CHUNK)))
        else:
            failed = _print(_answered(robot, profile, read_lines(stream, LINE_LIMIT)))
    if failed:
        raise typer.Exit(FAILED)


def _print(answers: Iterator[tuple[int, EvaluateOutput | EvaluateError]]) -> bool:
    """Write each answer on its line; return whether one was an error."""
    from ..wire.messages import EvaluateError

    encoder = msgspec.json.Encoder()
    out, failed = sys.stdout.buffer, False
    for number, answer in answers:
        if isinstance(answer, EvaluateError):
            failed = True
            log(f"line {number}: {answer.error}")
        out.write(encoder.encode(answer) + b"\n")
        out.flush()
    return failed


def _answered(
    robot_name: str, profile: str | None, lines: Iterator[Line]
) -> Iterator[tuple[int, EvaluateOutput | EvaluateError]]:
    """Answer the lines here."""
    from ..model import Robot
    from ..monitor import Evaluator, zone_profile
    from ..wire import evaluate_message, question_from
    from ..wire.messages import EvaluateError

    robot = Robot.load(robot_name)
    evaluator = Evaluator(robot, zone_profile(robot, profile))
    decoder = _decoder()
    for line in lines:
        try:
            question = question_from(robot, _message(decoder, line))
            yield line.number, evaluate_message(evaluator.evaluate(question))
        except InputError as error:
            yield line.number, EvaluateError(error=str(error))


def _asked(
    client: Client, chunks: Iterator[list[Line]]
) -> Iterator[tuple[int, EvaluateOutput | EvaluateError]]:
    """Have a running service answer the lines; those that are no messages are answered here."""
    from ..wire.messages import EvaluateError

    decoder = _decoder()
    for lines in chunks:
        answers: dict[int, EvaluateOutput | EvaluateError] = {}
        questions: dict[int, EvaluateInput] = {}
        for line in lines:
            try:
                questions[line.number] = _message(decoder, line)
            except InputError as error:
                answers[line.number] = EvaluateError(error=str(error))
        if questions:
            answers.update(zip(questions, client.evaluate(list(questions.values())), strict=True))
        for line in lines:
            yield line.number, answers[line.number]


def _decoder() -> Decoder[EvaluateInput]:
    from ..wire import Decoder
    from ..wire.messages import EvaluateInput

    return Decoder(EvaluateInput, LINE_LIMIT, explain=True)


def _message(decoder: Decoder[EvaluateInput], line: Line) -> EvaluateInput:
    if line.too_long:
        raise InputError("too_large", "line", f"more than {LINE_LIMIT} bytes", f"at most {LINE_LIMIT} bytes")
    return decoder.decode(line.data)

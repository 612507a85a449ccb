"""The evaluating process: heavy queries are answered here, where they cannot slow the loop."""

from __future__ import annotations

import os
import queue
import signal
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from ..errors import InputError, SsmError
from ..model import Robot
from ..monitor import Evaluator, JointSample, joint_sample, zone_profile
from ..wire import Decoder, Keys, encoding_of, evaluate_message, frames_message, question_from
from ..wire import messages as m
from ..wire.convert import joints_value
from ..wire.session import open_session, zenoh_config
from .options import WorkerOptions

EVALUATE_LIMIT = 4 * 1024 * 1024
"""Greatest ``evaluate`` payload [bytes]."""

QUEUE_CAPACITY = 64


class EvaluatingWorker:
    """Answers ``evaluate`` and ``frames`` for one robot.

    Args:
        options: What the service says.
        session: A session connected to the service.
    """

    def __init__(self, options: WorkerOptions, session: zenoh.Session) -> None:
        self._robot = Robot.load(Path(options.robot_file))
        self._evaluator = Evaluator(self._robot, zone_profile(self._robot, options.profile))
        self._name = options.name
        keys = Keys(options.name)
        self._keys = {name: keys.output(name) for name in ("evaluate", "frames")}
        self._questions: Decoder[Any] = Decoder(list[msgspec.Raw], EVALUATE_LIMIT)
        self._question = Decoder(m.EvaluateInput, EVALUATE_LIMIT)
        self._frames_request = Decoder(m.FramesRequest)
        self._joint_state = Decoder(m.JointState)
        self._waiting: queue.Queue[tuple[str, zenoh.Query]] = queue.Queue(QUEUE_CAPACITY)
        channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(1)
        self._joints = session.declare_subscriber(keys.input("joints"), channel)
        self._present: tuple[float, JointSample] | None = None
        self._queryables = [
            session.declare_queryable(key, partial(self._enqueue, name)) for name, key in self._keys.items()
        ]

    def run(self) -> None:
        """Answer for ever."""
        while True:
            name, query = self._waiting.get()
            with query:
                self._answer(name, query)

    def _enqueue(self, name: str, query: zenoh.Query) -> None:
        try:
            self._waiting.put_nowait((name, query))
        except queue.Full:
            with query:
                query.reply_err(
                    b'{"error": "busy: too many queries are waiting"}', encoding="application/json"
                )

    def _answer(self, name: str, query: zenoh.Query) -> None:
        payload = b"" if query.payload is None else query.payload.to_bytes()
        try:
            if name == "evaluate":
                reply, encoding = self._evaluate(payload), encoding_of(m.EvaluateOutput)
            else:
                reply, encoding = self._frames(payload), encoding_of(m.FramesReply)
        except SsmError as error:
            text = msgspec.json.encode(m.EvaluateError(error=str(error)))
            query.reply_err(text, encoding=encoding_of(m.EvaluateError))
            return
        query.reply(self._keys[name], reply, encoding=encoding)

    def _evaluate(self, payload: bytes) -> bytes:
        answers: list[m.EvaluateOutput | m.EvaluateError] = []
        for raw in self._questions.decode(payload):
            try:
                question = question_from(self._robot, self._question.decode(bytes(raw)))
                answers.append(evaluate_message(self._evaluator.evaluate(question)))
            except InputError as error:
                answers.append(m.EvaluateError(error=str(error)))
        return msgspec.json.encode(answers)

    def _frames(self, payload: bytes) -> bytes:
        if payload:
            request = self._frames_request.decode(payload)
            sample = joint_sample(self._robot, request.position, None, request.name)
        else:
            sample = self._present_joints()
        return msgspec.json.encode(frames_message(self._robot, self._name, sample.position))

    def _present_joints(self) -> JointSample:
        received = self._joints.handler.try_recv()
        if received is not None:
            message = self._joint_state.decode(received.payload.to_bytes())
            self._present = time.monotonic(), joints_value(self._robot, message)
        timeout = self._robot.config.file.sources.joints.timeout_s
        if self._present is None or time.monotonic() - self._present[0] > timeout:
            raise InputError(
                "waiting", "frames", "no fresh joint state", "a payload with `position`, or a running driver"
            )
        return self._present[1]


def main() -> None:
    """Run until the service's end of the pipe closes, however the service ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    options = msgspec.json.decode(sys.stdin.readline(), type=WorkerOptions)
    with open_session(zenoh_config("client", connect=[options.endpoint])) as session:
        worker = EvaluatingWorker(options, session)
        threading.Thread(target=_end_with_the_service, daemon=True).start()
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        worker.run()


def _end_with_the_service() -> None:
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    main()

"""The evaluating process: heavy queries are answered here, where they cannot slow the loop."""

from __future__ import annotations

import os
import queue
import shutil
import signal
import sys
import threading
import time
import traceback
from collections import deque
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from ..errors import InputError, SsmError
from ..model import Robot
from ..monitor import Evaluator, JointSample, joint_sample, zone_profile
from ..wire import (
    Decoder,
    Keys,
    SealedDecoder,
    attachment_of,
    encoding_of,
    evaluate_message,
    frames_message,
    question_from,
    seal,
)
from ..wire import messages as m
from ..wire.convert import joints_value
from ..wire.session import open_session, zenoh_config
from .options import WorkerOptions
from .realtime import few_arenas

EVALUATE_LIMIT = 4 * 1024 * 1024
"""Greatest ``evaluate`` payload [bytes]."""

REPLY_LIMIT = 3_500_000
"""Greatest ``evaluate`` reply [bytes]; Zenoh drops what is longer than a session's ``max_message_size``."""

QUEUE_CAPACITY = 64

PATIENCE_S = 10.0
"""How long the start waits for the tables of the estimators; they take longer only when they are compiled."""

FILL_AFTER_S = 60.0
"""When the table of single echoes is begun: a service that ends before that has no use for it."""

ARRIVALS = 16
"""Joint messages that are kept for ``frames``: the newest that is valid is taken."""


class EvaluatingWorker:
    """Answers ``evaluate`` and ``frames`` for one robot.

    Args:
        options: What the service says.
        session: A session connected to the service.
    """

    def __init__(self, options: WorkerOptions, session: zenoh.Session) -> None:
        self._robot = Robot.load(Path(options.robot_file))
        self._evaluator = Evaluator(self._robot, zone_profile(self._robot, options.profile))
        self._prepared = threading.Event()
        threading.Thread(target=self._prepare, name="tables", daemon=True).start()
        self.wait_prepared(PATIENCE_S)
        self._name = options.name
        keys = Keys(options.name)
        self._keys = {name: keys.output(name) for name in ("evaluate", "frames")}
        self._questions: Decoder[Any] = Decoder(list[msgspec.Raw], EVALUATE_LIMIT)
        self._question = Decoder(m.EvaluateInput, EVALUATE_LIMIT, explain=True)
        self._frames_request = Decoder(m.FramesRequest, explain=True)
        self._joint_state = SealedDecoder(m.JointState, keys.input("joints"))
        self._sealed = self._robot.config.file.sources.joints.integrity == "crc"
        self._waiting: queue.Queue[tuple[str, zenoh.Query]] = queue.Queue(QUEUE_CAPACITY)
        # A callback, not a channel: the time of arrival counts, and a channel does not keep it.
        self._arrived: deque[tuple[float, zenoh.Sample]] = deque(maxlen=ARRIVALS)
        self._joints = session.declare_subscriber(
            keys.input("joints"), lambda sample: self._arrived.append((time.monotonic(), sample))
        )
        self._queryables = [
            session.declare_queryable(key, partial(self._enqueue, name)) for name, key in self._keys.items()
        ]

    def _prepare(self) -> None:
        self._evaluator.prepare()
        self._prepared.set()
        time.sleep(FILL_AFTER_S)
        # At the priority of the others: one that gave way while it held the interpreter would hold them up.
        self._evaluator.fill()

    def wait_prepared(self, timeout_s: float) -> bool:
        """Wait for the tables of the estimators; return whether they are there."""
        return self._prepared.wait(timeout_s)

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
                self._refuse(query, "busy: too many queries are waiting")

    def _answer(self, name: str, query: zenoh.Query) -> None:
        payload = b"" if query.payload is None else query.payload.to_bytes()
        try:
            if name == "evaluate":
                reply, encoding = self._evaluate(payload), encoding_of(m.EvaluateOutput)
            else:
                reply, encoding = self._frames(payload), encoding_of(m.FramesReply)
        except SsmError as error:
            self._refuse(query, str(error))
        except Exception as error:
            # One question that we cannot answer must not take the others' answers with it.
            traceback.print_exc()
            self._refuse(query, f"internal error: {type(error).__name__}")
        else:
            key = self._keys[name]
            query.reply(key, reply, encoding=encoding, attachment=seal(key, "", 0, reply))

    def _refuse(self, query: zenoh.Query, text: str) -> None:
        query.reply_err(
            msgspec.json.encode(m.EvaluateError(error=text)), encoding=encoding_of(m.EvaluateError)
        )

    def _evaluate(self, payload: bytes) -> bytes:
        answers: list[bytes] = []
        size = 0
        for raw in self._questions.decode(payload):
            answers.append(msgspec.json.encode(self._one(bytes(raw))))
            size += len(answers[-1]) + 1
            if size > REPLY_LIMIT:
                found = f"over {REPLY_LIMIT} bytes after {len(answers)} inputs"
                raise InputError("too_large", "reply", found, "fewer inputs in one query")
        return b"[" + b",".join(answers) + b"]"

    def _one(self, payload: bytes) -> m.EvaluateOutput | m.EvaluateError:
        try:
            question = question_from(self._robot, self._question.decode(payload))
            if question.ranges is not None and not self._prepared.is_set():
                allowed = "ask again: tables for `ranges` are being made, which takes longest the first time"
                raise InputError("preparing", "ranges", "a service that has just started", allowed)
            return evaluate_message(self._evaluator.evaluate(question))
        except InputError as error:
            return m.EvaluateError(error=str(error))

    def _frames(self, payload: bytes) -> bytes:
        if payload:
            request = self._frames_request.decode(payload)
            sample = joint_sample(self._robot, request.position, None, request.name)
        else:
            sample = self._present_joints()
        return msgspec.json.encode(frames_message(self._robot, self._name, sample.position))

    def _present_joints(self) -> JointSample:
        oldest = time.monotonic() - self._robot.config.file.sources.joints.timeout_s
        for arrived, sample in reversed(list(self._arrived)):
            if arrived < oldest:
                break
            try:
                opened = self._joint_state.decode(
                    sample.payload.to_bytes(), attachment_of(sample), required=self._sealed
                )
                return joints_value(self._robot, opened.message)
            except InputError:
                continue  # counted where it matters, by the service
        raise InputError(
            "waiting", "frames", "no fresh joint state", "a payload with `position`, or a running driver"
        )


def main() -> None:
    """Run until the service's end of the pipe closes, however the service ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    few_arenas()
    options = msgspec.json.decode(sys.stdin.readline(), type=WorkerOptions)
    with open_session(zenoh_config("client", connect=[options.endpoint])) as session:
        worker = EvaluatingWorker(options, session)
        threading.Thread(target=_end_with_the_service, args=(options.endpoint,), daemon=True).start()
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        worker.run()


def _end_with_the_service(endpoint: str) -> None:
    sys.stdin.read()
    # A service that was killed could not remove the folder of its socket.
    shutil.rmtree(Path(endpoint.partition("/")[2]).parent, ignore_errors=True)
    os._exit(0)


if __name__ == "__main__":
    main()

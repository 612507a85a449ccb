"""What programs use: queries, and the watched stream."""

from __future__ import annotations

import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import msgspec
import zenoh

from ..errors import DuplicateServiceError, InputError, NoServiceError, ServiceError, listed
from ..wire import Keys, SealedDecoder, opened, robot_of
from ..wire import messages as m
from ..wire.latch import Latch
from ..wire.session import DEFAULT_ENDPOINT
from .ask import Answer, ask
from .chunks import chunks, encoded, outputs
from .connection import Connection
from .followed import Followed
from .follower import Follower

M = TypeVar("M", bound=m.Message)

LARGEST_ANSWER = 16 * 1024 * 1024
"""Greatest answer that is read [bytes]."""

POLL_S = 0.001
"""Between two looks of ``stream`` at its channels [s]."""

REPEAT_S = 0.1
"""Between two yields of a stop that goes on [s]."""

STARTING = "a service takes a few seconds to start, and then prints 'ready'"


class Client:
    """A consumer of one robot's service.

    Nothing is dialled before the first question; ``close`` it or use it as a context manager.

    Args:
        robot: The robot's name on the network.
        connect: Endpoints to dial.
        zenoh_config: A Zenoh configuration file to use instead of the package's own values.
        timeout_s: How long a question may take [s].
        latch: Time [s] within which a second error of integrity latches the stop of every ``stream`` and
            ``follower`` until ``acknowledge``; no latch where left out.
        echo: Whether a ``stream`` or ``follower`` tells the service how long its messages are on their way.
            One that only shows what holds, and moves nothing, need not.

    Raises:
        ConfigError: The name, an endpoint or the file is not acceptable.
    """

    def __init__(
        self,
        robot: str = "ur3",
        *,
        connect: Sequence[str] = (DEFAULT_ENDPOINT,),
        zenoh_config: str | Path | None = None,
        timeout_s: float = 1.0,
        latch: float | None = None,
        echo: bool = True,
    ) -> None:
        self.keys = Keys(robot)
        self.connection = Connection(connect, zenoh_config)
        self._timeout_s = timeout_s
        self._echo = echo
        self._latch = None if latch is None else Latch(latch)
        # Also at the end of a program that forgot to: a process with an open session may never exit.
        self._finalizer = weakref.finalize(self, self.connection.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; a ``stream`` still running then only says stop."""
        self._finalizer()

    def zone(self) -> m.Zone:
        """Return the zone of the service's newest tick.

        Raises:
            NoServiceError: Nobody answered in time.
            DuplicateServiceError: Two services answered.
            ServiceError: The service answered with an error, or with something malformed.
        """
        return self._one("zone", m.Zone)

    def command(self) -> m.VelocityCommand:
        """Return the command of the service's newest tick. It raises as ``zone`` does."""
        return self._one("command", m.VelocityCommand)

    def health(self) -> m.Health:
        """Return counters, ages and timings. It raises as ``zone`` does."""
        return self._one("health", m.Health)

    def reset(self) -> m.ResetReply:
        """Acknowledge errors of integrity that the service has latched; its answer says what they were.

        It raises as ``zone`` does. The zone comes back after its good ticks.
        """
        return self._one("reset", m.ResetReply)

    def acknowledge(self) -> str | None:
        """Acknowledge what this client's own ``latch`` holds; return what that was."""
        return None if self._latch is None else self._latch.reset()

    def config(self) -> dict[str, Any]:
        """Return the configuration in force. It raises as ``zone`` does."""
        try:
            return msgspec.json.decode(self._plain("config"), type=dict[str, Any])
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise ServiceError(f"config answered with something malformed: {error}") from error

    def frames(
        self, position: Sequence[float] | None = None, name: Sequence[str] | None = None
    ) -> m.FramesReply:
        """Return sensor and link frames and the reduced Jacobian.

        Args:
            position: (n,), [rad or m]; the present one where left out.
            name: The joints in the order of ``position``; the robot's order where left out.

        Raises:
            InputError: A number is not finite.
            ServiceError: As for ``zone``.
        """
        payload = None if position is None else encoded({"position": list(position), "name": name})
        return self._decoded("frames", m.FramesReply, self._sole("frames", payload))

    def evaluate(
        self, inputs: Sequence[Mapping[str, Any] | m.EvaluateInput], *, timeout_s: float = 30.0
    ) -> list[m.EvaluateOutput | m.EvaluateError]:
        """Ask what the service would say to each of ``inputs``; nothing of it acts on the robot.

        Args:
            inputs: Any number; they are sent in chunks that the service can take.
            timeout_s: For each chunk [s].

        Returns:
            The answers in the same order; an input that cannot be evaluated has an ``EvaluateError``.

        Raises:
            InputError: A number is not finite, which JSON cannot say.
            ServiceError: As for ``zone``.
        """
        answers: list[m.EvaluateOutput | m.EvaluateError] = []
        for chunk in chunks(inputs):
            answers.extend(outputs(self._plain("evaluate", chunk.payload, timeout_s), chunk.count))
        return answers

    def robots(self) -> list[str]:
        """Return the names of all robots with a running service, sorted.

        Raises:
            NoServiceError: Nobody listens at the endpoints.
        """
        session = self.connection.wait(self._timeout_s)
        replies = session.liveliness().get("ssm/*/alive", timeout=self._timeout_s)
        return sorted({robot_of(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None})

    def follower(self) -> Follower:
        """Return a watchdog for a control loop of one's own; it lives as long as this client."""
        return Follower(self.connection, self.keys, latch=self._latch, echo=self._echo)

    def stream(self) -> Iterator[Followed]:
        """Yield the newest decision whenever there is one, and a stop by itself when none came in time.

        It looks about every millisecond and yields the newest state only: of decisions that came between two
        looks, the earlier ones are passed over, so the yields do not count the decisions. How many
        there were is told by ``zone_message.seq``, which rises by one for each.

        It never ends and never raises for want of a service: it waits for one, saying stop about ten times a
        second, and goes on with a restarted one. Who takes longer than ``valid_for_ns`` over one yield
        is given a stop next, as it could not have obeyed meanwhile.
        """
        follower = self.follower()
        last: Followed | None = None
        said = 0.0
        try:
            while True:
                followed = follower.poll()
                now = time.monotonic()
                if followed is not last or (followed.stopped_by_consumer and now - said >= REPEAT_S):
                    last, said = followed, now
                    yield followed
                else:
                    time.sleep(POLL_S)
        finally:
            follower.close()

    def _one(self, name: str, kind: type[M]) -> M:
        answers = [self._decoded(name, kind, answer) for answer in self._asked(name)]
        if len({getattr(answer, "producer", None) for answer in answers}) > 1:
            raise DuplicateServiceError(f"{len(answers)} services answer for {self.keys.robot}")
        return answers[0]

    def _sole(self, name: str, payload: bytes | None = None, timeout_s: float | None = None) -> Answer:
        answers = self._asked(name, payload, timeout_s)
        if len(answers) > 1:
            raise DuplicateServiceError(f"{len(answers)} services answer for {self.keys.robot}")
        return answers[0]

    def _plain(self, name: str, payload: bytes | None = None, timeout_s: float | None = None) -> bytes:
        """Return the sole answer of a kind that has no producer, once its checksum is right."""
        answer = self._sole(name, payload, timeout_s)
        try:
            opened(self.keys.output(name), "", 0, answer.payload, answer.attachment, required=True)
        except InputError as error:
            raise ServiceError(f"{name} answered with something malformed: {error}") from error
        return answer.payload

    def _asked(self, name: str, payload: bytes | None = None, timeout_s: float | None = None) -> list[Answer]:
        key = self.keys.output(name)
        try:
            return ask(self.connection, key, patience_s=self._timeout_s, timeout_s=timeout_s, payload=payload)
        except NoServiceError as error:
            if not self._finalizer.alive:  # closed by ourselves
                raise
            there = f"{self._who_is_there()}; " if self.connection.session is not None else ""
            raise NoServiceError(f"{error}; {there}{STARTING}") from error

    def _who_is_there(self) -> str:
        try:
            robots = self.robots()
        except (NoServiceError, zenoh.ZError):  # the session was closed meanwhile
            robots = []
        if self.keys.robot in robots:
            return "its service is there, but did not answer in time"
        return f"there: {listed(robots)}" if robots else "no robot's service is there"

    def _decoded(self, name: str, kind: type[M], answer: Answer) -> M:
        decoder = SealedDecoder(kind, self.keys.output(name), LARGEST_ANSWER)
        try:
            return decoder.decode(answer.payload, answer.attachment, required=True).message
        except InputError as error:
            raise ServiceError(f"{name} answered with something malformed: {error}") from error

"""Wire faults without a network, for ``bench.faults``: a million, through the service's and client's checks.

What the service's ``Source`` and ``Echoes`` and the client's decoder and watchdog do is done here by
themselves, in a time of their own, with messages handed over in place of Zenoh's.
"""

from __future__ import annotations

import itertools
import multiprocessing
import random
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, cast

import msgspec
import zenoh

from ssm_service.client.accept import OutputDecoder
from ssm_service.client.watchdog import Watchdog
from ssm_service.errors import InputError
from ssm_service.model import Robot
from ssm_service.service.inputs import Source, Surroundings
from ssm_service.service.integrity import IntegrityWatch
from ssm_service.service.publications import Publications
from ssm_service.wire import Heard, Keys, encoding_of, seal
from ssm_service.wire import messages as m

from .faults_chaos import FAULTS
from .faults_forge import Message, Stranger, corrupted, masked, misdirected
from .faults_rig import NAME, ROBOT

INWARD = ("joints", "ranges", "obstacles", "target")
OUTWARD = ("zone", "command")
ANSWERS = ("zone answer",)
LANES = (*INWARD, *OUTWARD, *ANSWERS)
PATTERNS = {"single": 1, "burst": 5, "sustained": 40}
PERIOD_NS = 10_000_000
PATIENCE = 20
AHEAD_NS = 1 << 62
PROCESSES = 2

Line = dict[str, Any]


class Payload:
    """Bytes as Zenoh hands them over."""

    def __init__(self, content: bytes) -> None:
        self._content = content

    def to_bytes(self) -> bytes:
        """Return them."""
        return self._content


@dataclass
class Delivered:
    """A message as Zenoh hands it over: what the checks read of a sample."""

    kind: zenoh.SampleKind
    encoding: zenoh.Encoding
    payload: Payload
    attachment: Payload | None


def delivered(message: Message) -> zenoh.Sample:
    """Return a message as a sample."""
    attachment = None if message.attachment is None else Payload(message.attachment)
    made = Delivered(zenoh.SampleKind.PUT, message.encoding, Payload(message.payload), attachment)
    return cast("zenoh.Sample", made)


class Wires:
    """In place of a Zenoh session: what is put on a key waits there for its subscriber."""

    def __init__(self) -> None:
        self.waiting: dict[str, deque[zenoh.Sample]] = {}

    def declare_subscriber(self, key: str, _channel: object) -> Wires.Subscriber:
        """Return a subscription."""
        return Wires.Subscriber(self.waiting.setdefault(key, deque()))

    class Subscriber:
        """A subscription; it is its own handler."""

        def __init__(self, waiting: deque[zenoh.Sample]) -> None:
            self._waiting = waiting
            self.handler = self

        def try_recv(self) -> zenoh.Sample | None:
            """Return the next sample, or ``None``."""
            return self._waiting.popleft() if self._waiting else None


class Lane:
    """One kind of message: its producer, its receiver, and what the receiver believes.

    A subclass says what is a good message and how the receiver takes one.

    Args:
        name: One of ``LANES``.
        rng: Draws everything.
    """

    def __init__(self, name: str, rng: random.Random) -> None:
        self.name = name
        self.rng = rng
        self.now_ns = time.monotonic_ns()
        self.stranger = Stranger()
        self.recent: deque[Message] = deque(maxlen=16)
        self.others: list[Message] = []
        self.refused: Counter[str] = Counter()

    def good(self) -> Message:
        """Return the producer's next message."""
        raise NotImplementedError

    def hand_over(self, message: Message) -> bool:
        """Let the receiver have a message; return whether it was accepted."""
        raise NotImplementedError

    def too_young(self) -> bool:
        """Tell whether the receiver takes what it has for younger than it is."""
        raise NotImplementedError

    def pass_one(self) -> None:
        """Let good messages through until one is accepted, as after a second producer it takes a while.

        Raises:
            RuntimeError: None was, so that nothing here would prove anything.
        """
        for _ in range(PATIENCE):
            self.now_ns += PERIOD_NS
            message = self.good()
            if self.hand_over(message):
                self.recent.append(message)
                return
        raise RuntimeError(f"good messages are refused: {self.name}, {self.refused}")


class Inward(Lane):
    """An input of the service."""

    def __init__(self, name: str, rng: random.Random, robot: Robot) -> None:
        super().__init__(name, rng)
        self._keys = Keys(NAME)
        self._wires = Wires()
        self._publications = Publications("service", self.now_ns)
        shared = Surroundings(
            robot=robot,
            session=cast("zenoh.Session", self._wires),
            keys=self._keys,
            publications=self._publications,
            watch=IntegrityWatch(),
        )
        self._shared = shared
        self.source: Source[Any] = Source(name, shared)
        self._robot = robot
        self._producer = uuid.uuid4().hex
        self._numbers = itertools.count()
        self._made: dict[int, int] = {}
        self._newest_ns = self.now_ns

    def good(self) -> Message:
        """Return the producer's next message."""
        seq = next(self._numbers)
        self._publications.add(seq, self.now_ns)
        kind = m.INPUTS[self.name]
        message = kind(producer=self._producer, seq=seq, stamp_ns=time.time_ns(), **self._content())
        payload = msgspec.json.encode(message)
        key = self._keys.input(self.name)
        self._made = {seq: self.now_ns, **dict(itertools.islice(self._made.items(), 64))}
        return Message(
            key=key,
            payload=payload,
            encoding=zenoh.Encoding(encoding_of(kind)),
            attachment=seal(key, self._producer, seq, payload, Heard("service", seq)),
        )

    def _content(self) -> dict[str, Any]:
        draw = self.rng.uniform
        if self.name == "joints":
            names = list(self._robot.joint_names)
            still = [0.0] * len(names)
            return {"name": names, "position": [draw(-1.0, 1.0) for _ in names], "velocity": still}
        if self.name == "ranges":
            return {"ranges": [draw(0.1, 0.3) for _ in range(self._robot.sensor_count)]}
        if self.name == "obstacles":
            ball = m.ObstacleEntry(
                id="ball", shape="sphere", size=[0.05], position=(draw(0.1, 0.3), 0.0, 0.5)
            )
            return {"obstacles": [ball]}
        return {"kind": "joint_velocity", "value": [draw(-0.1, 0.1) for _ in self._robot.joint_names]}

    def hand_over(self, message: Message) -> bool:
        """Let the receiver have a message; return whether it was accepted."""
        before = self.source.accepted
        counts = self._shared.rejections.counts
        had = Counter(counts.get(self.name, ()))
        self._wires.waiting[self._keys.input(self.name)].append(delivered(message))
        self.source.drain(self.now_ns, AHEAD_NS)
        self.refused.update(Counter(counts.get(self.name, ())) - had)
        if self.source.accepted == before:
            return False
        self._newest_ns = self._made.get(int(message.fields["seq"]), self.now_ns)
        return True

    def too_young(self) -> bool:
        """Tell whether the receiver takes what it has for younger than it is."""
        age_s = self.source.received(self.now_ns).age_s
        return age_s is not None and age_s < (self.now_ns - self._newest_ns) * 1e-9 - 1e-9


class Outward(Lane):
    """Zone or command, at a consumer that has proved the ages; the other of the two always comes through."""

    def __init__(self, name: str, rng: random.Random) -> None:
        super().__init__(name, rng)
        keys = Keys(NAME)
        self._kinds: dict[str, type[m.Message]] = {"zone": m.Zone, "command": m.VelocityCommand}
        self._key = {name: keys.output(name) for name in OUTWARD}
        self._decoders: dict[str, OutputDecoder[Any]] = {
            "zone": OutputDecoder(m.Zone, self._key["zone"]),
            "command": OutputDecoder(m.VelocityCommand, self._key["command"]),
        }
        self._producer = uuid.uuid4().hex
        self._seq = 0
        self._made: dict[int, int] = {}
        self.watchdog = Watchdog(NAME)
        self._prove()

    def _prove(self) -> None:
        answer = self._decoders["zone"].decode(delivered(self._message("zone")))
        self.watchdog.prove(answer, self.now_ns)

    def _message(self, name: str) -> Message:
        head: dict[str, Any] = {"producer": self._producer, "seq": self._seq, "stamp_ns": time.time_ns()}
        common: dict[str, Any] = {
            "valid_for_ns": 3 * PERIOD_NS,
            "robot": NAME,
            "name": ["a", "b"],
            "zone": "yellow",
        }
        if name == "zone":
            made: m.Message = m.Zone(
                **head,
                **common,
                profile="p",
                distance=0.25,
                speed_limit=[0.2, self.rng.uniform(0.0, 0.2)],
                speed_scaling=0.5,
                nearest=None,
                sources={},
                reaction=None,
                reasons=["distance"],
            )
        else:
            made = m.VelocityCommand(**head, **common, velocity=[self.rng.uniform(-0.1, 0.1), 0.0])
        payload = msgspec.json.encode(made)
        return Message(
            key=self._key[name],
            payload=payload,
            encoding=zenoh.Encoding(encoding_of(self._kinds[name])),
            attachment=seal(self._key[name], self._producer, self._seq, payload),
        )

    def good(self) -> Message:
        """Return the producer's next message."""
        self._seq += 1
        self._made = {self._seq: self.now_ns, **dict(itertools.islice(self._made.items(), 64))}
        if not self.watchdog.proved:
            self._seq -= 1
            self._prove()
            self._seq += 1
        other = "command" if self.name == "zone" else "zone"
        self._take(other, self._message(other))
        return self._message(self.name)

    def hand_over(self, message: Message) -> bool:
        """Let the receiver have a message; return whether it was accepted."""
        held = self.watchdog.state(self.now_ns)
        self._take(self.name, message)
        state = self.watchdog.state(self.now_ns)
        return state is not held and not state.stopped_by_consumer

    def _take(self, name: str, message: Message) -> None:
        try:
            decoded = self._decoders[name].decode(delivered(message))
            self.watchdog.take(decoded, self.now_ns, self.now_ns)
        except InputError as error:
            self.refused[error.cause] += 1
            self.watchdog.refuse(error, self.now_ns)

    def too_young(self) -> bool:
        """Tell whether the receiver takes what it has for younger than it is."""
        state = self.watchdog.state(self.now_ns)
        if state.zone_message is None or state.stopped_by_consumer:
            return False
        made_ns = self._made.get(state.zone_message.seq, 0)
        return state.expires_ns > made_ns + 3 * PERIOD_NS


class Answering(Outward):
    """The answer to the query by which a consumer proves the ages."""

    def __init__(self, name: str, rng: random.Random) -> None:
        super().__init__("zone", rng)
        self.name = name

    def good(self) -> Message:
        """Return the producer's next message."""
        self._seq += 1
        self._made = {self._seq: self.now_ns, **dict(itertools.islice(self._made.items(), 64))}
        return self._message("zone")

    def hand_over(self, message: Message) -> bool:
        """Let the receiver have a message; return whether it was accepted."""
        self.watchdog.forget()
        try:
            answer = self._decoders["zone"].decode(delivered(message))
            self.watchdog.prove(cast("m.Zone", answer), self.now_ns)
        except InputError as error:
            self.refused[error.cause] += 1
            self.watchdog.refuse(error, self.now_ns)
        return self.watchdog.proved

    def too_young(self) -> bool:
        """Tell whether the receiver takes what it has for younger than it is."""
        return False


def lanes(rng: random.Random) -> dict[str, Lane]:
    """Return all lanes; each knows the others' newest messages, for those that come to a wrong address."""
    robot = Robot.load(ROBOT)
    made: dict[str, Lane] = {name: Inward(name, rng, robot) for name in INWARD}
    made |= {name: Outward(name, rng) for name in OUTWARD}
    made |= {name: Answering(name, rng) for name in ANSWERS}
    for _ in range(3):
        for lane in made.values():
            lane.pass_one()
    for lane in made.values():
        lane.others = [
            other.recent[-1] for other in made.values() if other.recent[-1].key != lane.recent[-1].key
        ]
    return made


def one(lane: Lane, fault: str, count: int) -> Line:
    """Inject a fault ``count`` times in a row and say what came of it."""
    lane.pass_one()
    lane.refused.clear()
    accepted = young = 0
    if fault in ("loss", "delay"):
        late = []
        for _ in range(count):
            lane.now_ns += PERIOD_NS
            late.append(lane.good())
            young += lane.too_young()
        if fault == "delay":
            lane.now_ns += PERIOD_NS * lane.rng.randrange(4, 60)
            for message in late:
                lane.hand_over(message)
                young += lane.too_young()
        return {"accepted": 0, "young": young, "refused": dict(lane.refused)}
    for _ in range(count):
        if fault == "sequence":
            lane.now_ns += PERIOD_NS
            earlier, later = lane.good(), lane.good()
            lane.hand_over(later)
            accepted += lane.hand_over(earlier)
        else:
            message = _faulty(lane, fault)
            accepted += lane.hand_over(message)
        young += lane.too_young()
    return {"accepted": accepted, "young": young, "refused": dict(lane.refused)}


def _faulty(lane: Lane, fault: str) -> Message:
    name = "zone" if lane.name in ANSWERS else lane.name
    newest = lane.recent[-1]
    if fault == "corruption":
        return corrupted(lane.good(), lane.rng)
    if fault == "repetition":
        return lane.rng.choice(lane.recent)
    if fault == "insertion":
        return lane.stranger.message(newest, name)
    if fault == "masquerade":
        return masked(newest, name, lane.rng, right=False)
    return misdirected(newest, name, lane.rng, lane.others)


def cells() -> Iterator[tuple[str, str, str]]:
    """Yield lane, fault and pattern of every cell."""
    for lane, fault, pattern in itertools.product(LANES, FAULTS, PATTERNS):
        if lane in ANSWERS and fault in ("insertion", "repetition", "sequence", "delay", "loss"):
            continue  # an answer has none before it: the round trip judges these
        yield lane, fault, pattern


def chunk(chosen: list[tuple[str, str, str]], each: int, seed: int) -> list[Line]:
    """Inject ``each`` faulty messages in every chosen cell."""
    rng = random.Random(seed)
    made = lanes(rng)
    found = []
    for lane, fault, pattern in chosen:
        begun = time.monotonic()
        count = PATTERNS[pattern]
        total: Counter[str] = Counter()
        causes: Counter[str] = Counter()
        while total["messages"] < each:
            said = one(made[lane], fault, count)
            total.update({"messages": count, "accepted": said["accepted"], "young": said["young"]})
            causes.update(said["refused"])
        found.append(_line(lane, fault, pattern, total, causes, begun))
    return found


def _line(
    lane: str, fault: str, pattern: str, total: Counter[str], causes: Counter[str], begun: float
) -> Line:
    wrong = ["accepted"] * total["accepted"] + ["refreshed"] * total["young"]
    counted = sum(causes.values()) if fault not in ("loss", "delay") else total["messages"]
    return {
        "group": "memory",
        "fault": fault,
        "cell": f"{lane} {pattern}",
        "injected": total["messages"],
        "messages": total["messages"],
        "noticed": min(counted, total["messages"]),
        "by": dict(causes) or {"age": total["messages"]},
        "stop_due": False,
        "late": False,
        "wrong": wrong[:100],
        "recovered": not wrong,
        "took_s": round(time.monotonic() - begun, 3),
    }


def measure(total: int, seed: int, processes: int = PROCESSES) -> Iterator[Line]:
    """Inject ``total`` faulty messages, evenly over all cells; yield a result for each cell."""
    every = list(cells())
    each = -(-total // len(every))
    shares: list[list[tuple[str, str, str]]] = [every[index::processes] for index in range(processes)]
    run: Callable[..., list[Line]] = chunk
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(run, share, each, seed + index) for index, share in enumerate(shares)]
        for future in futures:
            yield from future.result()

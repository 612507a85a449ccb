"""The chaos process of ``bench.faults``: between a service and everybody else, it injects wire faults.

Drivers and consumers dial it; it dials the service. The two sides are sessions of their own, so that no key
is in two places at once: inputs go on to the service, zone and command come back, and so do the answers to
queries. Checksums pass through untouched. On command, on stdin, it does to one key what a bad network does.
"""

from __future__ import annotations

import heapq
import itertools
import json
import random
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import zenoh

from ssm_service.wire import Keys
from ssm_service.wire.session import close_session, open_session, zenoh_config

from .faults_forge import Message, Stranger, corrupted, masked, misdirected

INPUTS = ("joints", "ranges", "obstacles", "target", "echo")
OUTPUTS = ("zone", "command")
QUERIES = ("zone", "command", "health", "reset", "evaluate", "frames")
REPLY = "reply"
"""The name under which faults of the answers to ``zone`` queries are commanded."""

ADDED = ("repetition", "insertion", "masquerade", "address", "forged")
"""Faults in which something comes in addition to the messages themselves."""

FAULTS = ("corruption", "repetition", "sequence", "loss", "delay", "insertion", "masquerade", "address")

Put = Callable[[Message], None]


@dataclass(kw_only=True)
class Plan:
    """One fault under way on one key.

    Attributes:
        id: What the bench calls it.
        fault: One of ``FAULTS``, or ``forged``.
        left: Messages still to be hit.
        until_ns: When it ends at the latest [monotonic ns].
        delay_ns: For ``delay`` [ns].
        first_ns: When the first faulty message was put, or not put [monotonic ns].
        hit: Messages hit so far.
    """

    id: int
    fault: str
    left: int
    until_ns: int
    delay_ns: int
    first_ns: int = 0
    last_ns: int = 0
    hit: int = 0
    held: Message | None = None


class Timer:
    """Calls functions at their times, in order, on one thread."""

    def __init__(self) -> None:
        self._due: list[tuple[int, int, Callable[[], None]]] = []
        self._number = itertools.count()
        self._changed = threading.Condition()
        threading.Thread(target=self._run, name="timer", daemon=True).start()

    def at(self, due_ns: int, call: Callable[[], None]) -> None:
        """Have ``call`` called at ``due_ns`` [monotonic ns]."""
        with self._changed:
            heapq.heappush(self._due, (due_ns, next(self._number), call))
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._due or self._due[0][0] > time.monotonic_ns():
                    wait = (self._due[0][0] - time.monotonic_ns()) * 1e-9 if self._due else None
                    self._changed.wait(wait if wait is None else max(wait, 1e-4))
                call = heapq.heappop(self._due)[2]
            call()


@dataclass(kw_only=True)
class Lane:
    """One key in one direction: what passes, and the fault that is being done to it.

    Attributes:
        name: E.g. ``joints`` or ``zone``.
        key: Its key.
        put: Sends a message on.
        spoil: Sends a faulty message, and waits where the link is full: one that was dropped teaches nothing.
        timer: For delays.
        rng: Draws bits and copies.
        say: Tells the bench.
        lanes: All lanes, for messages that come from another key.
    """

    name: str
    key: str
    put: Put
    spoil: Put
    timer: Timer
    rng: random.Random
    say: Callable[[dict[str, Any]], None]
    lanes: dict[str, Lane]
    passed: int = 0
    recent: deque[Message] = field(default_factory=lambda: deque(maxlen=16))
    stranger: Stranger = field(default_factory=Stranger)
    plan: Plan | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def begin(self, plan: Plan) -> None:
        """Begin a fault; it takes the next message."""
        with self.lock:
            self.plan = plan

    def take(self, message: Message) -> None:
        """Send a message on, or do to it what is being done."""
        with self.lock:
            self.passed += 1
            plan = self.plan
            if plan is not None and plan.hit and time.monotonic_ns() > plan.until_ns:
                self._end(plan)
                plan = self.plan
            if plan is None:
                self.put(message)
            else:
                self._hit(plan, message)
            self.recent.append(message)

    def _hit(self, plan: Plan, message: Message) -> None:
        now = time.monotonic_ns()
        if plan.held is not None:  # the second half of an exchange: the later one first
            held, plan.held = plan.held, None
            self.put(message)
            self.put(held)
            self._count(plan, now)
            return
        if plan.fault == "sequence":
            plan.held = message
            return
        if plan.fault == "delay":
            self.timer.at(now + plan.delay_ns, lambda: self.put(message))
        elif plan.fault == "corruption":
            self.spoil(corrupted(message, self.rng))
        elif plan.fault in ADDED:
            self.put(message)
            now = time.monotonic_ns()
            self.spoil(self._added(plan, message))
        self._count(plan, now)

    def _added(self, plan: Plan, message: Message) -> Message:
        if plan.fault == "repetition":
            return self.rng.choice([*list(self.recent)[-4:], message])
        if plan.fault == "insertion":
            return self.stranger.message(message, self.name)
        if plan.fault == "masquerade":
            return masked(message, self.name, self.rng, right=False)
        if plan.fault == "forged":
            return masked(message, self.name, self.rng, right=True)
        others = [lane.recent[-1] for lane in self.lanes.values() if lane is not self and lane.recent]
        return misdirected(message, self.name, self.rng, others)

    def _count(self, plan: Plan, now: int) -> None:
        plan.hit += 1
        plan.left -= 1
        plan.first_ns = plan.first_ns or now
        plan.last_ns = now
        if plan.left <= 0:
            self._end(plan)

    def _end(self, plan: Plan) -> None:
        if plan.held is not None:
            self.put(plan.held)
        self.plan = None
        self.say({"done": plan.id, "first_ns": plan.first_ns, "last_ns": plan.last_ns, "hit": plan.hit})


class Chaos:
    """Both sessions, and a lane for each key.

    Args:
        robot: The robot's name on the network.
        service: Where the service listens.
        listen: Where this process listens.
        seed: Of everything drawn.
    """

    def __init__(self, robot: str, service: str, listen: str, seed: int) -> None:
        keys = Keys(robot)
        self._keys = keys
        self._timer = Timer()
        self._inner = open_session(zenoh_config("client", connect=[service]))
        self._outer = open_session(zenoh_config("router", listen=[listen]))
        self._pool = ThreadPoolExecutor(8)
        self._rng = random.Random(seed)
        self._declared: list[Any] = []
        self.lanes: dict[str, Lane] = {}
        for name in INPUTS:
            self._lane(name, keys.input(name), self._outer, self._inner)
        for name in OUTPUTS:
            self._lane(name, keys.output(name), self._inner, self._outer)
        self.lanes[REPLY] = self._make_lane(
            REPLY, keys.output("zone"), lambda message: None, lambda message: None
        )
        for name in QUERIES:
            self._declared.append(
                self._outer.declare_queryable(
                    keys.output(name), lambda query, name=name: self._pool.submit(self._ask, name, query)
                )
            )

    def _lane(self, name: str, key: str, origin: zenoh.Session, goal: zenoh.Session) -> None:
        putting = [
            goal.declare_publisher(
                key, express=True, priority=zenoh.Priority.REAL_TIME, congestion_control=congestion
            )
            for congestion in (zenoh.CongestionControl.DROP, zenoh.CongestionControl.BLOCK)
        ]

        def put(message: Message, publisher: zenoh.Publisher = putting[0]) -> None:
            try:
                publisher.put(message.payload, encoding=message.encoding, attachment=message.attachment)
            except zenoh.ZError:
                return  # the other end is gone for the moment

        lane = self._make_lane(name, key, put, lambda message: put(message, putting[1]))
        self.lanes[name] = lane
        self._declared += [
            *putting,
            origin.declare_subscriber(key, lambda sample: lane.take(Message.of(sample))),
        ]

    def _make_lane(self, name: str, key: str, put: Put, spoil: Put) -> Lane:
        return Lane(
            name=name,
            key=key,
            put=put,
            spoil=spoil,
            timer=self._timer,
            rng=random.Random(self._rng.random()),
            say=say,
            lanes=self.lanes,
        )

    def _ask(self, name: str, query: zenoh.Query) -> None:
        """Pass a query on and its answers back."""
        key = self._keys.output(name)
        with query:
            try:
                replies = self._inner.get(
                    str(query.selector),
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    timeout=0.25 if name == "zone" else 5.0,
                    payload=query.payload,
                    encoding=query.encoding,
                    attachment=query.attachment,
                    congestion_control=zenoh.CongestionControl.DROP,
                    priority=zenoh.Priority.INTERACTIVE_HIGH,
                    express=True,
                )
                for reply in replies:
                    if reply.err is not None:
                        query.reply_err(reply.err.payload, encoding=reply.err.encoding)
                    elif reply.ok is not None:
                        for message in self._answers(name, Message.of(reply.ok)):
                            query.reply(
                                key,
                                message.payload,
                                encoding=message.encoding,
                                attachment=message.attachment,
                                express=True,
                                priority=zenoh.Priority.REAL_TIME,
                            )
            except zenoh.ZError:
                return  # whoever asked is gone, or the service is: no answer, as on any network

    def _answers(self, name: str, message: Message) -> list[Message]:
        """Return what comes back instead of an answer: a lane whose messages are returned, not put."""
        if name != "zone":
            return [message]
        lane = self.lanes[REPLY]
        collected: list[Message] = []
        with lane.lock:
            plan = lane.plan
            if plan is not None and plan.fault == "delay":
                lane._count(plan, time.monotonic_ns())
        if plan is not None and plan.fault == "delay":
            time.sleep(plan.delay_ns * 1e-9)
            return [message]
        with lane.lock:
            lane.put = lane.spoil = collected.append
            earlier = list(lane.recent)
            if plan is not None and plan.fault in ("repetition", "sequence"):
                # There is no second message to exchange an answer with: an older one comes in its place.
                collected.append(earlier[0] if earlier else message)
                lane._count(plan, time.monotonic_ns())
                return collected
        lane.take(message)
        return collected

    def command(self, wish: dict[str, Any]) -> None:
        """Do what the bench says."""
        if "ask" in wish:
            say({"asked": wish["ask"], "passed": {name: lane.passed for name, lane in self.lanes.items()}})
            return
        now = time.monotonic_ns()
        plan = Plan(
            id=wish["id"],
            fault=wish["fault"],
            left=wish["count"],
            until_ns=now + int(wish.get("for_ms", 60_000) * 1e6),
            delay_ns=int(wish.get("delay_ms", 0) * 1e6),
        )
        lane = self.lanes[wish["lane"]]
        lane.begin(plan)
        self._timer.at(plan.until_ns, lambda: self._expire(lane, plan))

    def _expire(self, lane: Lane, plan: Plan) -> None:
        with lane.lock:
            if lane.plan is plan:
                lane._end(plan)

    def close(self) -> None:
        """Close both sessions."""
        close_session(self._outer)
        close_session(self._inner)


_saying = threading.Lock()


def say(event: dict[str, Any]) -> None:
    """Write one event to stdout."""
    with _saying:
        sys.stdout.write(json.dumps(event) + "\n")
        sys.stdout.flush()


def chaos(*, robot: str, service: str, listen: str, seed: int) -> None:
    """Stand in between until stdin closes."""
    process = Chaos(robot, service, listen, seed)
    say({"ready": True})
    for line in sys.stdin:
        process.command(json.loads(line))
    process.close()

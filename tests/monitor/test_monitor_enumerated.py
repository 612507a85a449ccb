"""Sources × zones × recovery, enumerated completely over the real code.

First the zone of one tick alone, for every state of the sources, every distance, every doubt and everything
beside perception. Then the ticks in a row: what arrives, ages and is refused, with the machine that lifts
severity slowly, over every state that can be reached.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise, product

import msgspec
import numpy as np
import pytest

from ssm_service.config import SourceConfig, SourcesConfig, load_robot_config
from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import Inputs, JointSample, Monitor, Nearest, Received
from ssm_service.monitor.assess import Seen, assess
from ssm_service.monitor.decision import Comparison
from ssm_service.monitor.ranges import RangeReading
from ssm_service.safety import SourceState, Zone, ZoneMachine, ZoneProfile, classify, forces_stop

FILE = load_robot_config("ur3").file
KANG = FILE.profiles["kang2022"]
DISTANCES = (None, 1.0, 0.3, 0.1, 0.0)
"""[m], from nothing to contact: none, green, yellow, red, stop."""

ABSENT, FRESH, STALE, INVALID = SourceState.ABSENT, SourceState.FRESH, SourceState.STALE, SourceState.INVALID
AGE = {ABSENT: None, FRESH: 0.01, STALE: 9.0, INVALID: 0.01}
REQUIRED = {"ranges": (True, False), "obstacles": (False, True), "both": (True, True)}
"""Whether ranges and obstacles are required; a robot file must require one of them."""


@dataclass(frozen=True)
class Situation:
    """All that one tick alone depends on. Distances as their place in ``DISTANCES``."""

    joints: SourceState
    ranges: SourceState
    obstacles: SourceState
    seen_by_ranges: int = 0
    tracked: int = 0
    unseen: bool = False
    uncovered: bool = False
    contradicted: bool = False
    disagrees: bool = False

    @property
    def read(self) -> bool:
        return self.joints is FRESH and self.ranges is FRESH

    @property
    def followed(self) -> bool:
        return self.joints is FRESH and self.obstacles is FRESH


def situations() -> Iterator[Situation]:
    """Every one that can be; what a source that is not fresh would say is nobody's to ask."""
    for states in product(SourceState, repeat=3):
        bare = Situation(*states)
        both = bare.read and bare.followed
        for place, unseen, uncovered, contradicted in product(
            range(5) if bare.read else (0,), *[(False, True) if bare.read else (False,)] * 3
        ):
            for tracked, disagrees in product(
                range(5) if bare.followed else (0,), (False, True) if both else (False,)
            ):
                # Readings that nothing explains say no distance, and what says none is not unseen.
                if (contradicted and (place or unseen)) or (unseen and not place):
                    continue
                yield replace(
                    bare,
                    seen_by_ranges=place,
                    tracked=tracked,
                    unseen=unseen,
                    uncovered=uncovered,
                    contradicted=contradicted,
                    disagrees=disagrees,
                )


def worse(now: Situation, required: tuple[bool, bool]) -> Iterator[Situation]:
    """Every situation that differs in one thing, and in that for the worse."""
    names = {"joints": True, "ranges": required[0], "obstacles": required[1]}
    for name, needed in names.items():
        state = getattr(now, name)
        lost: dict[str, object] = {}
        if name in ("joints", "ranges"):
            lost |= {"seen_by_ranges": 0, "unseen": False, "uncovered": False, "contradicted": False}
        if name in ("joints", "obstacles"):
            lost |= {"tracked": 0}
        after = {FRESH: [STALE, INVALID, *[ABSENT] * needed], ABSENT: [STALE, INVALID]}
        for other in after.get(state, []):
            yield replace(now, **{name: other}, **lost, disagrees=False)  # type: ignore[arg-type]
    for name, may in (
        ("seen_by_ranges", now.read and not now.contradicted),
        ("tracked", now.followed),
    ):
        place = getattr(now, name)
        if may and place < 4:
            yield replace(now, **{name: place + 1})
    if now.read and now.seen_by_ranges and not now.unseen and not now.contradicted:
        yield replace(now, unseen=True)
    if now.read and not now.uncovered:
        yield replace(now, uncovered=True)
    if now.read and not now.contradicted:
        yield replace(now, contradicted=True, seen_by_ranges=0, unseen=False)
    if now.read and now.followed and not now.disagrees:
        yield replace(now, disagrees=True)


def config_of(required: tuple[bool, bool], timeout_s: float = 1.0) -> SourcesConfig:
    ranges, obstacles = (SourceConfig(required=each, timeout_s=timeout_s) for each in required)
    joints = SourceConfig(required=True, timeout_s=timeout_s)
    return SourcesConfig(joints=joints, ranges=ranges, obstacles=obstacles)


def nearest(source: str, place: int) -> Nearest | None:
    distance = DISTANCES[place]
    if distance is None:
        return None
    zeros = np.zeros(3)
    return Nearest(
        source=source,
        link="forearm_link",
        obstacle=None if source == "ranges" else "ball",
        distance=distance,
        point_on_link=zeros,
        point_on_obstacle=zeros,
        normal=zeros,
    )


def alone(profile: ZoneProfile, config: SourcesConfig, now: Situation) -> Zone:
    """Return the zone that the real code gives to one tick alone."""
    statuses = []
    for name in ("joints", "ranges", "obstacles", "target"):
        state = getattr(now, name, ABSENT)
        source = getattr(config, name)
        status = classify(name, source, age_s=AGE[state], invalid=state is INVALID)
        assert status.state is state
        statuses.append(status)
    reading, comparison = None, None
    if now.read:
        reading = RangeReading(
            nearest=nearest("ranges", now.seen_by_ranges),
            ranges=np.full(8, np.inf),
            others=np.full(8, np.inf),
            nearest_other=None,
            least={"forearm_link": 1.0},
            bounds=(),
            silent={},
            unseen=now.unseen,
            uncovered=now.uncovered,
            contradicted=now.contradicted,
        )
    if now.read and now.followed:
        comparison = Comparison(
            link="forearm_link",
            estimator="nearest",
            estimate=None,
            exact=None,
            difference=None,
            disagrees=now.disagrees,
        )
    things = [
        None if reading is None else reading.nearest,
        nearest("obstacles", now.tracked) if now.followed else None,
    ]
    seen = Seen(
        things=[thing for thing in things if thing is not None], reading=reading, comparison=comparison
    )
    made = assess(profile, config, statuses, seen)
    assert (made.zone is Zone.GREEN) == (not made.reasons), "every zone but green has its reason"
    for separation in Zone:
        beside = assess(profile, config, statuses, seen, separation)
        assert beside.zone is max(made.zone, separation), "the separation never makes it milder"
        assert beside.beside is made.zone
        assert ("separation" in beside.reasons) == (separation is not Zone.GREEN)
    return made.zone


def at_least(now: Situation, required: tuple[bool, bool], uncovered: Zone, disagree: Zone) -> Zone:
    """Return what DESIGN 2 asks for: the worst of all that is known and of all that is not."""
    zones = [Zone.GREEN]
    for state, needed in zip((now.joints, now.ranges, now.obstacles), (True, *required), strict=True):
        if state in (STALE, INVALID) or (state is ABSENT and needed):
            zones.append(Zone.STOP)
    zones += [Zone(max(place - 1, 0)) for place in (now.seen_by_ranges, now.tracked)]
    if now.contradicted:
        zones.append(Zone.STOP)
    if now.uncovered and not now.followed:
        zones.append(uncovered)
    if now.disagrees:
        zones.append(disagree)
    return max(zones)


def profile_of(uncovered: Zone, disagree: Zone) -> ZoneProfile:
    word = "off" if uncovered is Zone.GREEN else uncovered.word
    words = {"uncovered": word, "disagree_zone": disagree.word}
    return ZoneProfile(name="all", config=msgspec.structs.replace(KANG, **words))


@pytest.mark.parametrize("required", REQUIRED.values(), ids=REQUIRED)
def test_every_tick_alone(required: tuple[bool, bool]) -> None:
    """No fault and no doubt ever makes it milder, and each has the zone that it is worth."""
    config, everything = config_of(required), list(situations())
    tables: dict[tuple[Zone, Zone], dict[Situation, Zone]] = {}
    for uncovered, disagree in product(Zone, list(Zone)[1:]):
        profile = profile_of(uncovered, disagree)
        table = {now: alone(profile, config, now) for now in everything}
        tables[uncovered, disagree] = table
        for now, zone in table.items():
            assert zone is at_least(now, required, uncovered, disagree), now
            for other in worse(now, required):
                assert table[other] >= zone, (now, other)
    for stricter in pairwise(Zone):
        for disagree in list(Zone)[1:]:
            mild, strict = (tables[uncovered, disagree] for uncovered in stricter)
            assert all(strict[now] >= mild[now] for now in everything)
    print(f"{len(everything)} situations, {sum(map(len, tables.values()))} with all profiles")


# --- ticks in a row -----------------------------------------------------------------------------------------

TIMEOUT = 1
"""Ticks, of every source: a value is fresh in the tick in which it came and in the next."""

NEEDED = 2
"""Good ticks before a zone becomes milder."""


@dataclass(frozen=True)
class Source:
    """One source between two ticks, as the service keeps it, in ticks.

    ``age`` of the newest good value, ``None`` before the first; ``refused``: for how many more ticks a
    refusal counts that no good message has followed.
    """

    age: int | None = None
    refused: int = 0

    def after(self, event: str) -> Source:
        age = None if self.age is None else min(self.age + 1, TIMEOUT + 1)
        if event == "good":
            return Source(age=0)
        if event == "refused":
            return Source(age=age, refused=TIMEOUT + 1)
        return Source(age=age, refused=max(self.refused - 1, 0))

    def faulty(self, config: SourceConfig) -> bool:
        """Tell whether it must stop the robot, by what has happened."""
        if self.refused or self.age is None:
            return self.refused > 0 or config.required
        return self.age > TIMEOUT

    def status_in(self, name: str, config: SourceConfig) -> SourceState:
        """Return what the real code makes of it."""
        age_s = None if self.age is None else float(self.age)
        status = classify(name, config, age_s=age_s, invalid=self.refused > 0)
        assert forces_stop(status, config) is self.faulty(config)
        return status.state


EVENTS = ("good", "silence", "refused")
Three = tuple[Source, Source, Source]


def sources_reachable() -> set[Three]:
    found, waiting = {(Source(),) * 3}, deque([(Source(),) * 3])
    while waiting:
        now = waiting.popleft()
        for events in product(EVENTS, repeat=3):
            later = tuple(source.after(event) for source, event in zip(now, events, strict=True))
            if later not in found:
                found.add(later)  # type: ignore[arg-type]
                waiting.append(later)  # type: ignore[arg-type]
    return found  # type: ignore[return-value]


class Machines:
    """The real machine as a table: states as numbers, filled as they are met."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._machines: list[ZoneMachine] = []
        self._steps: dict[tuple[int, Zone], int] = {}
        self.start = self._number(ZoneMachine(NEEDED))

    def zone(self, number: int) -> Zone:
        return self._machines[number].zone

    def step(self, number: int, zone: Zone) -> int:
        if (number, zone) not in self._steps:
            machine = copy.deepcopy(self._machines[number])
            machine.step(zone)
            self._steps[number, zone] = self._number(machine)
        return self._steps[number, zone]

    def _number(self, machine: ZoneMachine) -> int:
        state = str(sorted(vars(machine).items()))
        if state not in self._numbers:
            self._numbers[state] = len(self._machines)
            self._machines.append(machine)
        return self._numbers[state]


@pytest.mark.parametrize("required", REQUIRED.values(), ids=REQUIRED)
def test_every_state_that_sources_and_recovery_reach(required: tuple[bool, bool]) -> None:
    """Every fault stops within its bound, none makes anything milder, and recovery takes its good ticks."""
    config, profile = config_of(required, float(TIMEOUT)), profile_of(Zone.YELLOW, Zone.RED)
    may: dict[tuple[SourceState, ...], set[Zone]] = {}
    for now in situations():
        may.setdefault((now.joints, now.ranges, now.obstacles), set()).add(alone(profile, config, now))
    names = ("joints", "ranges", "obstacles")
    configs = [getattr(config, name) for name in names]
    statuses = {
        source: [source.status_in(name, each) for name, each in zip(names, configs, strict=True)]
        for source in {source for three in sources_reachable() for source in three}
    }

    def states_of(three: Three) -> tuple[SourceState, ...]:
        return tuple(statuses[source][place] for place, source in enumerate(three))

    machines = Machines()
    # The last are the newest ticks alone, so that nothing is asked of the machine that judges itself.
    start = ((Source(),) * 3, machines.start, (Zone.STOP,) * NEEDED)
    found, waiting, steps = {start}, deque([start]), 0
    while waiting:
        three, machine, window = waiting.popleft()
        before = machines.zone(machine)
        # Each source may fall silent now, with everything else at its best: it stops within its bound.
        for silent, each in enumerate(configs):
            if each.required or three[silent].age is not None:
                later, at = list(three), machine
                for _ in range(TIMEOUT + 1):
                    later = [s.after("silence" if i == silent else "good") for i, s in enumerate(later)]
                    at = machines.step(at, min(may[states_of(tuple(later))]))  # type: ignore[arg-type]
                assert machines.zone(at) is Zone.STOP
        for events in product(EVENTS, repeat=3):
            later = tuple(source.after(event) for source, event in zip(three, events, strict=True))
            states = states_of(later)  # type: ignore[arg-type]
            for momentary in may[states]:
                steps += 1
                at = machines.step(machine, momentary)
                zone = machines.zone(at)
                assert zone >= momentary
                if any(source.faulty(each) for source, each in zip(later, configs, strict=True)):
                    assert zone is Zone.STOP
                last = (*window[1:], momentary)
                if zone < before:
                    assert max(last) < before, "milder only after its good ticks in a row"
                    assert zone is max(last)
                node = (later, at, last)
                if node not in found:
                    found.add(node)  # type: ignore[arg-type]
                    waiting.append(node)  # type: ignore[arg-type]
    print(f"{len(found)} states, {steps} steps; {len(sources_reachable())} of the sources alone")


# --- the real monitor ---------------------------------------------------------------------------------------

POSE = np.array((0.4, -1.1, 1.0, 0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Tick:
    """What the real monitor is given; each field rises with severity; sources: see ``STATES``."""

    joints: int = 0
    ranges: int = 0
    obstacles: int = 0
    echo: int = 0
    ball: int = 0
    overrun: int = 0
    duplicate: int = 0
    latched: int = 0


STATES = (FRESH, ABSENT, STALE, INVALID)
ECHOES = (np.inf, 1.0, 0.3, 0.1, 0.0)
LATCHED = 2
HEIGHTS = (6.0, 0.9, 0.3, 0.12, 0.0)
"""Of a ball above the forearm's ring [m]."""


class Driver:
    """Gives the real monitor one tick and takes the zone that this tick alone gives."""

    def __init__(self, robot: Robot, profile: str) -> None:
        self.monitor = Monitor(robot, profile=profile)
        self._sources = robot.config.file.sources
        self._joints = JointSample(position=POSE, velocity=np.zeros(6))
        self._scans = [np.array([echo] + [np.inf] * 7) for echo in ECHOES]
        x, y, z = robot.kinematics(POSE).transform_sensor_to_base(0)[:3, 3].tolist()
        self._balls = [
            (Obstacle(id="ball", shape="sphere", size=(0.05,), position=(x, y, z + height)),)
            for height in HEIGHTS
        ]

    def inputs(self, tick: Tick) -> Inputs:
        values = {
            "joints": self._joints,
            "ranges": self._scans[tick.echo],
            "obstacles": self._balls[tick.ball],
        }
        received = {}
        for name, value in values.items():
            state = STATES[getattr(tick, name)]
            stale = getattr(self._sources, name).timeout_s + 1e-9
            received[name] = Received(
                value=None if state is ABSENT else value,
                age_s={ABSENT: None, STALE: stale}.get(state, 0.001),
                invalid=state is INVALID,
            )
        overrun_s = (0.0, 0.001, self.monitor.valid_for_s + 1e-6)[tick.overrun]
        return Inputs(
            **received, overrun_s=overrun_s, duplicate=bool(tick.duplicate), latched=bool(tick.latched)
        )

    def __call__(self, tick: Tick) -> Zone:
        decision = self.monitor.step(self.inputs(tick))
        assert decision.zone >= decision.momentary_zone
        assert (decision.speed_limit == 0.0).all() == (decision.zone is Zone.STOP)
        return decision.momentary_zone


def ticks() -> Iterator[Tick]:
    """Every tick; where a source is not fresh, what it would say is left at its mildest."""
    for echo, ball in product(range(5), range(5)):  # slowest: a new scan and a new obstacle take time
        for joints, ranges, obstacles in product(range(4), repeat=3):
            if (echo and (ranges or joints)) or (ball and (obstacles or joints)):
                continue
            for overrun, duplicate, latched in product(range(3), range(2), range(LATCHED)):
                yield Tick(joints, ranges, obstacles, echo, ball, overrun, duplicate, latched)


@pytest.mark.parametrize("profile", sorted(FILE.profiles))
def test_every_tick_of_the_real_monitor(robot: Robot, profile: str) -> None:
    """No input that is worse is ever worth less; every fault is a stop."""
    drive = Driver(robot, profile)
    table = {tick: drive(tick) for tick in ticks()}
    for tick, zone in table.items():
        optional_absent = tick.obstacles == 1
        if tick.joints or tick.ranges or (tick.obstacles and not optional_absent):
            assert zone is Zone.STOP, tick
        if tick.duplicate or tick.latched or tick.overrun == 2:
            assert zone is Zone.STOP, tick
        if tick.overrun:
            assert zone >= Zone.YELLOW
        for field in ("echo", "ball", "overrun", "duplicate", "latched"):
            other = table.get(replace(tick, **{field: getattr(tick, field) + 1}))
            assert other is None or other >= zone, (tick, field)
        if 4 in (tick.echo, tick.ball):
            assert zone is Zone.STOP
    assert {Zone.STOP} < set(table.values())
    print(f"{profile}: {len(table)} ticks")

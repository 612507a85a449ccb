"""The real monitor under any sequence of events, and a twin of it that is at times given something worse."""

from __future__ import annotations

import itertools
import math
import re
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from ssm_service.config import load_robot_config
from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import SOURCES, Decision, Inputs, JointSample, Monitor, Received, Target
from ssm_service.safety import Zone

FILE = load_robot_config("ur3")
PERIOD_S = 0.01
RECOVERY_TICKS = 6
WORDS = re.compile(
    r"(waiting|stale|invalid):(joints|ranges|obstacles|target)|distance|contact|separation|uncovered|disagree"
    r"|overrun|duplicate:service|latched|recovering"
)
HELD = ("duplicate", "latched")
"""Flags of a tick that stop the robot while they are up."""

names = st.sampled_from(SOURCES)
echoes = st.lists(
    st.sampled_from([math.inf, math.inf, 1.1, 0.5, 0.36, 0.3, 0.17, 0.05, 0.0]), min_size=8, max_size=8
)
places = st.tuples(*[st.sampled_from([-2.5, -0.6, -0.3, 0.0, 0.3, 0.45, 0.8, 3.0])] * 3)
angles = st.lists(st.sampled_from([-1.5, -0.4, 0.0, 0.3, 1.2]), min_size=3, max_size=3)


@cache
def robot() -> Robot:
    """The UR3, but for a recovery so short that a sequence of events reaches its end."""
    text = re.sub(
        r"recovery_ticks *= *\d+", f"recovery_ticks = {RECOVERY_TICKS}", Path(FILE.path).read_text()
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ur3.toml"
        path.write_text(text)
        return Robot.load(path)


@cache
def monitors(profile: str) -> tuple[Monitor, Monitor]:
    """The monitor and its twin; they take long to make, so all sequences share them."""
    one, other = (Monitor(robot(), profile=profile, period_s=PERIOD_S) for _ in range(2))
    return one, other


class Events(RuleBasedStateMachine):
    """What may happen between ticks; sources by name, ages by a clock of ticks."""

    profile = "kang2022"

    def __init__(self) -> None:
        super().__init__()
        self.monitor, self.twin = monitors(self.profile)
        for _ in range(RECOVERY_TICKS):  # as at the start: nothing is known, and nothing moves
            first = [monitor.step(Inputs()) for monitor in (self.monitor, self.twin)]
        assert all(decision.zone is Zone.STOP for decision in first)
        self.first_tick = first[0].tick
        self.ticks = 0
        self.values: dict[str, Any] = {}
        self.came: dict[str, int] = {}
        self.refused: set[str] = set()
        self.flags: dict[str, Any] = {"overrun_s": 0.0, **dict.fromkeys(HELD, False)}
        self.momentary = [Zone.STOP] * RECOVERY_TICKS
        self.zone = Zone.STOP
        self.decision: Decision | None = None
        self.twins: Decision | None = None

    # --- what arrives ---

    def arrive(self, name: str, value: Any) -> None:
        self.values[name], self.came[name] = value, self.ticks
        self.refused.discard(name)

    @rule(three=angles, speed=st.sampled_from([0.0, 0.5, -2.0]))
    def joints(self, three: list[float], speed: float) -> None:
        position = np.array([0.4, -1.1, 1.0, 0.0, 0.0, 0.0]) + np.array([*three, 0.0, 0.0, 0.0])
        self.arrive(
            "joints", JointSample(position=position, velocity=np.array([speed, -speed, speed, 0, 0, 0]))
        )

    @rule(scan=echoes)
    def ranges(self, scan: list[float]) -> None:
        self.arrive("ranges", np.array(scan))

    @rule(balls=st.lists(places, max_size=3))
    def obstacles(self, balls: list[tuple[float, float, float]]) -> None:
        made = [
            Obstacle(id=f"{number}", shape="sphere", size=(0.05,), position=place)
            for number, place in enumerate(balls)
        ]
        self.arrive("obstacles", tuple(made))

    @rule(
        wanted=st.sampled_from(
            [
                ("joint_velocity", (1.0, -3.0, 3.0, 0, 0, 0)),
                ("position", (0.3, 0.1, 0.4)),
                ("twist", (0, 0, 9.0, 0, 0, 0)),
            ]
        )
    )
    def target(self, wanted: tuple[str, tuple[float, ...]]) -> None:
        kind, value = wanted
        self.arrive("target", Target(kind=kind, value=np.array(value, dtype=np.float64)))

    @rule(name=names)
    def refuse(self, name: str) -> None:
        self.refused.add(name)

    # --- what passes ---

    def inputs(self) -> Inputs:
        received = {
            name: Received(
                value=self.values.get(name),
                age_s=(self.ticks - self.came[name]) * PERIOD_S if name in self.came else None,
                invalid=name in self.refused,
            )
            for name in SOURCES
        }
        return Inputs(**received, **self.flags)

    def tick(self, worse: dict[str, Any]) -> None:
        """Let both decide; the twin with something worse in its inputs."""
        before, inputs = self.zone, self.inputs()
        self.decision = self.monitor.step(inputs)
        self.twins = self.twin.step(msgspec.structs.replace(inputs, **worse) if worse else inputs)
        self.zone = self.decision.zone
        self.momentary = [*self.momentary[1:], self.decision.momentary_zone]
        assert self.zone is max(self.momentary), "the worst of the last ticks"
        if self.decision.momentary_zone >= before:
            assert self.zone is self.decision.momentary_zone, "worse at once"
        if self.faults():
            assert self.zone is Zone.STOP, self.faults()
        self.check()
        self.ticks += 1

    @rule(silent=st.sets(names, max_size=2), count=st.integers(1, 45))
    def time_passes(self, silent: set[str], count: int) -> None:
        """Drivers go on saying what they said last, but for those that have fallen silent."""
        for _ in range(count):
            for name in self.came.keys() - silent:
                self.came[name] = self.ticks
                self.refused.discard(name)
            self.tick({})

    @rule(count=st.integers(RECOVERY_TICKS, 2 * RECOVERY_TICKS))
    def all_is_well(self, count: int) -> None:
        """With everything fresh, and nothing near: the way back to green."""
        self.joints([0.0, 0.0, 0.0], 0.0)
        self.ranges([math.inf] * 8)
        if "obstacles" in self.came:
            self.obstacles([(3.0, 0.0, 0.3)])
        self.time_passes(set(), count)

    @rule(late_s=st.sampled_from([1e-6, 0.01, 0.03, 0.031, 0.2]))
    def a_tick_was_late(self, late_s: float) -> None:
        self.flags["overrun_s"] = late_s
        self.time_passes(set(), 1)
        self.flags["overrun_s"] = 0.0

    @rule(name=st.sampled_from(HELD), count=st.integers(1, 3))
    def another_service_or_a_latch(self, name: str, count: int) -> None:
        self.flags[name] = True
        self.time_passes(set(), count)
        self.flags[name] = False

    @rule(
        what=st.sampled_from(["joints", "ranges", "obstacles", *HELD, "overrun_s"]),
        kind=st.sampled_from(["invalid", "stale"]),
        count=st.integers(1, 3),
    )
    def something_worse_for_the_twin(self, what: str, kind: str, count: int) -> None:
        for _ in range(count):
            for name in self.came:
                self.came[name] = self.ticks
            inputs = self.inputs()
            worse: dict[str, Any] = {what: True}
            if what == "overrun_s":
                worse = {what: inputs.overrun_s + 0.01}
            elif what in SOURCES:
                source = getattr(inputs, what)
                age = None if source.age_s is None else source.age_s + 20.0
                changes = {"invalid": True} if kind == "invalid" else {"age_s": age}
                worse = {what: msgspec.structs.replace(source, **changes)}
            self.tick(worse)

    # --- what must hold ---

    def faults(self) -> list[str]:
        """Return what must stop the robot, by what happened."""
        found = [name for name in HELD if self.flags[name]]
        if self.flags["overrun_s"] > self.monitor.valid_for_s:
            found.append("overrun")
        for name in ("joints", "ranges", "obstacles"):
            config = getattr(FILE.file.sources, name)
            if name in self.refused:
                found.append(f"invalid:{name}")
            elif name not in self.came:
                found += [f"waiting:{name}"] * config.required
            elif (self.ticks - self.came[name]) * PERIOD_S > config.timeout_s:
                found.append(f"stale:{name}")
        return found

    def check(self) -> None:
        decision, twins = self.decision, self.twins
        assert decision is not None
        assert twins is not None
        assert twins.zone >= decision.zone, "worse inputs made it milder"
        for made in (decision, twins):
            for values in (made.speed_limit, made.velocity):
                assert np.isfinite(values).all()
            assert (made.speed_limit >= 0.0).all()
            assert (made.speed_limit <= robot().velocity_limit).all()
            assert (np.abs(made.velocity) <= robot().velocity_limit + 1e-12).all()
            assert 0.0 <= made.speed_scaling <= 1.0
            assert made.zone >= made.momentary_zone
            assert (made.zone is Zone.GREEN) <= (
                not set(made.reasons) - {f"{s}:target" for s in ("waiting", "stale", "invalid")}
            )
            if made.zone is Zone.STOP:
                assert not made.speed_limit.any()
                assert not made.velocity.any()
                assert made.speed_scaling == 0.0
                assert made.reasons
            assert all(WORDS.fullmatch(word) for word in made.reasons), made.reasons
            if made.distance is not None:
                assert math.isfinite(made.distance)
        assert set(self.faults()) <= {word.removesuffix(":service") for word in decision.reasons}

    @invariant()
    def ticks_are_numbered(self) -> None:
        assert self.decision is None or self.decision.tick == self.first_tick + self.ticks


@pytest.mark.parametrize("profile", sorted(FILE.file.profiles))
def test_any_sequence_of_events(profile: str) -> None:
    events = type("Events", (Events,), {"profile": profile})
    run_state_machine_as_test(
        events,
        settings=settings(
            derandomize=True, database=None, deadline=None, max_examples=35, stateful_step_count=40
        ),
    )


def test_the_events_reach_every_zone() -> None:
    """The sequences above would prove little if all of them stopped."""
    events = Events()
    events.joints([0.0, 0.0, 0.0], 0.0)
    reached = []
    for echo in (math.inf, 0.3, 0.1, 0.0):
        events.ranges([echo, *itertools.repeat(math.inf, 7)])
        events.time_passes(set(), 2 * RECOVERY_TICKS)
        reached.append(events.zone)
    assert reached == list(Zone)

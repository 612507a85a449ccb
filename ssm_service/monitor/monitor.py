"""The monitor: one tick, values in, one decision out."""

from __future__ import annotations

import numpy as np

from ..config import ProfileConfig
from ..errors import ConfigError, listed, suggestion
from ..model import ClosestPair, DistanceModel, Kinematics, Obstacle, Robot
from ..safety import Least, LeastHeld, SourceState, SourceStatus, Zone, ZoneMachine, ZoneProfile, classify
from .assess import Assessment, Seen, assess, compare, nearest_by_obstacles
from .command import zone_speed_limit
from .commander import Commander
from .decision import Comparison, Decision
from .evaluate import Evaluation, EvaluationInput, Evaluator
from .inputs import Inputs
from .plausibility import Plausibility
from .ranges import RangeReader, RangeReading
from .reaction import reaction_times
from .separated import Limit, Separated
from .separation import SeparationStep, Sight
from .snapshot import Keeping, Snapshot

SOURCES = ("joints", "ranges", "obstacles", "target")


def zone_profile(robot: Robot, name: str | None) -> ZoneProfile:
    """Return a robot's profile by name; the file's default where ``name`` is ``None``.

    Raises:
        ConfigError: There is no profile of that name.
    """
    file = robot.config.file
    chosen = file.default_profile if name is None else name
    config: ProfileConfig | None = file.profiles.get(chosen)
    if config is None:
        allowed = f"{suggestion(chosen, file.profiles)}the profiles here are {listed(file.profiles)}"
        raise ConfigError(robot.config.path, "profiles", chosen, allowed)
    return ZoneProfile(name=chosen, config=config)


def _check_period(robot: Robot, period_s: float) -> None:
    """Refuse a period at which the approach to a goal would overshoot.

    Raises:
        ConfigError: ``approach_gain`` times the period is 1 or more.
    """
    gain = robot.config.file.motion.approach_gain
    if not gain * period_s < 1.0:
        allowed = f"below {1.0 / period_s:g} 1/s at a period of {period_s:g} s, or the approach overshoots"
        raise ConfigError(robot.config.path, "motion.approach_gain", gain, allowed)


def default_valid_for(period_s: float) -> float:
    """Return for how long a decision may be acted on [s]: the greater of 20 ms and three periods."""
    return max(0.020, 3.0 * period_s)


class Monitor:
    """Inputs and their ages in, one decision out: no clock, no network, no file.

    The same sequence of inputs gives the same sequence of decisions, bit for bit. Between ticks it keeps
    only the zones and the least admissible speed of the last ticks (for slow recovery), the last command
    (for the acceleration limit) and what it made of the newest scan and the newest obstacles.

    Where the profile has a separation, ``speed_limit`` is what is safe in any direction, by the pair that
    leaves the least share of the joint speeds within the last ``recovery_ticks``. The command knows its
    direction: it is the greatest scaling of the wanted velocity at which no pair of this tick closes faster
    than it may, nor the one that gave the least share; so motion away from everything is not slowed.

    Attributes:
        robot: The robot.
        profile: The profile in force.
        range_reader: Reads the scans; one that takes long may be prepared elsewhere before a tick gets it.

    Args:
        robot: The robot.
        profile: Name of a zone profile in the robot file; its default where left out.
        period_s: Time from tick to tick [s].

    Raises:
        ConfigError: There is no profile of that name, or the period is too long for the robot file.
    """

    def __init__(self, robot: Robot, *, profile: str | None = None, period_s: float = 0.002) -> None:
        self.robot = robot
        self.profile = zone_profile(robot, profile)
        _check_period(robot, period_s)
        self.period_s = period_s
        self.valid_for_s = default_valid_for(period_s)
        config = self.profile.config
        self._machine = ZoneMachine(config.recovery_ticks)
        self._beside = ZoneMachine(config.recovery_ticks)
        self._least: LeastHeld[Limit] = LeastHeld(config.recovery_ticks)
        self._distance = DistanceModel(robot)
        self.range_reader = RangeReader(robot, self.profile, period_s)
        self._separation = None
        if config.separation is not None:
            self._separation = SeparationStep(robot, self.profile, config.separation)
        self._obstacles: tuple[Obstacle, ...] = ()
        self._compared: tuple[object, object] = (None, None)
        self._comparison: Comparison | None = None
        self._evaluator: Evaluator | None = None
        self._plausibility = Plausibility.of(robot, period_s, self.valid_for_s)
        self._commander = Commander(robot, period_s)
        self._commander.prepare()
        self._tick = 0

    def step(self, inputs: Inputs) -> Decision:
        """Decide one tick.

        Args:
            inputs: What is known now. The values of ``obstacles`` and ``ranges`` are compared by identity
                with the last tick's: pass the same objects again while nothing new has arrived.

        Returns:
            Zone, limits and command, all of this snapshot.
        """
        self._tick += 1
        statuses = {name: self._status(name, inputs) for name in SOURCES}
        fresh = {name for name, status in statuses.items() if status.state is SourceState.FRESH}
        kinematics, seen = self._perceive(inputs, fresh)
        separated = self._separate(inputs, fresh, kinematics, seen)
        sources = self.robot.config.file.sources
        by_separation = Zone.GREEN if separated is None else separated.zone
        now = assess(self.profile, sources, tuple(statuses.values()), seen, by_separation)
        doubt = max(self._beside_perception(now, inputs), self._implausible(now, inputs, fresh, kinematics))
        momentary = max(now.zone, doubt)
        zone, beside = self._machine.step(momentary), self._beside.step(max(now.beside, doubt))
        if zone > momentary:
            now.reasons.append("recovering")
        least = self._hold(kinematics, separated)
        share = 0.0 if zone is Zone.STOP else least.share
        limit = zone_speed_limit(self.robot, self.profile, beside)
        limits = [separated.limit] if separated is not None else []
        limits += [least.cause] if least.cause is not None else []
        keeping = Keeping(speed_limit=limit, limits=limits, separation=self._separation)
        if statuses["target"].reason is not None:
            now.reasons.append(statuses["target"].reason)
        snapshot = self._snapshot(inputs, fresh, kinematics, seen, now) if "target" in fresh else None
        return Decision(
            tick=self._tick,
            zone=zone,
            momentary_zone=momentary,
            distance=None if now.nearest is None else now.nearest.distance,
            nearest=now.nearest,
            sources=now.sources,
            comparison=now.comparison,
            speed_limit=np.minimum(limit, share * self.robot.velocity_limit),
            speed_scaling=min(self.profile.speed_scaling(beside), share),
            velocity=self._commander.stand()
            if snapshot is None or zone is Zone.STOP
            else self._commander.step(snapshot, keeping, self._distance),
            reasons=tuple(now.reasons),
            position=None
            if kinematics is None or inputs.joints.value is None
            else inputs.joints.value.position,
            separation=separated,
        )

    def evaluate(self, question: EvaluationInput) -> Evaluation:
        """Answer what the service would say to one snapshot, without touching the monitor's own state.

        Raises:
            InputError: The question has values that no service would accept.
        """
        if self._evaluator is None:
            self._evaluator = Evaluator(self.robot, self.profile, self.period_s)
        return self._evaluator.evaluate(question)

    def _status(self, name: str, inputs: Inputs) -> SourceStatus:
        received = getattr(inputs, name)
        config = getattr(self.robot.config.file.sources, name)
        age = None if received.value is None else received.age_s
        return classify(name, config, age_s=age, invalid=received.invalid)

    def _perceive(self, inputs: Inputs, fresh: set[str]) -> tuple[Kinematics | None, Seen]:
        """Return the frames now and what the fresh sources see; nothing without fresh joints."""
        if "joints" not in fresh or inputs.joints.value is None:
            return None, Seen()
        position = inputs.joints.value.position
        kinematics = self.robot.kinematics(position)
        ranges, obstacles = inputs.ranges.value, inputs.obstacles.value
        reading, exact, comparison, pairs = None, None, None, None
        if "ranges" in fresh and ranges is not None and self.robot.rings:
            reading = self.range_reader.read(ranges, position, kinematics, tracked="obstacles" in fresh)
        if "obstacles" in fresh and obstacles is not None:
            if obstacles is not self._obstacles:
                self._distance.set_obstacles(obstacles)
                self._obstacles = obstacles
            if self._separation is not None:
                pairs = self._distance.pairs(position)
                exact = self._distance.nearest_of(pairs)
            else:
                exact = self._distance.nearest(position)
            if reading is not None:
                comparison = self._compare(reading, exact, (ranges, obstacles))
        things = [None if reading is None else reading.nearest, nearest_by_obstacles(exact)]
        return kinematics, Seen(
            things=[thing for thing in things if thing is not None],
            reading=reading,
            comparison=comparison,
            pairs=pairs,
        )

    def _separate(
        self,
        inputs: Inputs,
        fresh: set[str],
        kinematics: Kinematics | None,
        seen: Seen,
    ) -> Separated | None:
        """Return every pair's separation, of what is fresh; ``None`` without one, or without fresh joints."""
        if self._separation is None or kinematics is None or inputs.joints.value is None:
            return None
        sight = Sight(
            kinematics=kinematics,
            velocity=inputs.joints.value.velocity,
            pairs=seen.pairs,
            obstacles=self._obstacles,
            reading=seen.reading,
            reactions=reaction_times(self.robot, inputs, fresh, self.period_s),
        )
        return self._separation.step(sight, self._distance)

    def _hold(self, kinematics: Kinematics | None, separated: Separated | None) -> Least[Limit]:
        """Return the least share of the ticks that a milder zone takes, and what limited it.

        Without a separation it is 1; while nobody knows where the robot is, 0.
        """
        if self._separation is None:
            return Least(share=1.0, cause=None)
        if separated is None:
            return self._least.step(Least(share=0.0, cause=None))
        pair = separated.limiting if separated.scaling < 1.0 else None
        cause = None if pair is None else separated.limit_of(pair)
        return self._least.step(Least(share=separated.scaling, cause=cause))

    def _compare(
        self,
        reading: RangeReading,
        exact: ClosestPair | None,
        newest: tuple[object, object],
    ) -> Comparison:
        """Return the comparison as of the newest scan and the newest obstacles."""
        ranges, obstacles = newest
        if self._comparison is None or ranges is not self._compared[0] or obstacles is not self._compared[1]:
            link = self.range_reader.link if reading.nearest is None else reading.nearest.link
            monitored = link in self.robot.monitored_links
            distance = None
            if exact is not None and monitored:
                distance = exact.distance if exact.link == link else self._distance.distance_from(link)
            config = self.profile.config
            self._compared = newest
            self._comparison = compare(
                reading,
                distance,
                link,
                config.range_estimator,
                config.disagree_margin_m if monitored else None,
            )
        return self._comparison

    def _beside_perception(self, now: Assessment, inputs: Inputs) -> Zone:
        """Return the zone of what is no perception: late ticks, a second service, a network that erred.

        A tick that came late was still within ``valid_for_s`` at every consumer, so it makes the zone at
        least yellow; one that came later than that has stopped them already, and the zone says the same.
        """
        zone = Zone.GREEN
        if inputs.latched:
            now.reasons.append("latched")
            zone = Zone.STOP
        if inputs.duplicate:
            now.reasons.append("duplicate:service")
            zone = Zone.STOP
        if inputs.overrun_s > 0.0:
            now.reasons.append("overrun")
            zone = max(zone, Zone.STOP if inputs.overrun_s > self.valid_for_s else Zone.YELLOW)
        return zone

    def _implausible(
        self,
        now: Assessment,
        inputs: Inputs,
        fresh: set[str],
        kinematics: Kinematics | None,
    ) -> Zone:
        """Return a stop where the inputs are in due form and cannot be true."""
        if self._plausibility is None:
            return Zone.GREEN
        words = self._plausibility.step(inputs, fresh, self._commander.previous, kinematics)
        now.reasons.extend(words)
        return Zone.STOP if words else Zone.GREEN

    def _snapshot(
        self,
        inputs: Inputs,
        fresh: set[str],
        kinematics: Kinematics | None,
        seen: Seen,
        now: Assessment,
    ) -> Snapshot | None:
        """Return what a command can be made from; ``None`` without a target or without fresh joints."""
        joints, target = inputs.joints.value, inputs.target.value
        if kinematics is None or joints is None or target is None:
            return None
        return Snapshot(
            kinematics=kinematics,
            joints=joints,
            target=target,
            nearest=now.nearest,
            echo=None if seen.reading is None else seen.reading.nearest_other,
            ranges=None if seen.reading is None else seen.reading.others,
            obstacles=self._obstacles if "obstacles" in fresh else (),
        )

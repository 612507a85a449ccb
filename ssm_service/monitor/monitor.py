"""The monitor: one tick, values in, one decision out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..config import ProfileConfig
from ..errors import ConfigError, listed, suggestion
from ..model import ClosestPair, DistanceModel, Kinematics, Obstacle, Robot
from ..motion import sensor_steps
from ..safety import SourceState, SourceStatus, Zone, ZoneMachine, ZoneProfile, classify
from .assess import Assessment, Seen, assess, compare, nearest_by_obstacles
from .command import limited_velocity, wanted_velocity, zone_speed_limit
from .decision import Comparison, Decision
from .evaluate import Evaluation, EvaluationInput, Evaluator
from .inputs import Inputs
from .ranges import RangeReader, RangeReading

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
    only the zone in force (for slow recovery), the last command (for the acceleration limit) and what it
    made of the newest scan and the newest obstacles.

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
        self._machine = ZoneMachine(self.profile.config.recovery_ticks)
        self._distance = DistanceModel(robot)
        self.range_reader = RangeReader(robot, self.profile)
        self._obstacles: tuple[Obstacle, ...] = ()
        self._compared: tuple[object, object] = (None, None)
        self._comparison: Comparison | None = None
        self._evaluator: Evaluator | None = None
        self._steps = sensor_steps([ring.count for ring in robot.rings])
        self._velocity = np.zeros(len(robot.joint_names))
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
        kinematics, seen = self._perceive(inputs, statuses)
        sources = self.robot.config.file.sources
        now = assess(self.profile, sources, tuple(statuses.values()), seen)
        momentary = self._beside_perception(now, inputs)
        zone = self._machine.step(momentary)
        if zone > momentary:
            now.reasons.append("recovering")
        limit = zone_speed_limit(self.robot, self.profile, zone)
        velocity = self._command(inputs, statuses["target"], kinematics, now, limit, zone)
        return Decision(
            tick=self._tick,
            zone=zone,
            momentary_zone=momentary,
            distance=None if now.nearest is None else now.nearest.distance,
            nearest=now.nearest,
            sources=now.sources,
            comparison=now.comparison,
            speed_limit=limit,
            speed_scaling=self.profile.speed_scaling(zone),
            velocity=velocity,
            reasons=tuple(now.reasons),
            position=None
            if kinematics is None or inputs.joints.value is None
            else inputs.joints.value.position,
        )

    def evaluate(self, question: EvaluationInput) -> Evaluation:
        """Answer what the service would say to one snapshot, without touching the monitor's own state.

        Raises:
            InputError: The question has values that no service would accept.
        """
        if self._evaluator is None:
            self._evaluator = Evaluator(self.robot, self.profile)
        return self._evaluator.evaluate(question)

    def _status(self, name: str, inputs: Inputs) -> SourceStatus:
        received = getattr(inputs, name)
        config = getattr(self.robot.config.file.sources, name)
        age = None if received.value is None else received.age_s
        return classify(name, config, age_s=age, invalid=received.invalid)

    def _perceive(self, inputs: Inputs, statuses: dict[str, SourceStatus]) -> tuple[Kinematics | None, Seen]:
        """Return the frames now and what the fresh sources see; nothing without fresh joints."""
        fresh = {name for name, status in statuses.items() if status.state is SourceState.FRESH}
        if "joints" not in fresh or inputs.joints.value is None:
            return None, Seen()
        position = inputs.joints.value.position
        kinematics = self.robot.kinematics(position)
        ranges, obstacles = inputs.ranges.value, inputs.obstacles.value
        reading, exact, comparison = None, None, None
        if "ranges" in fresh and ranges is not None and self.robot.rings:
            reading = self.range_reader.read(ranges, position, kinematics, tracked="obstacles" in fresh)
        if "obstacles" in fresh and obstacles is not None:
            if obstacles is not self._obstacles:
                self._distance.set_obstacles(obstacles)
                self._obstacles = obstacles
            exact = self._distance.nearest(position)
            if reading is not None:
                comparison = self._compare(reading, exact, (ranges, obstacles))
        things = [None if reading is None else reading.nearest, nearest_by_obstacles(exact)]
        return kinematics, Seen(
            things=[thing for thing in things if thing is not None], reading=reading, comparison=comparison
        )

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
        """Return the zone after what is no perception: late ticks and a second service.

        A tick that came late was still within ``valid_for_s`` at every consumer, so it makes the zone at
        least yellow; one that came later than that has stopped them already, and the zone says the same.
        """
        zone = now.zone
        if inputs.duplicate:
            now.reasons.append("duplicate:service")
            zone = Zone.STOP
        if inputs.overrun_s > 0.0:
            now.reasons.append("overrun")
            zone = max(zone, Zone.STOP if inputs.overrun_s > self.valid_for_s else Zone.YELLOW)
        return zone

    def _command(
        self,
        inputs: Inputs,
        target: SourceStatus,
        kinematics: Kinematics | None,
        now: Assessment,
        limit: NDArray[np.float64],
        zone: Zone,
    ) -> NDArray[np.float64]:
        wanted = np.zeros(len(limit))
        if target.reason is not None:
            now.reasons.append(target.reason)
        elif kinematics is not None and inputs.target.value is not None and zone is not Zone.STOP:
            ranges = inputs.ranges.value if now.sources["ranges"].status.state is SourceState.FRESH else None
            wanted = wanted_velocity(
                self.robot, kinematics, inputs.target.value, now.nearest, ranges, self._steps
            )
        if zone is Zone.STOP or kinematics is None or inputs.joints.value is None:
            self._velocity = np.zeros(len(limit))
        else:
            self._velocity = limited_velocity(
                self.robot,
                wanted,
                previous=self._velocity,
                position=inputs.joints.value.position,
                speed_limit=limit,
                period_s=self.period_s,
            )
        return self._velocity

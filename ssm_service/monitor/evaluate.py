"""One snapshot, every pair exact: what would the service say?"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..config import SourcesConfig
from ..model import ClosestPair, DistanceModel, Kinematics, Obstacle, Pairs, Robot
from ..perception import RingEstimates
from ..safety import SeparationTerms, SourceState, SourceStatus, Zone, ZoneProfile
from .assess import Assessment, Seen, assess, compare, nearest_by_obstacles
from .command import zone_speed_limit
from .commander import Commander
from .estimates import Estimators
from .inputs import JointSample, Target
from .ranges import RangeReader, RangeReading
from .reaction import configured_reaction
from .separated import Separated
from .separation import SeparationStep, Sight
from .snapshot import Keeping, Snapshot

EVALUATION_PERIOD_S = 0.002
"""The tick [s] that an evaluated command is meant for, where nobody says."""


class EvaluationInput(Struct, frozen=True, kw_only=True, eq=False):
    """One question; a source that is ``None`` counts as not configured.

    Attributes:
        joints: Joint state.
        velocity_known: Whether ``joints.velocity`` was given, not assumed to be 0.
        ranges: (m,), [m], ``inf`` for no echo.
        obstacles: Obstacles; an empty tuple means 'seen, and nothing there'.
        target: Wanted motion.
    """

    joints: JointSample
    velocity_known: bool = False
    ranges: NDArray[np.float64] | None = None
    obstacles: tuple[Obstacle, ...] | None = None
    target: Target | None = None


class EvaluatedPair(Struct, frozen=True, kw_only=True, eq=False):
    """A link and an obstacle.

    Attributes:
        pair: Exact distance, points and normal.
        closing_speed: [m/s] of the link's nearest point towards the obstacle, negative in retreat; ``None``
            where the joint velocities are not known.
        max_closing_speed: [m/s] at which S_p is the distance; ``None`` where the profile has no separation.
        separation: The terms of S_p at the closing speed, or at standstill where that is not known; ``None``
            where the profile has no separation.
    """

    pair: ClosestPair
    closing_speed: float | None
    max_closing_speed: float | None = None
    separation: SeparationTerms | None = None


class Evaluation(Struct, frozen=True, kw_only=True, eq=False):
    """What the service would say: the zone of this snapshot alone, without recovery.

    Attributes:
        zone: The zone.
        distance: [m] the least over the sources given; ``None`` where nothing was seen.
        speed_limit: (n,), [rad/s].
        speed_scaling: 0 to 1.
        reasons: Fixed words.
        pairs: Every monitored link with every obstacle.
        estimates: The estimates of the ring that is nearest to something; ``None`` without readings.
        kinematics: Frames and Jacobians.
        velocity: (n,), [rad/s], the command at steady state, that is without the acceleration limit; ``None``
            without a target.
        separation: What the profile's separation makes of the snapshot, as a tick would, with the configured
            reaction time, as nothing has an age here; ``None`` without one.
    """

    zone: Zone
    distance: float | None
    speed_limit: NDArray[np.float64]
    speed_scaling: float
    reasons: tuple[str, ...]
    pairs: tuple[EvaluatedPair, ...]
    estimates: RingEstimates | None
    kinematics: Kinematics
    velocity: NDArray[np.float64] | None
    separation: Separated | None = None


class Evaluator:
    """Answers questions about one robot under one profile; keeps nothing between them.

    Args:
        robot: The robot.
        profile: The zone profile.
        period_s: The tick that a command is meant for [s]: a part of the reaction time, and a bound of the
            last step before a joint limit.
    """

    def __init__(self, robot: Robot, profile: ZoneProfile, period_s: float = EVALUATION_PERIOD_S) -> None:
        self._robot = robot
        self._profile = profile
        self._period_s = period_s
        self._distance = DistanceModel(robot)
        self._separation = None
        if profile.config.separation is not None:
            self._separation = SeparationStep(robot, profile, profile.config.separation)
        self._reader: RangeReader | None = None
        self._estimators: Estimators | None = None

    def prepare(self) -> None:
        """Do now what the first question with readings would have to wait for."""
        self._ring_parts()

    def fill(self) -> None:
        """Make tables that make the answers quicker; questions may be answered meanwhile."""
        self._ring_parts()[1].fill()

    def evaluate(self, question: EvaluationInput) -> Evaluation:
        """Answer one question."""
        robot, profile = self._robot, self._profile
        kinematics = robot.kinematics(question.joints.position)
        pairs = self._pairs(question, kinematics)
        seen = self._seen(question, [entry.pair for entry in pairs], kinematics)
        separated = self._separate(question, kinematics, seen.reading)
        now = assess(
            profile,
            robot.config.file.sources,
            self._statuses(question, robot.config.file.sources),
            seen,
            Zone.GREEN if separated is None else separated.zone,
        )
        share = 1.0 if separated is None else separated.scaling
        share = 0.0 if now.zone is Zone.STOP else share
        limit = zone_speed_limit(robot, profile, now.beside)
        return Evaluation(
            zone=now.zone,
            distance=None if now.nearest is None else now.nearest.distance,
            speed_limit=np.minimum(limit, share * robot.velocity_limit),
            speed_scaling=min(profile.speed_scaling(now.beside), share),
            reasons=tuple(now.reasons),
            pairs=pairs,
            estimates=None
            if question.ranges is None or not robot.rings
            else self._ring_parts()[1].of(question.ranges, kinematics),
            kinematics=kinematics,
            velocity=self._velocity(question, kinematics, now, seen, limit, separated),
            separation=separated,
        )

    def _ring_parts(self) -> tuple[RangeReader, Estimators]:
        """Return what reads the rings; its tables take some seconds, so they are made when first needed."""
        if self._reader is None or self._estimators is None:
            self._reader = RangeReader(self._robot, self._profile, self._period_s)
            self._estimators = Estimators(self._robot)
        return self._reader, self._estimators

    def _seen(self, question: EvaluationInput, pairs: list[ClosestPair], kinematics: Kinematics) -> Seen:
        closest = min(pairs, key=lambda pair: pair.distance, default=None)
        things = [nearest_by_obstacles(closest)]
        reading, comparison = None, None
        if question.ranges is not None and self._robot.rings:
            reader, _ = self._ring_parts()
            # A copy, since readings are known again by identity, and a question's may be reused.
            reading = reader.read(
                question.ranges.copy(),
                question.joints.position,
                kinematics,
                tracked=question.obstacles is not None,
            )
            things.append(reading.nearest)
            if question.obstacles is not None:
                link = reader.link if reading.nearest is None else reading.nearest.link
                exact = [pair.distance for pair in pairs if pair.link == link]
                config, monitored = self._profile.config, link in self._robot.monitored_links
                comparison = compare(
                    reading,
                    min(exact, default=None),
                    link,
                    config.range_estimator,
                    config.disagree_margin_m if monitored else None,
                )
        return Seen(
            things=[thing for thing in things if thing is not None], reading=reading, comparison=comparison
        )

    def _statuses(self, question: EvaluationInput, sources: SourcesConfig) -> list[SourceStatus]:
        """Return fresh states for what is given; with no perception at all, what the file requires waits."""

        def status_of(name: str, state: SourceState) -> SourceStatus:
            """Return a status whose value, if there is one, was made just now."""
            return SourceStatus(name=name, state=state, age_s=0.0 if state is SourceState.FRESH else None)

        given = {"ranges": question.ranges is not None, "obstacles": question.obstacles is not None}
        statuses = [status_of("joints", SourceState.FRESH)]
        statuses += [status_of(name, SourceState.FRESH) for name, there in given.items() if there]
        if not any(given.values()):
            required = [name for name in given if getattr(sources, name).required]
            statuses += [status_of(name, SourceState.ABSENT) for name in required]
        return statuses

    def _separate(
        self, question: EvaluationInput, kinematics: Kinematics, reading: RangeReading | None
    ) -> Separated | None:
        """Return what a tick would make of the same, which measures pairs by the hulls where that will do."""
        if self._separation is None:
            return None
        pairs = None
        if question.obstacles is not None:
            pairs = self._distance.pairs(question.joints.position)
        return self._separation.step(self._sight(question, kinematics, pairs, reading), self._distance)

    def _sight(
        self,
        question: EvaluationInput,
        kinematics: Kinematics,
        pairs: Pairs | None,
        reading: RangeReading | None = None,
    ) -> Sight:
        times = [("ranges", question.ranges), ("obstacles", question.obstacles)]
        return Sight(
            kinematics=kinematics,
            velocity=question.joints.velocity,
            pairs=pairs,
            obstacles=question.obstacles or (),
            reading=reading,
            reactions={
                name: configured_reaction(self._robot, name, self._period_s)
                for name, given in times
                if given is not None
            },
        )

    def _pairs(self, question: EvaluationInput, kinematics: Kinematics) -> tuple[EvaluatedPair, ...]:
        if question.obstacles is None:
            return ()
        self._distance.set_obstacles(question.obstacles)
        joints = question.joints
        closest = self._distance.all_pairs(joints.position)
        separated = None
        if self._separation is not None:
            every = Pairs.of(closest, self._robot.monitored_links, self._distance.obstacle_ids)
            separated = self._separation.of_pairs(self._sight(question, kinematics, every))
        result = []
        for index, pair in enumerate(closest):
            speed = None
            if question.velocity_known:
                velocity = self._robot.point_velocity(
                    joints.position, joints.velocity, pair.link, pair.point_on_link
                )
                speed = -float(pair.normal @ velocity)
            result.append(
                EvaluatedPair(
                    pair=pair,
                    closing_speed=speed,
                    max_closing_speed=None
                    if separated is None
                    else float(separated.max_closing_speed[index]),
                    separation=None if separated is None else separated.terms(index),
                )
            )
        return tuple(result)

    def _velocity(
        self,
        question: EvaluationInput,
        kinematics: Kinematics,
        now: Assessment,
        seen: Seen,
        limit: NDArray[np.float64],
        separated: Separated | None,
    ) -> NDArray[np.float64] | None:
        if question.target is None:
            return None
        if now.zone is Zone.STOP:
            return np.zeros(len(limit))
        commander = Commander(self._robot, self._period_s)
        snapshot = Snapshot(
            kinematics=kinematics,
            joints=question.joints,
            target=question.target,
            nearest=now.nearest,
            echo=None if seen.reading is None else seen.reading.nearest_other,
            ranges=None if seen.reading is None else seen.reading.others,
            obstacles=question.obstacles or (),
        )
        limits = [] if separated is None else [separated.limit]
        keeping = Keeping(speed_limit=limit, limits=limits, separation=self._separation)
        return commander.step(snapshot, keeping, self._distance, settled=True)

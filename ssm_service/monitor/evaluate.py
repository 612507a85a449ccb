"""One snapshot, every pair exact: what would the service say?"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..config import SourcesConfig
from ..model import ClosestPair, DistanceModel, Kinematics, Obstacle, Robot
from ..motion import sensor_steps
from ..perception import RingEstimates
from ..safety import SourceState, SourceStatus, Zone, ZoneProfile
from .assess import Assessment, Seen, assess, compare, nearest_by_obstacles
from .command import limited_velocity, wanted_velocity, zone_speed_limit
from .estimates import Estimators
from .inputs import JointSample, Target
from .ranges import RangeReader


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
    """

    pair: ClosestPair
    closing_speed: float | None


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


class Evaluator:
    """Answers questions about one robot under one profile; keeps nothing between them.

    Args:
        robot: The robot.
        profile: The zone profile.
    """

    def __init__(self, robot: Robot, profile: ZoneProfile) -> None:
        self._robot = robot
        self._profile = profile
        self._distance = DistanceModel(robot)
        self._reader: RangeReader | None = None
        self._estimators: Estimators | None = None
        self._steps = sensor_steps([ring.count for ring in robot.rings])

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
        pairs = self._pairs(question)
        now = assess(
            profile,
            robot.config.file.sources,
            self._statuses(question, robot.config.file.sources),
            self._seen(question, [entry.pair for entry in pairs], kinematics),
        )
        limit = zone_speed_limit(robot, profile, now.zone)
        return Evaluation(
            zone=now.zone,
            distance=None if now.nearest is None else now.nearest.distance,
            speed_limit=limit,
            speed_scaling=profile.speed_scaling(now.zone),
            reasons=tuple(now.reasons),
            pairs=pairs,
            estimates=None
            if question.ranges is None or not robot.rings
            else self._ring_parts()[1].of(question.ranges, kinematics),
            kinematics=kinematics,
            velocity=self._velocity(question, kinematics, now, limit),
        )

    def _ring_parts(self) -> tuple[RangeReader, Estimators]:
        """Return what reads the rings; its tables take some seconds, so they are made when first needed."""
        if self._reader is None or self._estimators is None:
            self._reader = RangeReader(self._robot, self._profile)
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
            return SourceStatus(name=name, state=state, age_s=0.0 if state is SourceState.FRESH else None)

        given = {"ranges": question.ranges is not None, "obstacles": question.obstacles is not None}
        statuses = [status_of("joints", SourceState.FRESH)]
        statuses += [status_of(name, SourceState.FRESH) for name, there in given.items() if there]
        if not any(given.values()):
            required = [name for name in given if getattr(sources, name).required]
            statuses += [status_of(name, SourceState.ABSENT) for name in required]
        return statuses

    def _pairs(self, question: EvaluationInput) -> tuple[EvaluatedPair, ...]:
        if question.obstacles is None:
            return ()
        self._distance.set_obstacles(question.obstacles)
        joints = question.joints
        result = []
        for pair in self._distance.all_pairs(joints.position):
            speed = None
            if question.velocity_known:
                velocity = self._robot.point_velocity(
                    joints.position, joints.velocity, pair.link, pair.point_on_link
                )
                speed = -float(pair.normal @ velocity)
            result.append(EvaluatedPair(pair=pair, closing_speed=speed))
        return tuple(result)

    def _velocity(
        self,
        question: EvaluationInput,
        kinematics: Kinematics,
        now: Assessment,
        limit: NDArray[np.float64],
    ) -> NDArray[np.float64] | None:
        if question.target is None:
            return None
        if now.zone is Zone.STOP:
            return np.zeros(len(limit))
        robot = self._robot
        wanted = wanted_velocity(
            robot, kinematics, question.target, now.nearest, question.ranges, self._steps
        )
        return limited_velocity(
            robot,
            wanted,
            previous=wanted,  # as if it had been reached: the acceleration limit does not bind
            position=question.joints.position,
            speed_limit=limit,
            period_s=EVALUATION_PERIOD_S,
        )


EVALUATION_PERIOD_S = 0.002
"""The tick [s] that an evaluated command is meant for; it only bounds the last step before a joint limit."""

"""Between messages and the values of the rooms below, in both directions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model import Obstacle, Robot
from ..monitor import (
    Comparison,
    Decision,
    Evaluation,
    EvaluationInput,
    JointSample,
    Nearest,
    Separated,
    checked_target,
    joint_sample,
    range_scan,
)
from ..monitor import Target as MonitorTarget
from ..perception import Estimate, RingEstimates
from ..safety import SeparationTerms
from . import messages as m


def joints_value(robot: Robot, message: m.JointState) -> JointSample:
    """Return a joint state in the robot's order.

    Raises:
        InputError: See ``monitor.joint_sample``.
    """
    return joint_sample(robot, message.position, message.velocity, message.name)


def ranges_value(robot: Robot, message: m.Ranges) -> NDArray[np.float64]:
    """Return readings (m,) [m] with ``inf`` for no echo.

    Raises:
        InputError: See ``monitor.range_scan``.
    """
    return range_scan(robot, message.ranges)


def obstacles_value(_robot: Robot, message: m.Obstacles) -> tuple[Obstacle, ...]:
    """Return the obstacles.

    Raises:
        InputError: See ``model.Obstacle``; ``repeated_id`` where two share an id.
    """
    return obstacles_from(message.obstacles)


def target_value(robot: Robot, message: m.Target) -> MonitorTarget:
    """Return the target.

    Raises:
        InputError: See ``monitor.checked_target``.
    """
    return checked_target(robot, message.kind, message.value, message.controller)


VALUES = {
    "joints": joints_value,
    "ranges": ranges_value,
    "obstacles": obstacles_value,
    "target": target_value,
}
"""How each input message becomes a value."""


def obstacles_from(entries: list[m.ObstacleEntry]) -> tuple[Obstacle, ...]:
    """Return obstacles; an error names the entry.

    Raises:
        InputError: As for ``obstacles_value``.
    """
    obstacles = []
    for index, entry in enumerate(entries):
        try:
            obstacles.append(
                Obstacle(
                    id=entry.id,
                    shape=entry.shape,
                    size=tuple(entry.size),
                    position=entry.position,
                    quaternion_xyzw=entry.quaternion_xyzw,
                    velocity=entry.velocity,
                )
            )
        except InputError as error:
            where = f"obstacles[{index}].{error.where}"
            raise InputError(error.cause, where, error.found, error.allowed) from error
    if len({entry.id for entry in entries}) != len(entries):
        raise InputError("repeated_id", "obstacles", [entry.id for entry in entries], "each id once")
    return tuple(obstacles)


def zone_message(
    decision: Decision,
    *,
    producer: str,
    stamp_ns: int,
    valid_for_ns: int,
    robot: str,
    profile: str,
    name: list[str],
) -> m.Zone:
    """Return a decision's ``Zone``; ``seq`` is the tick."""
    return m.Zone(
        producer=producer,
        seq=decision.tick,
        stamp_ns=stamp_ns,
        valid_for_ns=valid_for_ns,
        robot=robot,
        profile=profile,
        zone=decision.zone.word,  # type: ignore[arg-type]
        distance=decision.distance,
        name=name,
        speed_limit=decision.speed_limit.tolist(),
        speed_scaling=decision.speed_scaling,
        nearest=None if decision.nearest is None else _nearest_entry(decision.nearest),
        sources={
            key: m.SourceEntry(
                state=report.status.state.value,
                required=report.required,
                age_s=report.status.age_s,
                distance=report.distance,
            )
            for key, report in decision.sources.items()
        },
        comparison=None if decision.comparison is None else _comparison_entry(decision.comparison),
        reaction=_reaction_terms(decision.separation),
        limiting=_limiting_entry(decision.separation),
        reasons=list(decision.reasons),
    )


def command_message(
    decision: Decision, *, producer: str, stamp_ns: int, valid_for_ns: int, robot: str, name: list[str]
) -> m.VelocityCommand:
    """Return a decision's ``VelocityCommand``; ``seq`` is the tick."""
    return m.VelocityCommand(
        producer=producer,
        seq=decision.tick,
        stamp_ns=stamp_ns,
        valid_for_ns=valid_for_ns,
        robot=robot,
        zone=decision.zone.word,  # type: ignore[arg-type]
        name=name,
        velocity=decision.velocity.tolist(),
    )


def separation_message(
    decision: Decision,
    pairs: list[m.SeparationPair],
    *,
    producer: str,
    stamp_ns: int,
    robot: str,
    profile: str,
) -> m.Separation:
    """Return a decision's ``Separation`` with what ``separation_pairs`` gave; ``seq`` is the tick."""
    separated = decision.separation
    return m.Separation(
        producer=producer,
        seq=decision.tick,
        stamp_ns=stamp_ns,
        robot=robot,
        profile=profile,
        reaction={}
        if separated is None
        else {source: time.terms() for source, time in separated.reactions.items()},
        pairs=pairs,
    )


def separation_pairs(separated: Separated, pairs: range) -> list[m.SeparationPair]:
    """Return some of a tick's pairs as messages."""
    return [_separation_pair(separated, pair) for pair in pairs]


def question_from(robot: Robot, message: m.EvaluateInput) -> EvaluationInput:
    """Return an ``evaluate`` input as values.

    Raises:
        InputError: One of the values is not acceptable.
    """
    asked = message.target
    target = None if asked is None else checked_target(robot, asked.kind, asked.value, asked.controller)
    return EvaluationInput(
        joints=joint_sample(robot, message.position, message.velocity, message.name),
        velocity_known=message.velocity is not None,
        ranges=None if message.ranges is None else range_scan(robot, message.ranges),
        obstacles=None if message.obstacles is None else obstacles_from(message.obstacles),
        target=target,
    )


def evaluate_message(evaluation: Evaluation) -> m.EvaluateOutput:
    """Return an evaluation as its message."""
    kinematics = evaluation.kinematics
    return m.EvaluateOutput(
        zone=evaluation.zone.word,  # type: ignore[arg-type]
        distance=evaluation.distance,
        speed_limit=evaluation.speed_limit.tolist(),
        speed_scaling=evaluation.speed_scaling,
        reasons=list(evaluation.reasons),
        pairs=[
            m.PairEntry(
                link=entry.pair.link,
                obstacle=entry.pair.obstacle,
                distance=entry.pair.distance,
                point_on_link=vector(entry.pair.point_on_link),
                point_on_obstacle=vector(entry.pair.point_on_obstacle),
                normal=vector(entry.pair.normal),
                closing_speed=entry.closing_speed,
                max_closing_speed=entry.max_closing_speed,
                separation=None if entry.separation is None else _terms(entry.separation),
            )
            for entry in evaluation.pairs
        ],
        estimates=None if evaluation.estimates is None else _estimates_entry(evaluation.estimates),
        frames=m.FramesEntry(
            sensors=kinematics.transform_sensors_to_base.tolist(),
            end_effector=kinematics.transform_end_effector_to_base.tolist(),
        ),
        jacobian=kinematics.jacobian.tolist(),
        command=None
        if evaluation.velocity is None
        else m.CommandEntry(velocity=evaluation.velocity.tolist()),
    )


def frames_message(robot: Robot, name: str, position: NDArray[np.float64]) -> m.FramesReply:
    """Return all frames of a configuration, position (n,) [rad or m], as a message."""
    kinematics = robot.kinematics(position)
    return m.FramesReply(
        robot=name,
        name=list(robot.joint_names),
        position=position.tolist(),
        sensors=kinematics.transform_sensors_to_base.tolist(),
        end_effector=kinematics.transform_end_effector_to_base.tolist(),
        links={link: T.tolist() for link, T in robot.link_transforms(position).items()},
        jacobian=kinematics.jacobian.tolist(),
    )


def vector(values: NDArray[np.float64]) -> m.Vector3:
    """Return three numbers as a tuple."""
    x, y, z = values.tolist()
    return x, y, z


def optional_readings(ranges: NDArray[np.float64]) -> list[float | None]:
    """Return readings for the wire: ``inf`` becomes ``None``.

    Raises:
        InputError: ``not_finite`` for a reading that is no number, which must not become 'no echo'.
    """
    readings = ranges.tolist()
    for index, reading in enumerate(readings):
        if math.isnan(reading):
            raise InputError("not_finite", f"ranges[{index}]", reading, "a number, or inf for no echo")
    return [reading if math.isfinite(reading) else None for reading in readings]


def _nearest_entry(nearest: Nearest) -> m.NearestEntry:
    return m.NearestEntry(
        source=nearest.source,
        link=nearest.link,
        obstacle=nearest.obstacle,
        distance=nearest.distance,
        point_on_link=vector(nearest.point_on_link),
        point_on_obstacle=vector(nearest.point_on_obstacle),
        normal=vector(nearest.normal),
    )


def _reaction_terms(separated: Separated | None) -> dict[str, float] | None:
    reaction = None if separated is None else separated.reaction
    return None if reaction is None else reaction.terms()


def _limiting_entry(separated: Separated | None) -> m.LimitingEntry | None:
    if separated is None or separated.limiting is None:
        return None
    pair = separated.limiting
    return m.LimitingEntry(
        source=separated.source(pair),
        link=separated.link(pair),
        obstacle=separated.obstacle(pair),
        distance=_finite(separated.table.distance[pair]),
        closing_speed=float(separated.closing_speed[pair]),
        max_closing_speed=float(separated.max_closing_speed[pair]),
        separation=_terms(separated.terms(pair)),
    )


def _separation_pair(separated: Separated, pair: int) -> m.SeparationPair:
    table = separated.table
    return m.SeparationPair(
        source=separated.source(pair),
        link=separated.link(pair),
        obstacle=separated.obstacle(pair),
        distance=_finite(table.distance[pair]),
        exact=bool(table.exact[pair]),
        point_on_link=vector(table.point_on_link[pair]),
        point_on_obstacle=vector(table.point_on_obstacle[pair]),
        normal=vector(table.normal[pair]),
        human_speed=float(table.human_speed[pair]),
        closing_speed=float(separated.closing_speed[pair]),
        max_closing_speed=float(separated.max_closing_speed[pair]),
        reaction_time=float(table.reaction_time[pair]),
        stopping_time=separated.stopping_time,
        separation=_terms(separated.terms(pair)),
    )


def _terms(terms: SeparationTerms) -> dict[str, float]:
    return {
        "S_p": terms.S_p,
        "S_h": terms.S_h,
        "S_r": terms.S_r,
        "S_s": terms.S_s,
        "C": terms.C,
        "Z_d": terms.Z_d,
        "Z_r": terms.Z_r,
    }


def _finite(distance: float) -> float:
    """Return a distance for the wire: one that Coal failed at is contact, and no number of its own."""
    return float(distance) if math.isfinite(distance) else 0.0


def _comparison_entry(comparison: Comparison) -> m.ComparisonEntry:
    return m.ComparisonEntry(
        link=comparison.link,
        estimator=comparison.estimator,
        estimate=comparison.estimate,
        exact=comparison.exact,
        difference=comparison.difference,
    )


def _estimates_entry(estimates: RingEstimates) -> m.EstimatesEntry:
    return m.EstimatesEntry(
        as_printed=_estimate_entry(estimates.as_printed),
        corrected=_estimate_entry(estimates.corrected),
        nearest=_estimate_entry(estimates.nearest),
        sphere_fit=_estimate_entry(estimates.sphere_fit),
        lower_bound=_estimate_entry(estimates.lower_bound),
        reasons=dict(estimates.reasons),
    )


def _estimate_entry(estimate: Estimate | None) -> m.EstimateEntry | None:
    if estimate is None:
        return None
    return m.EstimateEntry(
        distance=estimate.distance,
        position=estimate.position,
        bearing=estimate.bearing,
        sensors=list(estimate.sensors),
        std=estimate.std,
    )

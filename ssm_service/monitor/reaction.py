"""The reaction time of what each source sees, measured where it can be and configured where it cannot."""

from __future__ import annotations

from typing import Any

from ..model import Robot
from ..safety import ReactionTime, StoppingLevels, ZoneProfile
from .inputs import Inputs, Received

_NOTHING: Received[Any] = Received(age_s=0.0)


def reaction_times(
    robot: Robot, inputs: Inputs, sources: set[str], period_s: float
) -> dict[str, ReactionTime]:
    """Return T_r by source of perception.

    Args:
        robot: The robot.
        inputs: What this tick knows; the ages of the source and of the joints count, the older of the two.
        sources: Those that are fresh.
        period_s: Time from tick to tick [s]; a tick that takes longer counts with its own time.
    """
    return {
        name: _reaction_time(
            robot,
            name,
            getattr(inputs, name),
            joints_age_s=inputs.joints.age_s or 0.0,
            tick_s=max(period_s, inputs.tick_s),
            transport_s=inputs.transport_s,
        )
        for name in ("ranges", "obstacles")
        if name in sources
    }


def configured_reaction(robot: Robot, source: str, period_s: float) -> ReactionTime:
    """Return T_r of a source whose values have no age, as far as it is configured.

    Args:
        robot: The robot.
        source: ``ranges`` or ``obstacles``.
        period_s: Time from tick to tick [s].
    """
    return _reaction_time(robot, source, _NOTHING, joints_age_s=0.0, tick_s=period_s, transport_s=0.0)


def standstill_distance(robot: Robot, profile: ZoneProfile, period_s: float) -> float:
    """Return what S_p is for the rings' links at standstill, with nothing but what is configured [m].

    Nearer than this a robot may not move at all. 0 where the profile has no separation.
    """
    config = profile.config.separation
    if config is None:
        return 0.0
    levels = stopping_levels(robot)
    reaction = configured_reaction(robot, "ranges", period_s).total
    accuracy = max((ring.accuracy for ring in robot.rings), default=0.0)
    fixed = config.intrusion_m + config.robot_uncertainty_m + max(config.human_uncertainty_m, accuracy)
    return fixed + config.human_speed_m_s * (reaction + float(levels.times[-1]))


def stopping_levels(robot: Robot) -> StoppingLevels:
    """Return the stopping levels of the joints that commands move."""
    return StoppingLevels.of(
        robot.config.file.stopping,
        [robot.joint_names[i] for i in robot.free],
        robot.velocity_limit[robot.free].tolist(),
    )


def _reaction_time(
    robot: Robot,
    source: str,
    received: Received[Any],
    *,
    joints_age_s: float,
    tick_s: float,
    transport_s: float,
) -> ReactionTime:
    file = robot.config.file
    periods = [getattr(file.sources, source).period_s, received.period_s]
    if source == "ranges":
        periods += [ring.period for ring in robot.rings]
    return ReactionTime.of(
        file.reaction,
        sensor_period_s=max(periods),
        input_age_s=max(received.age_s or 0.0, joints_age_s),
        tick_s=tick_s,
        transport_s=transport_s,
    )

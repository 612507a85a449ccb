"""Where a robot file is weaker than the protective separation distance, in numbers and words.

The same list stands in ``ssm check``, in what the service says at its start, and in ``health``. It is
computed from the robot file alone, at its best: fresh inputs, every term that nobody states taken as 0. A
running service can only be worse.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

from ..config import ProfileConfig
from ..model import Robot, SensorArray
from ..safety import WALKING_SPEED_M_S, SeparationLaw, StoppingLevels
from .reach import greatest_speed

DEFAULT_PERIOD_S: Final = 0.002
"""The default time from tick to tick [s]."""


class Weakness(NamedTuple):
    """One thing that one should know before relying on a profile.

    Attributes:
        key: The key or part of the robot file that it is about.
        text: What is weak, with its numbers.
    """

    key: str
    text: str

    def __str__(self) -> str:
        """Return both as one line."""
        return f"{self.key}: {self.text}"


def weaknesses(robot: Robot, profile: str, *, period_s: float = DEFAULT_PERIOD_S) -> tuple[Weakness, ...]:
    """Return what is weak about a robot under one of its profiles.

    Args:
        robot: The robot.
        profile: The name of the profile.
        period_s: Time from tick to tick [s].
    """
    config = robot.config.file.profiles[profile]
    return (
        *_zones(robot, profile, config, period_s),
        *_separation(profile, config),
        *_silence(robot, config, period_s),
        *_not_required(robot),
        *_unchecked(robot),
    )


def stopping(robot: Robot, joint_speed: float) -> tuple[float, float, list[str]]:
    """Return how the slowest free joint stops from a speed.

    Args:
        robot: The robot.
        joint_speed: Limit for every joint [rad/s or m/s], below which a joint's own may lie.

    Returns:
        Stopping time [s], stopping distance for each unit of speed [s], and the joints without data.
    """
    data = robot.config.file.stopping
    names = {robot.joint_names[index]: float(robot.velocity_limit[index]) for index in robot.free}
    unknown = [name for name in names if name not in data]
    known = [name for name in names if name in data]
    if not known:
        return 0.0, 0.0, unknown
    # Of what is faster than all data, the fastest is the best that can be said.
    limits = [min(joint_speed, names[name], data[name].speed_rad_s) for name in known]
    levels = StoppingLevels.of(data, known, limits)
    return float(levels.times[-1]), float(levels.gains[-1]), unknown


def best_law(robot: Robot, joint_speed: float, period_s: float) -> SeparationLaw:
    """Return the equation at its best for arms whose joints keep a speed limit.

    Of the required sources of perception it takes the one that demands least.

    Args:
        robot: The robot.
        joint_speed: [rad/s or m/s].
        period_s: Time from tick to tick [s].
    """
    file = robot.config.file
    time, gain, _ = stopping(robot, joint_speed)
    beside = period_s + file.reaction.transport_s + file.reaction.robot_s
    sources = []
    if file.sources.ranges.required:
        ring = max(file.rings, key=lambda ring: ring.period_s)
        sources.append((ring.period_s, max(ring.accuracy_m for ring in file.rings)))
    if file.sources.obstacles.required:
        sources.append((file.sources.obstacles.period_s, 0.0))
    laws = [
        SeparationLaw(
            reaction_time=period + beside,
            stopping_time=time,
            stopping_gain=gain,
            human_uncertainty=accuracy,
        )
        for period, accuracy in sources
    ]
    return min(laws, key=lambda law: law.terms(0.0).S_p)


def _terms_words(law: SeparationLaw) -> str:
    words = f"v_h = {law.human_speed:g} m/s, T_r = {law.reaction_time:g} s, T_s = {law.stopping_time:g} s"
    return words + (f", Z_d = {law.human_uncertainty:g} m" if law.human_uncertainty else "")


def _zones(robot: Robot, name: str, config: ProfileConfig, period_s: float) -> Iterator[Weakness]:
    """Hold each zone against the equation, at the least distance at which it still lets the arm move."""
    if config.red is None or config.yellow is None or config.separation is not None:
        return
    green = float(max(robot.velocity_limit[robot.free]))
    for zone, from_m, speed in (
        ("red", 0.0, config.red.joint_speed_rad_s),
        ("yellow", config.red.distance_m, config.yellow.joint_speed_rad_s),
        ("green", config.yellow.distance_m, green),
    ):
        law = best_law(robot, speed, period_s)
        fastest = greatest_speed(robot, speed)
        standing, moving = law.terms(0.0).S_p, law.terms(fastest).S_p
        if moving <= from_m:
            continue
        unknown = ", ".join(stopping(robot, speed)[2])
        yield Weakness(
            f"profiles.{name}" if zone == "green" else f"profiles.{name}.{zone}",
            f"{zone} lets joints move at {speed:g} rad/s from {from_m:g} m on, no point faster than "
            f"{fastest:.2f} m/s; the equation demands {standing:.3f} m of an arm that stands still and up to "
            f"{moving:.3f} m then ({_terms_words(law)})"
            + (f", and more by the stopping data that are not there: {unknown}" if unknown else ""),
        )


def _separation(name: str, config: ProfileConfig) -> Iterator[Weakness]:
    """Name what the equation is told that is milder than the standard's own figures."""
    law = config.separation
    if law is None:
        return
    key = f"profiles.{name}.separation"
    if law.human_speed_m_s < WALKING_SPEED_M_S:
        text = f"{law.human_speed_m_s:g} m/s: people walk at {WALKING_SPEED_M_S:g} m/s (ISO 13855)"
        yield Weakness(f"{key}.human_speed_m_s", text)
    if law.tracked_velocity:
        text = (
            f"true: who stands still now counts as coming at {law.human_speed_floor_m_s:g} m/s, "
            f"and may walk at {WALKING_SPEED_M_S:g} m/s a moment later"
        )
        yield Weakness(f"{key}.tracked_velocity", text)


def _silence(robot: Robot, config: ProfileConfig, period_s: float) -> Iterator[Weakness]:
    """Say what speed the sensors' silence justifies, and where it justifies nothing."""
    limit = float(max(robot.velocity_limit[robot.free]))
    fastest = greatest_speed(robot, limit)
    for array in robot.sensor_arrays:
        justified = silence_speed(robot, array, period_s)
        blind = max(
            0.0, 360.0 - sum(math.degrees(2.0 * ring.half_angle) * ring.count for ring in array.rings)
        )
        looked_for = robot.config.file.assumptions is not None and config.uncovered != "off"
        texts = []
        if justified < fastest:
            texts.append(
                f"no echo up to {min(array.ranges_max):g} m justifies a closing speed of "
                f"{justified:.2f} m/s at most, even where nothing is unseen; the joints' own limits "
                f"keep it below {fastest:.2f} m/s only"
            )
        if blind > 0.0 and not looked_for:
            texts.append(
                f"its cones see {360.0 - blind:g}° of 360°, and in the {blind:g}° between them silence "
                "promises nothing and counts as free: `ssm coverage`"
            )
        if texts:
            first = next(i for i, ring in enumerate(robot.rings) if ring is array.rings[0])
            yield Weakness(f"rings[{first}]", f"{array.link}: {'; '.join(texts)}")


def silence_speed(robot: Robot, array: SensorArray, period_s: float) -> float:
    """Return the greatest closing speed that silence of a link's sensors can justify [m/s].

    Args:
        robot: The robot.
        array: The link's sensors.
        period_s: Time from tick to tick [s].
    """
    reaction = robot.config.file.reaction
    time, gain, _ = stopping(robot, math.inf)
    law = SeparationLaw(
        reaction_time=max(r.period for r in array.rings) + period_s + reaction.transport_s + reaction.robot_s,
        stopping_time=time,
        stopping_gain=gain,
        human_uncertainty=max(ring.accuracy for ring in array.rings),
    )
    return law.greatest_speed(float(min(array.ranges_max)))


def _not_required(robot: Robot) -> Iterator[Weakness]:
    file = robot.config.file
    for name, other in (("ranges", "obstacles"), ("obstacles", "ranges")):
        if getattr(file.sources, name).required or (name == "ranges" and not file.rings):
            continue
        text = f"false: until its first message nobody misses it, and zones come from {other} alone"
        yield Weakness(f"sources.{name}.required", text)


def _unchecked(robot: Robot) -> Iterator[Weakness]:
    file = robot.config.file
    for name in ("joints", "ranges", "obstacles", "target"):
        if getattr(file.sources, name).integrity == "none" and (name != "ranges" or file.rings):
            text = "none: messages without a checksum are taken, and nobody notices one that was altered"
            yield Weakness(f"sources.{name}.integrity", text)

"""Robot files: how targets become joint velocities."""

from __future__ import annotations

from typing import Annotated, Literal

from .section import Section, described

ControllerName = Literal["field", "field3d", "clik-1", "clik-2", "clik-3", "filter"]


class ClikConfig(Section, frozen=True, kw_only=True):
    """Closed-loop inverse kinematics with a repulsive velocity ([Neri2023])."""

    repulsive_speed_m_s: Annotated[
        float,
        described("v_rep: speed of the link's nearest point away from it", "m/s", gt=0.0, le=10.0),
    ] = 1.0
    position_gain: Annotated[float, described("k_ep of the position error", "1/s", gt=0.0, le=1000.0)] = 1.0
    orientation_gain: Annotated[
        float, described("k_er of the orientation error", "1/s", gt=0.0, le=1000.0)
    ] = 0.16
    radius_min_m: Annotated[
        float, described("r_inf: within it a slow obstacle repels", "m", gt=0.0, le=10.0)
    ] = 0.15
    radius_max_m: Annotated[
        float, described("r_sup: within it a fast obstacle repels", "m", gt=0.0, le=10.0)
    ] = 0.20
    speed_min_m_s: Annotated[
        float, described("v_inf: up to it an obstacle is slow", "m/s", ge=0.0, le=100.0)
    ] = 0.1
    speed_max_m_s: Annotated[
        float, described("v_sup: from it on an obstacle is fast", "m/s", gt=0.0, le=100.0)
    ] = 0.5
    joint_speed_max_rad_s: Annotated[
        float, described("θ̇_max: every joint's velocity is cut there", "rad/s", gt=0.0, le=100.0)
    ] = 3.141592653589793

    def __post_init__(self) -> None:
        if not self.radius_min_m <= self.radius_max_m:
            raise ValueError("`radius_min_m` must not be above `radius_max_m`")
        if not self.speed_min_m_s < self.speed_max_m_s:
            raise ValueError("`speed_min_m_s` must be below `speed_max_m_s`")


class FilterConfig(Section, frozen=True, kw_only=True):
    """The quadratic programme: nearest to the wanted motion, within what every pair admits."""

    margin_m: Annotated[
        float,
        described(
            "distance that a link keeps; nearer, it retreats. Only a retreat from something else goes before",
            "m",
            ge=0.0,
            le=10.0,
        ),
    ] = 0.03
    approach_gain: Annotated[
        float,
        described("a link may close in at this times its way to the margin", "1/s", gt=0.0, le=100.0),
    ] = 3.0
    contact_m: Annotated[
        float,
        described(
            "distance below which no link comes by its own motion, whatever for; at most `margin_m`",
            "m",
            ge=0.0,
            le=10.0,
        ),
    ] = 0.003
    contact_gain: Annotated[
        float,
        described(
            "within the margin, a link may close in at this times its way to `contact_m`; at least "
            "`approach_gain`",
            "1/s",
            gt=0.0,
            le=100.0,
        ),
    ] = 10.0
    self_margin_m: Annotated[
        float,
        described(
            "distance that links keep from each other, those aside that a joint joins", "m", ge=0.0, le=1.0
        ),
    ] = 0.01
    influence_distance_m: Annotated[
        float, described("pairs farther apart than this do not enter the programme", "m", gt=0.0, le=10.0)
    ] = 0.6
    retreat_speed_m_s: Annotated[
        float, described("greatest speed at which a link is asked to retreat", "m/s", ge=0.0, le=10.0)
    ] = 0.5
    circulation_m_s: Annotated[
        float,
        described("speed of going round what blocks the way; 0 never goes round", "m/s", ge=0.0, le=10.0),
    ] = 0.1

    def __post_init__(self) -> None:
        if not self.contact_m <= self.margin_m:
            raise ValueError("`contact_m` must not be above `margin_m`")
        if not self.approach_gain <= self.contact_gain:
            raise ValueError("`approach_gain` must not be above `contact_gain`")


class MotionConfig(Section, frozen=True, kw_only=True):
    """How targets become joint velocities."""

    controller: Annotated[
        ControllerName,
        described(
            "method, where a target names none: `field`, the conventional potential field; `field3d`, that "
            "of the sensor rings; `clik-1`, `clik-2`, `clik-3`, closed-loop inverse kinematics that gives up "
            "position and orientation, position and rotation about the vertical, or position only; `filter`, "
            "a quadratic programme"
        ),
    ] = "field"
    speed_m_s: Annotated[
        float, described("speed of the end effector towards a `position` or `pose`", "m/s", gt=0.0, le=5.0)
    ] = 0.1
    rotation_speed_rad_s: Annotated[
        float, described("speed at which a `pose` target is turned to", "rad/s", gt=0.0, le=10.0)
    ] = 0.5
    attractive_gain: Annotated[float, described("ξ of the attractive field", "1/s²", gt=0.0, le=1e6)] = 1.0
    repulsive_gain: Annotated[float, described("η of the repulsive field", "m⁴/s²", ge=0.0, le=1e6)] = 0.002
    influence_distance_m: Annotated[
        float, described("ρ0: obstacles beyond this distance do not repel", "m", gt=0.0, le=10.0)
    ] = 0.3
    approach_gain: Annotated[
        float,
        described("the end effector slows to this times its distance from the goal", "1/s", gt=0.0, le=100.0),
    ] = 2.0
    arrival_tolerance_m: Annotated[
        float, described("the goal counts as reached within this distance", "m", gt=0.0, le=0.1)
    ] = 0.001
    singular_value_threshold: Annotated[
        float,
        described(
            "damping begins where the Jacobian's least singular value is below this", "m/rad", gt=0.0, le=1.0
        ),
    ] = 0.02
    max_damping: Annotated[
        float, described("greatest damping λ, at a singular configuration", "m/rad", gt=0.0, le=1.0)
    ] = 0.02
    clik: Annotated[ClikConfig, described("of the controllers `clik-1` to `clik-3`")] = ClikConfig()
    filter: Annotated[FilterConfig, described("of the controller `filter`")] = FilterConfig()

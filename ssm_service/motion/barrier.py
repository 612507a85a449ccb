"""What a tick admits: how fast each pair may come closer, and how fast each joint may turn."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..config import FilterConfig
from ..errors import InputError
from .limiting import check_joint

Array = NDArray[np.float64]


YIELDING_M_S: Final = 0.05
"""A pair that asks for a retreat of this speed from what comes towards it has the first right to one."""

YIELDING_SHARE: Final = 4.0
"""The margins of the others then become softer by up to this."""


class Box(NamedTuple):
    """Least and greatest velocity of each joint, (k,) [rad/s]; 0 lies in between."""

    lower: Array
    upper: Array


def approach_speeds(normals: Array, velocities: Array) -> Array:
    """Return the obstacles' own speeds towards the links, (p,) [m/s]; negative where one moves off.

    Args:
        normals: (p, 3) unit, from the obstacle to the link, base frame.
        velocities: (p, 3) of the obstacles [m/s], base frame.
    """
    speeds: Array = np.einsum("ij,ij->i", normals, velocities)
    return speeds


def barrier_bounds(distance: Array, approach: Array, config: FilterConfig) -> Array:
    """Return the greatest closing speed of its own that each link may have, (p,) [m/s].

    With ``h = d − margin`` the pair closes at ``−ḣ = c + approach``, where ``c`` is the link's own speed.
    ``ḣ ≥ −α h`` keeps ``h ≥ 0`` for ever if it holds at first, and brings it back at the rate α if not:

        c ≤ b = α (d − margin) − max(approach, 0)

    ``b < 0`` asks the link to retreat at ``−b``, cut at the retreat speed. An obstacle that moves off gains
    the link nothing: it may stop at any moment, and no one would have told the arm.

    Args:
        distance: (p,) signed [m]; −inf (a distance that failed) asks for the retreat speed.
        approach: (p,) the obstacle's own speed towards the link [m/s], from ``approach_speeds``.
        config: α, the margin, the retreat speed; pairs beyond the influence distance get ``inf``.

    Returns:
        (p,) [m/s], never below ``−retreat_speed_m_s``.

    Raises:
        InputError: ``not_finite`` for NaN, ``wrong_length``.
    """
    if distance.shape != approach.shape or distance.ndim != 1:
        shapes = [distance.shape, approach.shape]
        raise InputError("wrong_length", "approach", shapes, "one number for each distance")
    bounds: Array = config.approach_gain * (distance - config.margin_m) - np.maximum(approach, 0.0)
    np.maximum(bounds, -config.retreat_speed_m_s, out=bounds)
    # No −inf is left, so that only NaN gives NaN.
    if math.isnan(float(bounds.sum())):
        found = {"distance": distance.tolist(), "approach": approach.tolist()}
        raise InputError("not_finite", "pairs", found, "numbers")
    bounds[distance > config.influence_distance_m] = math.inf
    return bounds


def contact_bounds(distance: Array, approach: Array, config: FilterConfig) -> Array:
    """Return the closing speed of its own that no link may exceed whatever for, (p,) ≥ 0 [m/s].

    The barrier of ``barrier_bounds``, to the contact distance and with a gain of its own. Where the margin is
    a comfort that a link may leave to get out of the way of something else, this is not: below the contact
    distance nothing comes nearer by its own motion. It never asks for a retreat, so 0 fulfils it.

    Args:
        distance: (p,) signed [m]; no NaN, see ``barrier_bounds``.
        approach: (p,) the obstacle's own speed towards the link [m/s].
        config: The contact distance and its gain; pairs beyond the influence distance get ``inf``.
    """
    bounds: Array = config.contact_gain * (distance - config.contact_m) - np.maximum(approach, 0.0)
    np.maximum(bounds, 0.0, out=bounds)
    bounds[distance > config.influence_distance_m] = math.inf
    return bounds


def softness(bounds: Array, approach: Array, damping: float) -> Array:
    """Return λ of each pair's slack, (p,) [m/rad]: greater for margins while another pair is threatened.

    A pair is threatened by as much as it asks for a retreat from what comes, up to ``YIELDING_M_S``. The
    pairs that are less threatened than the worst get a greater λ, so that a link leaves its margin from
    what stands to get out of the way of what comes. Continuous in all arguments.

    Args:
        bounds: (p,) from ``barrier_bounds`` [m/s].
        approach: (p,) the obstacle's own speed towards the link [m/s].
        damping: λ where nothing comes [m/rad].
    """
    threat = np.minimum(approach, -bounds).clip(0.0, YIELDING_M_S)
    worst = threat.max(initial=0.0)
    result: Array = damping * (1.0 + YIELDING_SHARE / YIELDING_M_S * (worst - threat))
    return result


def velocity_box(
    position: Array,
    previous: Array,
    lower: Array,
    upper: Array,
    speed_limit: Array,
    margin: float,
    acceleration: float,
    dt: float,
) -> Box:
    """Return the velocities that each joint may have now: the limits of ``limit_velocity``, joint by joint.

    Towards a position limit, at most ``min(speed_limit, √(2·acceleration·gap), gap/dt)``, and 0 at or beyond
    the margin; a joint gains at most ``acceleration·dt`` over its last command and starts from 0 where it
    turns round. Slowing down is never delayed: 0 is always admitted.

    Args:
        position: (k,) [rad].
        previous: (k,) the command before this one [rad/s].
        lower: (k,) lower position limits, may be −inf [rad].
        upper: (k,) upper position limits, may be inf [rad].
        speed_limit: (k,) ≥ 0, may be infinite [rad/s].
        margin: Distance kept from the position limits [rad].
        acceleration: Greatest speeding up [rad/s²].
        dt: Time until the next command [s].

    Returns:
        Finite bounds with ``lower ≤ 0 ≤ upper`` [rad/s].

    Raises:
        InputError: ``not_finite``, ``out_of_range``, ``wrong_length``, as ``limit_velocity``.
    """
    if not (0.0 < dt < math.inf and 0.0 < acceleration < math.inf and margin >= 0.0):
        found = {"dt": dt, "acceleration": acceleration, "margin": margin}
        raise InputError("out_of_range", "limits", found, "dt > 0, acceleration > 0, margin ≥ 0")
    rows = [array.tolist() for array in (position, previous, lower, upper, speed_limit)]
    if len({len(row) for row in rows}) != 1:
        raise InputError("wrong_length", "position", [len(row) for row in rows], "one number for each joint")
    gain = acceleration * dt
    least: list[float] = []
    greatest: list[float] = []
    for index, (here, before, low, high, fastest) in enumerate(zip(*rows, strict=True)):
        check_joint(index, 0.0, before, here, fastest, low, high)
        back, forth = (gain - before, gain) if before < 0.0 else (gain, gain + before)
        for speeds, gap, speed in (
            (least, here - (low + margin), min(fastest, back)),
            (greatest, high - margin - here, min(fastest, forth)),
        ):
            if gap > 0.0 and speed * speed <= 2.0 * acceleration * gap and speed * dt <= gap:
                speeds.append(speed)
            else:
                speeds.append(_towards(gap, speed, acceleration, dt))
    return Box(-np.array(least, dtype=np.float64), np.array(greatest, dtype=np.float64))


def _towards(gap: float, fastest: float, acceleration: float, dt: float) -> float:
    """Return the greatest speed towards a limit that is this far away, ≥ 0 [rad/s]."""
    if not gap > 0.0:
        return 0.0
    return min(fastest, math.sqrt(2.0 * acceleration * gap), gap / dt)

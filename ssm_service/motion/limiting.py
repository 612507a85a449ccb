"""The last step before a command: one factor that brings a joint velocity within every limit."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

# A little below 1, so that no rounding of `factor * wanted` exceeds a limit by a unit in the last place.
_SHRINK = 1.0 - 2.0**-50


def limit_velocity(
    wanted: NDArray[np.float64],
    *,
    previous: NDArray[np.float64],
    position: NDArray[np.float64],
    speed_limit: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    margin: float,
    acceleration: float,
    dt: float,
) -> NDArray[np.float64]:
    """Return ``s · wanted`` with the greatest ``0 ≤ s ≤ 1`` at which every joint keeps its limits.

    The whole vector is scaled, so the direction, and with it the path, stays; the price is that one joint
    that may not move holds all the others, until the wanted velocity no longer moves it. Per joint:

    * speed: at most ``speed_limit``;
    * position: towards a limit at most ``min(√(2·acceleration·gap), gap/dt)``, where the gap ends at
      ``margin`` before the limit, and 0 at or beyond it. Motion away from a limit is free;
    * acceleration: a joint gains at most ``acceleration·dt`` over ``previous``, and one that turns round
      starts from 0. Slowing down is never delayed: ``wanted`` or ``speed_limit`` of 0 gives 0 at once.

    Every limit is a bound on the size of one joint's velocity, so a smaller limit never gives a faster joint.

    Args:
        wanted: (n,) [rad/s or m/s]. Joints at exactly 0 limit nothing.
        previous: (n,) the command before this one [rad/s].
        position: (n,) [rad or m].
        speed_limit: (n,) ≥ 0, may be infinite [rad/s].
        lower: (n,) lower position limits, may be −inf [rad].
        upper: (n,) upper position limits, may be inf [rad].
        margin: Distance kept from the position limits [rad].
        acceleration: Greatest speeding up [rad/s²].
        dt: Time until the next command [s].

    Returns:
        (n,) [rad/s].

    Raises:
        InputError: ``not_finite`` if a number that counts is NaN (or a wanted, previous or present value
            infinite), ``out_of_range`` for a negative limit, ``wrong_length``.
    """
    if not (dt > 0.0 and acceleration > 0.0 and margin >= 0.0):
        found = {"dt": dt, "acceleration": acceleration, "margin": margin}
        raise InputError("out_of_range", "limits", found, "dt > 0, acceleration > 0, margin ≥ 0")
    rows = [array.tolist() for array in (wanted, previous, position, speed_limit, lower, upper)]
    if len({len(row) for row in rows}) != 1:
        raise InputError("wrong_length", "wanted", [len(row) for row in rows], "one number for each joint")
    gain = acceleration * dt
    factor = 1.0
    for index, (want, before, here, fastest, low, high) in enumerate(zip(*rows, strict=True)):
        check_joint(index, want, before, here, fastest, low, high)
        if want == 0.0:
            continue
        gap = high - margin - here if want > 0.0 else here - (low + margin)
        if gap <= 0.0:
            factor = 0.0
            continue
        speeding = abs(before) + gain if want * before > 0.0 else gain
        allowed = min(fastest, speeding, math.sqrt(2.0 * acceleration * gap), gap / dt)
        factor = min(factor, allowed / abs(want))
    if factor == 1.0:
        return np.array(wanted, dtype=np.float64)
    if factor == 0.0:
        return np.zeros(len(rows[0]))
    return wanted * (factor * _SHRINK)


def check_joint(
    index: int, want: float, before: float, here: float, fastest: float, low: float, high: float
) -> None:
    """Refuse a joint whose numbers cannot be compared. NaN passes no comparison, so each test is positive.

    Raises:
        InputError: ``not_finite`` or ``out_of_range``, see ``limit_velocity``.
    """
    # Finite sum: cheaper than three tests, and NaN or infinity in any of them spoils it.
    if not math.isfinite(want + before + here):
        found = {"wanted": want, "previous": before, "position": here}
        raise InputError("not_finite", f"joint[{index}]", found, "finite numbers")
    if not (fastest >= 0.0 and low <= high):
        cause = "not_finite" if math.isnan(fastest + low + high) else "out_of_range"
        found = {"speed_limit": fastest, "lower": low, "upper": high}
        raise InputError(cause, f"joint[{index}]", found, "speed_limit ≥ 0 and lower ≤ upper")

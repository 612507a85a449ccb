"""From distances to the speeds at which every pair still keeps its protective separation ([TS15066])."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .stopping import StoppingLevels
from .zones import Zone

_SHRINK = 1.0 - 2.0**-50  # so that no rounding of `scaling · velocity` exceeds a limit

Array = NDArray[np.float64]


def level_speeds(
    distance: Array, human_speed: Array, reaction_time: Array, fixed: Array, levels: StoppingLevels
) -> Array:
    """Return the closing speed at which S_p is the distance, for each pair and stopping level.

    It is ``SeparationLaw.greatest_speed`` for many pairs, while the robot is within the level.

    Args:
        distance: (p,) [m]; one that is not a number allows nothing.
        human_speed: (p,) v_h [m/s].
        reaction_time: (p,) T_r [s].
        fixed: (p,) C + Z_d + Z_r [m].
        levels: The L levels.

    Returns:
        (p, L) [m/s], never negative; falling with the level.
    """
    reaction = reaction_time[:, np.newaxis]
    spare = (distance - fixed)[:, np.newaxis] - human_speed[:, np.newaxis] * (reaction + levels.times)
    return np.where(spare > 0.0, spare / (reaction + levels.gains), 0.0)


def max_closing_speeds(by_level: Array, greatest: Array, levels: StoppingLevels) -> Array:
    """Return the greatest closing speed at which each pair keeps its separation, (p,) [m/s].

    At full speed it is that of the last level. Below, a slower level may allow more, while the joints'
    share of their limits, and with it the closing speed's of ``greatest``, stays within it.

    Args:
        by_level: (p, L) [m/s], from ``level_speeds``.
        greatest: (p,) [m/s], that the joints could give each pair.
        levels: The L levels.
    """
    slower = np.minimum(by_level[:, :-1], levels.shares[:-1] * greatest[:, np.newaxis])
    allowed: Array = np.maximum(by_level[:, -1], slower.max(axis=1, initial=0.0))
    return allowed


def admissible_shares(allowed: Array, greatest: Array) -> Array:
    """Return σ of each pair, (p,): the share of all joint speeds that is safe in any direction.

    Args:
        allowed: (p,) [m/s], from ``max_closing_speeds``; where it is 0, so is σ, whatever the joints can.
        greatest: (p,) [m/s]; one that is not a number allows nothing.
    """
    known = (allowed > 0.0) & (greatest >= 0.0)
    share = np.ones(len(allowed))
    np.divide(allowed, greatest, out=share, where=known & (greatest > allowed))
    return np.where(known, share, 0.0)


def zone_of(share: float, red_scaling: float) -> Zone:
    """Return the zone of σ: stop at 0, red below ``red_scaling``, yellow below 1."""
    if share >= 1.0:
        return Zone.GREEN
    if share >= red_scaling:
        return Zone.YELLOW
    return Zone.RED if share > 0.0 else Zone.STOP


def greatest_scaling(closing: Array, share: float, by_level: Array, levels: StoppingLevels) -> float:
    """Return the greatest 0 ≤ s ≤ 1 at which ``s`` times a velocity keeps every pair's separation.

    A pair that does not come closer limits nothing: retreat is never slowed.

    Args:
        closing: (p,) [m/s], at the whole velocity; any that is not a number gives 0.
        share: The greatest share of its limit that any joint has in it.
        by_level: (p, L) [m/s], from ``level_speeds``.
        levels: The L levels.
    """
    if not np.isfinite(closing).all():
        return 0.0
    nearing = closing > 0.0
    if not nearing.any():
        return 1.0
    each = (by_level[nearing] / closing[nearing, np.newaxis]).min(axis=0)
    if share > 0.0:
        each[:-1] = np.minimum(each[:-1], levels.shares[:-1] / share)
    scaling = float(each.max())
    return 1.0 if scaling >= 1.0 else scaling * _SHRINK

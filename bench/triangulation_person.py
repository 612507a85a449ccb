"""A standing person who walks up to the sensed link, one arm stretched out, until a gap is left."""

from __future__ import annotations

import math

import numpy as np

from ssm_service.model import DistanceModel, Obstacle
from ssm_service.model.person import person

from .triangulation_scenes import AXIAL_M, Draws, Floats

TABLE_M = 0.75
"""How high the arm's base stands above the floor."""
ASIDE_M = 0.2
_SHOULDER_M, _ARM_M = 1.43 - TABLE_M, 0.7  # roughly, to aim; above the arm's base
_START_M, _STEPS, _CLOSE_M = 2.0, 24, 1e-4


def reaching(draws: Draws, index: int, distances: DistanceModel, link: str, middle: Floats) -> list[Obstacle]:
    """Return a person who has walked up to the sensed link until the gap of the draw is left.

    The person looks along the draw's bearing, walks past the ring's middle at up to ``ASIDE_M`` to the side
    (by the draw's axial offset) and holds the right arm out, raised or lowered towards the ring's
    height. Each step is what is left of the distance less the gap, so that nobody walks through the link; who
    would pass it at more than the gap stays where it was nearest.

    Args:
        draws: The scenes.
        index: Which of them.
        distances: Of the arm; its obstacles are replaced.
        link: The sensed link.
        middle: (3,) the ring's middle [m], base frame.
    """
    heading, gap = float(draws.bearing[index]), float(draws.gap[index])
    aside = ASIDE_M * float(draws.axial[index]) / AXIAL_M
    forward = np.array([math.cos(heading), math.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    slope = min(1.0, max(-1.0, (float(middle[2]) - _SHOULDER_M) / _ARM_M))
    along = (forward[0], forward[1], slope)
    back = _START_M
    nearest: list[Obstacle] = []
    least = math.inf
    for _ in range(_STEPS):
        x, y = (middle[:2] - back * forward + aside * left).tolist()
        limbs = list(person((x, y, -TABLE_M), heading, reach_along=along))
        distances.set_obstacles(limbs)
        pair = distances.nearest(draws.positions[index], link)
        left_over = pair.distance - gap if pair is not None else 0.0
        if left_over >= least:
            break
        nearest, least = limbs, left_over
        if left_over < _CLOSE_M:
            break
        back -= left_over
    return nearest

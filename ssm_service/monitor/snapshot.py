"""What a command is made from, and what it must keep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..model import Kinematics, Obstacle
from .decision import Nearest
from .inputs import JointSample, Target
from .separated import Limit
from .separation import SeparationStep

Array = NDArray[np.float64]


class Snapshot(Struct, frozen=True, kw_only=True, eq=False):
    """The robot, its target and its surroundings at one tick.

    Attributes:
        kinematics: Frames and Jacobians now.
        joints: Joint state.
        target: The wanted motion.
        nearest: The nearest thing of all sources; ``None`` where nothing was seen.
        echo: What the rings see nearest beside the arm's own links.
        ranges: (m,) fresh readings [m], ``inf`` for no echo and for own links; ``None`` without any.
        obstacles: The tracked obstacles, where they are fresh.
    """

    kinematics: Kinematics
    joints: JointSample
    target: Target
    nearest: Nearest | None
    echo: Nearest | None = None
    ranges: Array | None = None
    obstacles: Sequence[Obstacle] = ()


class Keeping(Struct, frozen=True, kw_only=True, eq=False):
    """What a command must keep beside the joints' own limits.

    Attributes:
        speed_limit: (n,) of the zone [rad/s].
        limits: Pairs' greatest closing speeds, where the profile has a separation.
        separation: Knows the joints' shares; ``None`` where the profile has none.
    """

    speed_limit: Array
    limits: Sequence[Limit] = ()
    separation: SeparationStep | None = None

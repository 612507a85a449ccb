"""A person made of capsules, standing, who may reach out with one arm."""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .shapes import Obstacle

# Lengths over body height: [Winter2009] Fig. 4.1, after Drillis and Contini (1966).
_ANKLE_TO_HIP: Final = (0.0, 0.530)  # the sole, and the hip's height
_HIP_HALF: Final = 0.0955
_SHOULDER: Final = 0.818
_SHOULDER_HALF: Final = 0.129
_CHIN: Final = 0.870
_UPPER_ARM: Final = 0.186
_FOREARM: Final = 0.146 + 0.108  # with the hand, to the finger tips

# Radii over body height, ours: round figures, at 1.75 m 7, 15, 10, 5 and 4.5 cm.
_LEG_R: Final = 0.07 / 1.75
_TORSO_R: Final = 0.15 / 1.75
_HEAD_R: Final = 0.10 / 1.75
_UPPER_ARM_R: Final = 0.05 / 1.75
_FOREARM_R: Final = 0.045 / 1.75

_DOWN: Final = np.array([0.0, 0.0, -1.0])


def person(
    position: ArrayLike,
    heading: float,
    *,
    height: float = 1.75,
    reach_to: ArrayLike | None = None,
    reach_along: ArrayLike | None = None,
    arm: Literal["left", "right"] = "right",
    velocity: tuple[float, float, float] | None = None,
    name: str = "person",
) -> tuple[Obstacle, ...]:
    """Return a standing person: legs, torso, head, upper arms, and forearms with the hands, eight capsules.

    An arm hangs down, or it reaches: to a point, with the finger tips there and the elbow low if the arm is
    long enough, else stretched towards it; or stretched along a direction. The rest of the body stays as it
    is. Lengths follow [Winter2009] Fig. 4.1, the radii are round figures.

    Args:
        position: (3,) on the floor, midway between the feet [m], base frame; z points up.
        heading: Where the person looks, about z from x [rad].
        height: Body height [m].
        reach_to: (3,) [m], base frame.
        reach_along: (3,) in the base frame, of any length but 0.
        arm: The arm that reaches.
        velocity: (3,) of the whole person [m/s], base frame; ``None`` where it is not known.
        name: Begins the obstacles' ids, ``person/head``.

    Raises:
        InputError: ``wrong_length``, ``not_finite``, ``out_of_range`` or ``unknown_arm``.
    """
    feet = _vector("position", position)
    if not math.isfinite(heading):
        raise InputError("not_finite", "heading", heading, "a finite angle [rad]")
    if not 0.5 <= height <= 2.5:
        raise InputError("out_of_range", "height", height, "0.5 to 2.5 m")
    if arm not in ("left", "right"):
        raise InputError("unknown_arm", "arm", arm, "left or right")
    aim = _aim(reach_to, reach_along)
    forward = np.array([math.cos(heading), math.sin(heading), 0.0])
    left = np.array([-forward[1], forward[0], 0.0])
    segments = _trunk(feet, left, height)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder = feet + height * (sign * _SHOULDER_HALF * left - _SHOULDER * _DOWN)
        elbow, tips = _arm(shoulder, aim if side == arm else None, forward, height)
        along = (tips - elbow) / np.linalg.norm(tips - elbow)
        segments[f"{side} upper arm"] = (shoulder, elbow, height * _UPPER_ARM_R)
        segments[f"{side} forearm"] = (elbow, tips - height * _FOREARM_R * along, height * _FOREARM_R)
    return tuple(
        _capsule(f"{name}/{part}", *segment, velocity=velocity) for part, segment in segments.items()
    )


_Segment = tuple[NDArray[np.float64], NDArray[np.float64], float]


def _trunk(feet: NDArray[np.float64], left: NDArray[np.float64], height: float) -> dict[str, _Segment]:
    up = -height * _DOWN
    sole, hip = _ANKLE_TO_HIP
    segments: dict[str, _Segment] = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        foot = feet + sign * height * _HIP_HALF * left
        segments[f"{side} leg"] = (foot + (sole + _LEG_R) * up, foot + hip * up, height * _LEG_R)
    segments["torso"] = (feet + hip * up, feet + (_SHOULDER - _TORSO_R) * up, height * _TORSO_R)
    segments["head"] = (feet + (_CHIN + _HEAD_R) * up, feet + (1.0 - _HEAD_R) * up, height * _HEAD_R)
    return segments


def _aim(
    reach_to: ArrayLike | None, reach_along: ArrayLike | None
) -> tuple[bool, NDArray[np.float64]] | None:
    """Return whether it is a point, and the point or the unit direction; ``None`` where nobody reaches."""
    if reach_to is not None and reach_along is not None:
        raise InputError("out_of_range", "reach_along", reach_along, "nothing, where reach_to is given")
    if reach_to is not None:
        return True, _vector("reach_to", reach_to)
    if reach_along is None:
        return None
    direction = _vector("reach_along", reach_along)
    length = float(np.linalg.norm(direction))
    if length < 1e-9:
        raise InputError("out_of_range", "reach_along", reach_along, "a direction, so not zero")
    return False, direction / length


def _arm(
    shoulder: NDArray[np.float64],
    aim: tuple[bool, NDArray[np.float64]] | None,
    forward: NDArray[np.float64],
    height: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return elbow and finger tips, (3,) [m]."""
    upper, lower = height * _UPPER_ARM, height * _FOREARM
    reach, direction = upper + lower, _DOWN
    if aim is not None:
        is_point, direction = aim
        if is_point:
            away = direction - shoulder
            distance = float(np.linalg.norm(away))
            direction = away / distance if distance > 1e-9 else forward
            reach = min(max(distance, lower - upper), upper + lower)
    # The elbow's height over the line from shoulder to tips, by the law of cosines; it hangs.
    along = (upper * upper + reach * reach - lower * lower) / (2.0 * reach)
    low = _DOWN - (_DOWN @ direction) * direction
    if np.linalg.norm(low) < 1e-6:
        low = -forward
    bend = math.sqrt(max(upper * upper - along * along, 0.0)) / float(np.linalg.norm(low))
    return shoulder + along * direction + bend * low, shoulder + reach * direction


def _capsule(
    name: str,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    radius: float,
    *,
    velocity: tuple[float, float, float] | None,
) -> Obstacle:
    length = float(np.linalg.norm(end - start))
    x, y, z = ((end - start) / length).tolist()
    # The shortest turn from z to the axis, w its half angle's cosine; straight down, half a turn about x.
    w = math.sqrt(0.5 + 0.5 * z) if z > 0.0 else 0.5 * math.hypot(x, y) / math.sqrt(0.5 - 0.5 * z)
    turn = (-0.5 * y / w, 0.5 * x / w, 0.0, w) if w > 0.0 else (1.0, 0.0, 0.0, 0.0)
    cx, cy, cz = (0.5 * (start + end)).tolist()
    return Obstacle(
        id=name, shape="capsule", size=(radius, length), position=(cx, cy, cz), quaternion_xyzw=turn,
        velocity=velocity,
    )  # fmt: skip


def _vector(where: str, values: ArrayLike) -> NDArray[np.float64]:
    try:
        vector = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("wrong_type", where, values, "3 numbers") from error
    if vector.shape != (3,):
        raise InputError("wrong_length", where, vector.shape, "3 numbers")
    if not np.isfinite(vector).all():
        raise InputError("not_finite", where, vector.tolist(), "finite numbers")
    return vector

"""Other places of the ball, drawn at random: how often does either method of ``bench.kang2022`` arrive?"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from statistics import median

import numpy as np

from .kang2022_run import Run, run
from .kang2022_scene import FIELD, FIELD3D, PLANTS, Array, Case, Point, robot

RADIUS_M = (0.08, 0.2)
"""Distance of the ball's centre from the forearm's axis where the arm passes it [m]."""

ALONG_M = 0.05
"""And from the ring's plane, at most, so that some sensor may see it [m]."""

WAY = (0.3, 0.75)
"""Where on its way the arm passes it: not at the start or the goal."""

METHODS = ((FIELD, False), (FIELD3D, True))
Pairs = list[tuple[Run, Run]]


def draw(free: Run, count: int, seed: int) -> list[Point]:
    """Return places round the forearm of a run without an obstacle, the same for the same seed."""
    rng, arm = np.random.default_rng(seed), robot(PLANTS[0])
    joints: Array = free.record.joints
    places = []
    for _ in range(count):
        position = arm.rest_position.copy()
        position[arm.free] = joints[int(rng.uniform(*WAY) * len(joints))]
        sensors = arm.kinematics(position).transform_sensors_to_base
        angle, radius = rng.uniform(-np.pi, np.pi), rng.uniform(*RADIUS_M)
        across = np.cos(angle) * sensors[0, :3, 0] + np.sin(angle) * sensors[2, :3, 0]
        along = rng.uniform(-ALONG_M, ALONG_M) * sensors[0, :3, 2]
        x, y, z = (sensors[:, :3, 3].mean(axis=0) + radius * across + along).tolist()
        places.append((x, y, z))
    return places


def run_places(places: Sequence[Point], advance: Callable[[], None]) -> Pairs:
    """Run both methods, ideal, with the ball at each place; ``advance`` is called after each."""
    found = []
    for place in places:
        one, other = (
            run(Case(method=method, limited=limited, plant=PLANTS[0], ball_m=place))
            for method, limited in METHODS
        )
        found.append((one, other))
        advance()
    return found


def place_notes(found: Pairs) -> Iterator[str]:
    """Yield what the places came to."""
    if not found:
        return
    total = len(found)
    for index, (method, limited) in enumerate(METHODS):
        runs = [pair[index] for pair in found]
        arrived = [one for one in runs if one.arrived_s is not None]
        clean = sum(one.contacts == 0 for one in arrived)
        touched = sum(one.contacts > 0 for one in runs)
        name = Case(method=method, limited=limited, plant=PLANTS[0]).name
        yield (
            f"the ball at {total} places drawn round the way of the forearm, ideal, {name}: {len(arrived)} "
            f"arrive, {clean} of them without contact; {touched} touch the ball"
        )
    both = [pair for pair in found if all(one.arrived_s is not None and one.contacts == 0 for one in pair)]
    ratios = [float(b.arrived_s) / float(a.arrived_s) for a, b in both if a.arrived_s and b.arrived_s]
    if ratios:
        slower = sum(ratio > 1.0 for ratio in ratios)
        yield (
            f"of these places both arrive clean at {len(ratios)}: 3-D with SSM over conventional without is "
            f"{min(ratios):.2f} to {max(ratios):.2f}, median {median(ratios):.2f}; above 1, as in "
            f"the paper, at {slower}"
        )
    else:
        yield "at none of these places do both arrive clean"

"""Random scenes: a configuration, spheres round the robot, readings, a target; the same for the same seed."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.monitor import Inputs, Received, checked_target, joint_sample, range_scan
from ssm_service.wire import messages as m
from ssm_service.wire import optional_readings

RADIUS_M = 0.05
NEAREST_M, FARTHEST_M = 0.05, 1.5
_REACH_M = 0.9  # no surface of a UR3 lies farther from its base
_DRAWN_AT_ONCE = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What one tick is given.

    Attributes:
        position: (n,) [rad].
        velocity: (n,) [rad/s].
        ranges: (m,) [m], ``inf`` for no echo.
        obstacles: The spheres, in the base frame.
        target: (3,) wanted position of the end effector [m], base frame.
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    ranges: NDArray[np.float64]
    obstacles: tuple[Obstacle, ...]
    target: NDArray[np.float64]

    def inputs(self, robot: Robot) -> Inputs:
        """Return the scene as a monitor gets it: four fresh sources."""
        target = checked_target(robot, "position", self.target.tolist())
        return Inputs(
            joints=Received(value=joint_sample(robot, self.position, self.velocity), age_s=0.001),
            ranges=Received(value=range_scan(robot, optional_readings(self.ranges)), age_s=0.001),
            obstacles=Received(value=self.obstacles, age_s=0.001),
            target=Received(value=target, age_s=0.001),
        )

    def payloads(self, robot: Robot, seq: int) -> dict[str, bytes]:
        """Return the scene as the four messages that drivers would send; joints in alphabetical order."""
        stamp = {"producer": "bench", "seq": seq, "stamp_ns": 1_700_000_000_000_000_000 + seq}
        order = sorted(range(len(robot.joint_names)), key=lambda i: robot.joint_names[i])
        entries = [
            m.ObstacleEntry(id=o.id, shape="sphere", size=list(o.size), position=o.position)
            for o in self.obstacles
        ]
        messages: dict[str, m.Message] = {
            "joints": m.JointState(
                **stamp,
                name=[robot.joint_names[i] for i in order],
                position=self.position[order].tolist(),
                velocity=self.velocity[order].tolist(),
            ),
            "ranges": m.Ranges(**stamp, ranges=optional_readings(self.ranges)),
            "obstacles": m.Obstacles(**stamp, obstacles=entries),
            "target": m.Target(**stamp, kind="position", value=self.target.tolist()),
        }
        return {name: msgspec.json.encode(message) for name, message in messages.items()}


def how_drawn(farthest_m: float) -> str:
    """Return how ``draw_scenes`` draws."""
    return (
        f"Scenes: joints uniform in ±π within their limits; centres of spheres of {RADIUS_M} m uniform in "
        f"space, kept where the surface lies {NEAREST_M} to {farthest_m} m from the robot's (by its hulls); "
        "readings no echo or uniform in 0.2 to 1.2 m, half each; a position target. Each tick has another "
        "scene, so nothing is left over from the tick before."
    )


def draw_scenes(
    robot: Robot, obstacles: int, count: int, seed: int, farthest_m: float = FARTHEST_M
) -> list[Scene]:
    """Return ``count`` scenes with so many obstacles each, their surfaces at most ``farthest_m`` away."""
    rng = np.random.default_rng([seed, obstacles])
    distances = DistanceModel(robot)
    return [_draw(robot, distances, obstacles, rng, farthest_m) for _ in range(count)]


def _draw(
    robot: Robot, distances: DistanceModel, count: int, rng: np.random.Generator, farthest_m: float
) -> Scene:
    lower = np.maximum(robot.position_lower, -np.pi)
    upper = np.minimum(robot.position_upper, np.pi)
    position = rng.uniform(lower, upper)
    spheres: list[Obstacle] = []
    while len(spheres) < count:
        drawn = [
            Obstacle(id=f"o{index}", shape="sphere", size=(RADIUS_M,), position=centre)
            for index, centre in enumerate(
                _in_ball(rng, _DRAWN_AT_ONCE, _REACH_M + RADIUS_M + farthest_m), start=len(spheres)
            )
        ]
        distances.set_obstacles(drawn)
        nearest = distances.bounds(position).min(axis=0)
        kept = [o for o, d in zip(drawn, nearest, strict=True) if NEAREST_M <= d <= farthest_m]
        spheres += [
            Obstacle(id=f"o{index}", shape="sphere", size=o.size, position=o.position)
            for index, o in enumerate(kept, start=len(spheres))
        ]
    ranges = rng.uniform(0.2, 1.2, robot.sensor_count)
    ranges[rng.random(robot.sensor_count) < 0.5] = np.inf
    return Scene(
        position=position,
        velocity=rng.uniform(-0.1, 0.1, len(position)),
        ranges=ranges,
        obstacles=tuple(spheres[:count]),
        target=rng.uniform(-0.4, 0.4, 3),
    )


def _in_ball(rng: np.random.Generator, count: int, radius: float) -> list[tuple[float, float, float]]:
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radii = radius * rng.random(count) ** (1.0 / 3.0)
    return [(x, y, z) for x, y, z in (directions * radii[:, None]).tolist()]

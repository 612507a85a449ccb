"""Random scenes round a ring: what is drawn, and where that puts balls, forearms and hands."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssm_service.model import Obstacle, Robot

Floats = NDArray[np.float64]

GAP_M = (0.01, 0.5)
AXIAL_M = 0.1
RADIUS_M = 0.05
FOREARM_M = (0.045, 0.25)  # radius, length between the caps' centres
HAND_M = (0.19, 0.085, 0.03)
SHAPES = ("sphere", "forearm", "hand", "person")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """What chance decides of n scenes.

    Attributes:
        gap: (n,) radial distance from the ring's cylinder to the obstacle's nearest point [m].
        bearing: (n,) about the ring's axis from sensor 1 [rad].
        axial: (n,) along the axis from the ring's plane [m].
        positions: (n, joints) of the arm [rad].
        quaternions: (n, 4) orientations of what is not round.
    """

    gap: Floats
    bearing: Floats
    axial: Floats
    positions: Floats
    quaternions: Floats

    @property
    def outward(self) -> Floats:
        """(n, 3) unit, radial directions in the ring's frame."""
        return np.stack([np.cos(self.bearing), np.sin(self.bearing), np.zeros_like(self.bearing)], axis=1)

    def nearest_points(self, radius: float) -> Floats:
        """Return where the obstacle is to come nearest to the ring's axis, (n, 3) [m], the ring's frame."""
        points = (radius + self.gap)[:, np.newaxis] * self.outward
        points[:, 2] += self.axial
        return points


def draw(robot: Robot, count: int, rng: np.random.Generator) -> Draws:
    """Draw scenes: gap, bearing, axial offset and free joints uniform, orientations of any kind alike."""
    lower = np.maximum(robot.position_lower, -math.pi)
    upper = np.minimum(robot.position_upper, math.pi)
    gap = rng.uniform(*GAP_M, count)
    bearing = rng.uniform(-math.pi, math.pi, count)
    axial = rng.uniform(-AXIAL_M, AXIAL_M, count)
    positions = np.tile(robot.rest_position, (count, 1))
    positions[:, robot.free] = rng.uniform(lower, upper, (count, len(lower)))[:, robot.free]
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return Draws(gap=gap, bearing=bearing, axial=axial, positions=positions, quaternions=quaternions)


def ball_centres(draws: Draws, radius: float) -> Floats:
    """Return centres of balls of ``RADIUS_M``, (n, 3) [m], in the frame of a ring of ``radius``."""
    return draws.nearest_points(radius) + RADIUS_M * draws.outward


def solids(shape: str, draws: Draws, radius: float) -> list[Obstacle]:
    """Return forearms or hands in the ring's frame.

    A solid lies beyond the plane at ``gap`` from the ring's cylinder, square to ``bearing``, and touches it
    at ``axial``.
    """
    points, outward = draws.nearest_points(radius), draws.outward
    size = FOREARM_M if shape == "forearm" else HAND_M
    made = []
    for point, u, quaternion in zip(points, outward, draws.quaternions, strict=True):
        kind = "capsule" if shape == "forearm" else "box"
        axes = Obstacle(id=shape, shape=kind, size=size, position=(0.0, 0.0, 0.0), quaternion_xyzw=quaternion)
        if shape == "forearm":
            a = np.array(axes.axis)
            centre = point + FOREARM_M[0] * u + math.copysign(0.5 * FOREARM_M[1], float(a @ u)) * a
        else:
            rotation = axes.rotation()
            centre = point + rotation @ (np.sign(u @ rotation) * 0.5 * np.array(HAND_M))
        made.append(
            Obstacle(id=shape, shape=kind, size=size, position=tuple(centre), quaternion_xyzw=quaternion)
        )
    return made


def moved(obstacle: Obstacle, transform: Floats) -> Obstacle:
    """Return an obstacle in the frame that ``transform``, (4, 4), leads to."""
    x, y, z = (transform[:3, :3] @ np.array(obstacle.position) + transform[:3, 3]).tolist()
    quaternion = _product(_quaternion(transform[:3, :3]), obstacle.quaternion_xyzw)
    return Obstacle(
        id=obstacle.id,
        shape=obstacle.shape,
        size=obstacle.size,
        position=(x, y, z),
        quaternion_xyzw=quaternion,
    )


def _quaternion(rotation: Floats) -> tuple[float, float, float, float]:
    import pinocchio as pin

    x, y, z, w = pin.Quaternion(np.ascontiguousarray(rotation)).coeffs().tolist()
    return x, y, z, w


def _product(
    a: tuple[float, float, float, float], b: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )

"""Independent measures for the tests: closed forms and convex minimisation in numpy, no Coal."""

from __future__ import annotations

import math
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from ssm_service.model import Obstacle, Robot
from ssm_service.model.hulls import triangles

MINIMAL = """
urdf = "{urdf}"
end_effector_frame = "{frame}"
default_profile = "p"
{top}
[sources]
ranges = {{ required = false, timeout_s = 0.4 }}
obstacles = {{ required = true, timeout_s = 0.25 }}
[profiles.p]
red = {{ distance_m = 0.1, joint_speed_rad_s = 0.1, speed_scaling = 0.25 }}
yellow = {{ distance_m = 0.2, joint_speed_rad_s = 0.2, speed_scaling = 0.5 }}
{rest}
"""
UR3_URDF = "example-robot-data:robots/ur_description/urdf/ur3_robot.urdf"


def write_robot(
    folder: Path, urdf: str = UR3_URDF, frame: str = "wrist_1_joint", top: str = "", rest: str = ""
) -> Path:
    path = folder / "arm.toml"
    path.write_text(MINIMAL.format(urdf=urdf, frame=frame, top=top, rest=rest))
    return path


def share() -> Path:
    return next(p / "share" for p in Path(pin.__file__).parents if (p / "share/example-robot-data").is_dir())


def random_positions(robot: Robot, rng: np.random.Generator, count: int) -> np.ndarray:
    lower, upper = np.maximum(robot.position_lower, -np.pi), np.minimum(robot.position_upper, np.pi)
    return rng.uniform(lower, upper, size=(count, len(robot.joint_names)))


def random_obstacle(rng: np.random.Generator, shape: str, name: str = "o", reach: float = 0.9) -> Obstacle:
    direction = rng.normal(size=3)
    quaternion = rng.normal(size=4)
    size = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3}[shape]
    return Obstacle(
        id=name,
        shape=shape,
        size=tuple(rng.uniform(0.02, 0.25, size=size)),
        position=tuple(direction / np.linalg.norm(direction) * rng.uniform(0.1, reach)),
        quaternion_xyzw=tuple(quaternion / np.linalg.norm(quaternion)),
    )


def moved(obstacle: Obstacle, step: np.ndarray) -> Obstacle:
    return Obstacle(
        id=obstacle.id,
        shape=obstacle.shape,
        size=obstacle.size,
        position=tuple(np.array(obstacle.position) + step),
        quaternion_xyzw=obstacle.quaternion_xyzw,
    )


class World:
    """The links' triangles in the base frame, placed by an own forward pass."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.meshes = {
            link: [(i, *triangles(robot.collision.geometryObjects[i].geometry)) for i in indices]
            for link, indices in robot.geometry_of_link.items()
            if all(
                isinstance(robot.collision.geometryObjects[i].geometry, coal.BVHModelBase) for i in indices
            )
        }
        self.data, self.geometry = robot.model.createData(), pin.GeometryData(robot.collision)

    def placement(self, position: np.ndarray, index: int) -> pin.SE3:
        q = self.robot.pinocchio_configuration(position)
        pin.forwardKinematics(self.robot.model, self.data, q)
        item = self.robot.collision.geometryObjects[index]
        return self.data.oMi[item.parentJoint] * item.placement

    def triangles(self, position: np.ndarray, link: str) -> np.ndarray:
        """(m, 3, 3): corners of the link's triangles in the base frame."""
        parts = []
        for index, vertices, faces in self.meshes[link]:
            pose = self.placement(position, index)
            parts.append((vertices @ pose.rotation.T + pose.translation)[faces])
        return np.concatenate(parts)


def to_solid(points: np.ndarray, obstacle: Obstacle) -> np.ndarray:
    """Distance of points (..., 3) from an obstacle's core: convex in the point, closed form, 0 inside."""
    local = (points - np.array(obstacle.position)) @ quaternion_matrix(obstacle.quaternion_xyzw)
    if obstacle.shape == "sphere":
        return np.linalg.norm(local, axis=-1)
    if obstacle.shape == "box":
        outside = np.maximum(np.abs(local) - np.array(obstacle.size) / 2, 0)
        return np.linalg.norm(outside, axis=-1)
    radial, axial = np.linalg.norm(local[..., :2], axis=-1), np.abs(local[..., 2]) - obstacle.size[1] / 2
    if obstacle.shape == "capsule":
        return np.hypot(radial, np.maximum(axial, 0))
    return np.hypot(np.maximum(radial - obstacle.size[0], 0), np.maximum(axial, 0))


def core_radius(obstacle: Obstacle) -> float:
    return obstacle.size[0] if obstacle.shape in ("sphere", "capsule") else 0.0


def quaternion_matrix(xyzw: tuple[float, ...]) -> np.ndarray:
    """By Rodrigues, unlike the package's own formula."""
    axis, w = np.array(xyzw[:3]), xyzw[3]
    length = np.linalg.norm(axis)
    if length < 1e-12:
        return np.eye(3)
    angle, (x, y, z) = 2 * math.atan2(length, w), axis / length
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def brute_force(corners: np.ndarray, obstacle: Obstacle) -> float:
    """Least distance from triangles (m, 3, 3) to the obstacle's core, less its radius.

    The distance from a convex solid is convex on a triangle: nested golden sections find its minimum.
    """
    at_corners = to_solid(corners, obstacle)
    centroid = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centroid[:, None], axis=-1).max(axis=1)
    kept = corners[to_solid(centroid, obstacle) - reach <= at_corners.min()]

    def inner(s: np.ndarray) -> np.ndarray:
        start = kept[:, 0] + s[:, None] * (kept[:, 1] - kept[:, 0])
        end = kept[:, 0] + s[:, None] * (kept[:, 2] - kept[:, 0])
        return golden(lambda t: to_solid(start + t[:, None] * (end - start), obstacle), len(kept))

    return float(golden(inner, len(kept)).min()) - core_radius(obstacle)


def golden(function, count: int, rounds: int = 28) -> np.ndarray:
    """Minimum of convex functions on [0, 1], the ends included, all at once."""
    ratio = (math.sqrt(5) - 1) / 2
    low, high = np.zeros(count), np.ones(count)
    best = np.minimum(function(low), function(high))
    a, b = high - ratio * (high - low), low + ratio * (high - low)
    fa, fb = function(a), function(b)
    for _ in range(rounds):
        left = fa <= fb
        low, high = np.where(left, low, a), np.where(left, b, high)
        a, b = (
            np.where(left, high - ratio * (high - low), b),
            np.where(left, a, low + ratio * (high - low)),
        )
        new = function(np.where(left, a, b))
        fa, fb = np.where(left, new, fb), np.where(left, fa, new)
        best = np.minimum(best, new)
    return best


def inside(corners: np.ndarray, point: np.ndarray) -> bool:
    """Whether the triangles wind round the point (solid angles by van Oosterom and Strackee)."""
    a, b, c = (corners - point).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a))]
    denominator = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return abs(np.arctan2(triple, denominator).sum() / (2 * np.pi)) > 0.5

"""Distances, witness points and Jacobians, one pair at a time, from the URDF alone.

Shares no code with the package: links are Coal's triangle meshes as Pinocchio reads them, obstacles Coal's
whole shapes, every Jacobian is a difference quotient of two configurations. Meant for scenes in which an
obstacle that does not touch a link is outside it.
"""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

STEP = 1e-6
"""Of the difference quotients [rad or m]."""


class SlowArm:
    """A robot file and its URDF.

    Args:
        path: The robot file.
    """

    def __init__(self, path: Path) -> None:
        self.file: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
        urdf, folders = self._urdf(path)
        self.model = pin.buildModelFromUrdf(str(urdf))
        self.geometry = pin.buildGeomFromUrdf(self.model, str(urdf), pin.COLLISION, package_dirs=folders)
        self.names = list(self.model.names)[1:]
        if self.model.nq != len(self.names) or self.file.get("joints", {}).get("fixed"):
            raise ValueError("only arms whose joints all have one coordinate, none of them taken out")
        locked = self.file.get("joints", {}).get("locked", {})
        self.free = [index for index, name in enumerate(self.names) if name not in locked]
        slower = self.file.get("limits", {}).get("velocity_rad_s", {})
        self.fastest = [
            min(float(self.model.velocityLimit[index]), slower.get(name, math.inf))
            for index, name in enumerate(self.names)
        ]
        self.lower = [float(value) for value in self.model.lowerPositionLimit]
        self.upper = [float(value) for value in self.model.upperPositionLimit]

    def _urdf(self, path: Path) -> tuple[Path, list[str]]:
        kind, _, rest = self.file["urdf"].partition(":")
        if not rest:
            return path.parent / kind, [str(path.parent)]
        for prefix in Path(pin.__file__).resolve().parents:
            share = prefix / "share"
            if (share / kind).is_dir():
                return share / kind / rest, [str(share)]
        raise FileNotFoundError(kind)

    def bodies(self) -> list[tuple[str, Any]]:
        """Return each link's name and its geometries, in the URDF's order."""
        return [(self.model.frames[item.parentFrame].name, item) for item in self.geometry.geometryObjects]

    def joint_poses(self, position: list[float]) -> list[Any]:
        """Return each joint's pose, from ``pin.forwardKinematics``; the universe is the first."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, np.array(position))
        return [pose.copy() for pose in data.oMi]

    def point_columns(self, position: list[float], joint: int, point: Any) -> list[list[float]]:
        """Return how a point that a joint carries moves with each joint: n columns of 3 [m/rad].

        Args:
            position: [rad or m].
            joint: Pinocchio's number of the joint; 0 is the base.
            point: In the base frame [m].
        """
        inside = self.joint_poses(position)[joint].actInv(np.array(point))
        columns = []
        for index in range(len(self.names)):
            ends = []
            for step in (STEP, -STEP):
                moved = list(position)
                moved[index] += step
                ends.append(self.joint_poses(moved)[joint].act(inside))
            columns.append(((ends[0] - ends[1]) / (2.0 * STEP)).tolist())
        return columns

    def pair(self, position: list[float], item: Any, obstacle: dict[str, Any]) -> dict[str, Any]:
        """Return distance, normal (obstacle to link) and ``gradient`` of one geometry and one obstacle.

        ``gradient`` is g with closing speed = g·q̇; both are zeros where the two touch.
        """
        pose = self.joint_poses(position)[item.parentJoint] * item.placement
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        distance = coal.distance(
            item.geometry,
            coal.Transform3s(pose.rotation, pose.translation),
            *solid(obstacle),
            request,
            result,
        )
        gradient, normal = [0.0] * len(self.names), [0.0, 0.0, 0.0]
        if distance > 0.0:
            on_link, on_obstacle = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
            along = on_link - on_obstacle
            normal = (along / np.linalg.norm(along)).tolist()
            columns = self.point_columns(position, item.parentJoint, on_link)
            gradient = [-sum(n * c for n, c in zip(normal, column, strict=True)) for column in columns]
        return {"distance": distance, "normal": normal, "gradient": gradient}

    def pairs(self, position: list[float], obstacles: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return every monitored link with every obstacle."""
        wanted = self.file.get("links")
        found: dict[tuple[str, str], dict[str, Any]] = {}
        for obstacle in obstacles:
            for link, item in self.bodies():
                if wanted is None or link in wanted:
                    pair = self.pair(position, item, obstacle)
                    key = (link, obstacle["id"])
                    if key not in found or pair["distance"] < found[key]["distance"]:
                        velocity = obstacle.get("velocity")
                        found[key] = {**pair, "link": link, "obstacle": obstacle["id"], "velocity": velocity}
        return list(found.values())

    def sensors(self, position: list[float]) -> list[dict[str, Any]]:
        """Return each sensor: link, joint, ring, origin and direction in the base frame.

        Only rings whose axis is their frame's z and whose first sensor looks along its x, without tilt
        (``SCIENCE`` 2).
        """
        poses = self.joint_poses(position)
        found = []
        for ring in self.file.get("rings", []):
            frame = next(f for f in self.model.frames if f.name == ring["parent_frame"])
            at = poses[frame.parentJoint] * frame.placement
            for number in range(ring["count"]):
                angle = 2.0 * math.pi / ring["count"] * number
                out = np.array([math.cos(angle), math.sin(angle), 0.0])
                origin = at.act(np.array(ring["origin_m"]) + ring["radius_m"] * out)
                found.append(
                    {
                        "link": frame.name,
                        "joint": frame.parentJoint,
                        "ring": ring,
                        "origin": origin,
                        "direction": at.rotation @ out,
                    }
                )
        return found

    def echo(self, position: list[float], index: int) -> list[float]:
        """Return the gradient of what a sensor sees straight ahead."""
        sensor = self.sensors(position)[index]
        columns = self.point_columns(position, sensor["joint"], sensor["origin"])
        return [float(sensor["direction"] @ np.array(column)) for column in columns]

    def corners(self, position: list[float], link: str) -> list[list[list[float]]]:
        """Return the columns of points whose hull holds a link and its sensors."""
        poses = self.joint_poses(position)
        points = [(s["joint"], s["origin"]) for s in self.sensors(position) if s["link"] == link]
        for name, item in self.bodies():
            if name == link:
                item.geometry.computeLocalAABB()
                box = item.geometry.aabb_local
                ends = (np.array(box.min_), np.array(box.max_))
                pose = poses[item.parentJoint] * item.placement
                for mask in range(8):
                    inside = np.array([ends[mask >> axis & 1][axis] for axis in range(3)])
                    points.append((item.parentJoint, pose.act(inside)))
        return [self.point_columns(position, joint, point) for joint, point in points]

    def sees_itself(self, position: list[float], slack_deg: float = 2.0) -> bool:
        """Tell whether any link stands in, or close to, the cone of a sensor."""
        poses = self.joint_poses(position)
        for sensor in self.sensors(position):
            half = math.radians(0.5 * sensor["ring"]["field_of_view_deg"] + slack_deg)
            length = sensor["ring"]["range_max_m"] + 0.1
            cone = coal.Cone(length * math.tan(half), length)  # its tip is at +z
            rotation = turned_to(-sensor["direction"])
            centre = sensor["origin"] + 0.5 * length * sensor["direction"]
            for _, item in self.bodies():
                pose = poses[item.parentJoint] * item.placement
                at = coal.Transform3s(pose.rotation, pose.translation)
                request, result = coal.CollisionRequest(), coal.CollisionResult()
                if coal.collide(item.geometry, at, cone, coal.Transform3s(rotation, centre), request, result):
                    return True
        return False


def turned_to(axis: Any) -> Any:
    """Return a rotation whose z is ``axis``, (3, 3)."""
    helper = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(axis, x), axis))


def solid(obstacle: dict[str, Any]) -> tuple[Any, Any]:
    """Return Coal's shape and pose of an obstacle as in the message ``Obstacles``."""
    size, (x, y, z, w) = obstacle["size"], obstacle.get("quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))
    shape = {
        "sphere": lambda: coal.Sphere(size[0]),
        "capsule": lambda: coal.Capsule(size[0], size[1]),
        "cylinder": lambda: coal.Cylinder(size[0], size[1]),
        "box": lambda: coal.Box(*size),
    }[obstacle["shape"]]()
    rotation = pin.Quaternion(w, x, y, z).normalized().matrix()
    return shape, coal.Transform3s(rotation, np.array(obstacle["position"]))

"""How points of links move with the joints, many points in one expression."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, listed
from .robot import Robot

Array = NDArray[np.float64]

_FIRST, _SECOND = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])


def cross(a: Array, b: Array) -> Array:
    """Return the cross products of rows, (k, 3): a third of what numpy's own takes, for few rows."""
    products = a.take(_FIRST, axis=1) * b.take(_SECOND, axis=1)
    found: Array = products[:, :3] - products[:, 3:]
    return found


def moved_by(robot: Robot, link: str) -> NDArray[np.bool_]:
    """Return which joints move a link, (n,).

    Raises:
        InputError: ``unknown_link``.
    """
    parents = {frame.name: frame.parentJoint for frame in robot.model.frames if frame.type.name == "BODY"}
    if link not in parents:
        raise InputError("unknown_link", "link", link, f"a link of the robot: {listed(parents)}")
    moved = np.zeros(len(robot.joint_names), dtype=np.bool_)
    moved[[joint - 1 for joint in robot.model.supports[parents[link]] if joint > 0]] = True
    return moved


def closing_gradients(spatial: Array, moved: NDArray[np.bool_], points: Array, normals: Array) -> Array:
    """Return g of each point, (p, n) [m/rad]: at a joint velocity q̇ it comes closer at ``g·q̇`` [m/s].

    g = −n·J_p, with n from the obstacle to the link. The distance's own gradient is −g.

    Args:
        spatial: (6, n), ``Kinematics.spatial_jacobian``.
        moved: (p, n) which joints move each point, from ``moved_by``.
        points: (p, 3) of links, base frame [m].
        normals: (p, 3) unit, from the obstacle to the link, base frame.
    """
    # n·(v_j + ω_j × p) = n·v_j + ω_j·(p × n)
    along = normals @ spatial[:3] + cross(points, normals) @ spatial[3:]
    gradients: Array = np.where(moved, -along, 0.0)
    return gradients


def greatest_speeds(spatial: Array, moving: Array, centres: Array, radii: Array) -> Array:
    """Return a speed that no point of each ball exceeds, (k,) [m/s]; each moves with a rigid body of its own.

    ``|v + ω × c| + |ω| r``: the speed of the centre, and of the farthest point about it.

    Args:
        spatial: (6, n), ``Kinematics.spatial_jacobian``.
        moving: (k, n) velocities of the joints that move each ball, 0 for the others [rad/s].
        centres: (k, 3), base frame [m].
        radii: (k,) [m].
    """
    twists = moving @ spatial.T
    angular = twists[:, 3:]
    linear = twists[:, :3] + cross(angular, centres)
    squares = np.einsum("ij,ij->i", linear, linear), np.einsum("ij,ij->i", angular, angular)
    speeds: Array = np.sqrt(squares[0]) + radii * np.sqrt(squares[1])
    return speeds


def point_jacobians(spatial: Array, moved: NDArray[np.bool_], points: Array) -> Array:
    """Return the Jacobians of points of one link, (c, 3, n) [m/rad].

    Args:
        spatial: (6, n), ``Kinematics.spatial_jacobian``.
        moved: (n,) which joints move the link, from ``moved_by``.
        points: (c, 3), base frame [m].
    """
    turning = np.cross(spatial[3:].T, points[:, np.newaxis, :])
    jacobians: Array = np.where(moved, spatial[:3] + turning.transpose(0, 2, 1), 0.0)
    return jacobians


def outermost_points(robot: Robot, link: str) -> Array:
    """Return points whose convex hull holds a link's geometry and its sensors, (c, 3) [m], link frame.

    They are the corners of the box round each geometry, and the sensors. As a rigid body's speed is a
    convex function of the point, none of its points is faster than the fastest of these.

    Raises:
        InputError: ``unknown_link``: the link has neither geometry nor sensors.
    """
    found: list[Array] = [
        array.transforms_sensor_to_link[:, :3, 3] for array in robot.sensor_arrays if array.link == link
    ]
    for index in robot.geometry_of_link.get(link, ()):
        item = robot.collision.geometryObjects[index]
        item.geometry.computeLocalAABB()
        box = item.geometry.aabb_local
        low, high = np.array(box.min_), np.array(box.max_)
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        frame = robot.model.frames[item.parentFrame]
        T_link_geometry = frame.placement.inverse() * item.placement
        in_geometry = low + corners * (high - low)
        found.append(in_geometry @ T_link_geometry.rotation.T + T_link_geometry.translation)
    if not found:
        raise InputError("unknown_link", "link", link, "a link with geometry or sensors")
    return np.concatenate(found)

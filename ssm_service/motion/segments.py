"""Links as segments of a line: distance to an obstacle's centre and the Jacobian of the nearest point.

[Neri2023] bounds each body by two control points, the extremes of the link. With ``d_l`` the vector from
the proximal to the distal one, ``d_p`` and ``d_d`` those from each to the obstacle's centre ``P_o``, ``α``
the angle between ``d_l`` and ``d_p``, ``β`` that between ``−d_l`` and ``d_d``, the nearest point of the link,
``P_r``, is at the share ``x`` of its length:

    cos β < 0       the distal extreme       d_o = d_d                  x = 1                     (4)
    else, cos α ≥ 0 between them             d_o = |d_l × d_p|/|d_l|    x = |d_p| cos α / |d_l|   (5)
    cos α < 0       the proximal extreme     d_o = d_p                  x = 0                     (6)

The three are one: ``x = clip(d_l·d_p / |d_l|², 0, 1)``, ``P_r = P_p + x d_l``, continuous in everything.

The paper's control points follow the axes of its kinematic table. Those do not run inside the UR5e's tubes,
which stand up to 0.14 m beside them; here the segments are the axes of the robot's collision shapes, so that
the distance to a link's surface is that to its segment less the shape's ``radius``, or more where a cylinder
ends flat.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import coal
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..model import Robot, moved_by, point_jacobians
from .clik import Critical

Array = NDArray[np.float64]

_ON_AXIS_M: Final = 1e-9
"""Nearer to the axis than this, the direction away from the centre is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closest:
    """The points of segments that are nearest to centres.

    Attributes:
        distance: (…) d_o [m].
        fraction: (…) x, 0 at the proximal and 1 at the distal extreme.
        point: (…, 3) P_r [m].
    """

    distance: Array
    fraction: Array
    point: Array


def closest_on_segments(proximal: Array, distal: Array, centres: Array) -> Closest:
    """Return P_r of segments for centres, whatever shapes broadcast ([Neri2023] (4)–(6)).

    Args:
        proximal: (…, 3) [m].
        distal: (…, 3) [m]; where it is the proximal one, the segment is a point and x = 0.
        centres: (…, 3) P_o [m], in the same frame.

    Raises:
        InputError: ``not_finite``.
    """
    along = distal - proximal
    squared = np.einsum("...i,...i", along, along)
    projected = np.einsum("...i,...i", along, centres - proximal)
    if not np.isfinite(projected).all():
        raise InputError("not_finite", "segments", projected.tolist(), "finite ends and centres")
    fraction = np.clip(projected / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    point = proximal + fraction[..., np.newaxis] * along
    distance = np.linalg.norm(centres - point, axis=-1)
    return Closest(distance=distance, fraction=fraction, point=point)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkSegments:
    """The s segments of a robot's links.

    Attributes:
        links: The link of each segment; a link may have several.
        proximal: (s, 3) [m], link frame; the end that is nearer to the frame's origin.
        distal: (s, 3) [m], link frame.
        radius: (s,) [m], that of the shape round the axis.
        moved: (s, n) which joints move the segment.
    """

    links: tuple[str, ...]
    proximal: Array
    distal: Array
    radius: Array
    moved: NDArray[np.bool_]


def link_segments(robot: Robot) -> LinkSegments:
    """Return the axes of the capsules, cylinders and spheres that the monitored links are made of.

    Raises:
        InputError: ``unsupported_shape`` where a monitored link has a shape without an axis (mesh, box).
    """
    links, ends, radii = [], [], []
    for link in robot.monitored_links:
        for index in robot.geometry_of_link[link]:
            item = robot.collision.geometryObjects[index]
            half, radius = _axis(link, item.geometry)
            frame = robot.model.frames[item.parentFrame]
            T_link_shape = frame.placement.inverse() * item.placement
            pair = [T_link_shape.act(np.array([0.0, 0.0, z])) for z in (-half, half)]
            ends.append(sorted(pair, key=lambda end: float(end @ end)))
            links.append(link)
            radii.append(radius)
    points = np.array(ends)
    return LinkSegments(
        links=tuple(links),
        proximal=points[:, 0],
        distal=points[:, 1],
        radius=np.array(radii),
        moved=np.array([moved_by(robot, link) for link in links]),
    )


def _axis(link: str, shape: Any) -> tuple[float, float]:
    """Return half the length of a shape's axis, along its own z, and its radius [m]."""
    if isinstance(shape, coal.Capsule | coal.Cylinder):
        return float(shape.halfLength), float(shape.radius)
    if isinstance(shape, coal.Sphere):
        return 0.0, float(shape.radius)
    allowed = "capsules, cylinders and spheres: the distance to a segment needs shapes with an axis"
    raise InputError("unsupported_shape", f"link {link}", type(shape).__name__, allowed)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CriticalSegment:
    """The one pair of segment and obstacle that repels most.

    Attributes:
        critical: For ``clik_velocity``; its distance is d_o, from the axis to the centre.
        link: The segment's link.
        obstacle: Index of the obstacle.
        fraction: x of P_r.
        point: (3,) P_r [m], base frame.
        radius: r [m] of the obstacle.
    """

    critical: Critical
    link: str
    obstacle: int
    fraction: float
    point: Array
    radius: float


def most_critical(
    segments: LinkSegments,
    transforms_link_to_base: Mapping[str, Array],
    spatial_jacobian: Array,
    free: NDArray[np.intp],
    centres: Array,
    radii: Array,
) -> CriticalSegment | None:
    """Return the pair with the least distance in proportion to its obstacle's radius of influence.

    That is the pair with the greatest ``a_v``; where several have 1, the deepest one. Segments that no free
    joint moves do not count.

    Args:
        segments: From ``link_segments``.
        transforms_link_to_base: (4, 4) [m] by link, ``Robot.link_transforms``.
        spatial_jacobian: (6, n), ``Kinematics.spatial_jacobian`` at the same position.
        free: (k,) indices of the joints that may move.
        centres: (o, 3) of the obstacles [m], base frame.
        radii: (o,) r of each [m], from ``influence_radius``.

    Returns:
        None where there is no obstacle, or nothing that moves.

    Raises:
        InputError: ``not_finite``, ``wrong_length``, ``out_of_range`` for a radius that is not above 0.
    """
    if centres.ndim != 2 or centres.shape[1] != 3 or radii.shape != (len(centres),):
        found = [centres.shape, radii.shape]
        raise InputError("wrong_length", "centres", found, "(o, 3) centres and (o,) radii")
    if not bool((radii > 0.0).all()):
        raise InputError("out_of_range", "radii", radii.tolist(), "radii above 0")
    movable = np.flatnonzero(segments.moved[:, free].any(axis=1))
    if not len(centres) or not len(movable):
        return None
    transforms = np.array([transforms_link_to_base[segments.links[i]] for i in movable])
    rotations, origins = transforms[:, :3, :3], transforms[:, :3, 3]
    proximal = np.einsum("sij,sj->si", rotations, segments.proximal[movable]) + origins
    distal = np.einsum("sij,sj->si", rotations, segments.distal[movable]) + origins
    closest = closest_on_segments(proximal[:, np.newaxis], distal[:, np.newaxis], centres)
    row, obstacle = divmod(int((closest.distance / radii).argmin()), len(centres))
    segment, point = int(movable[row]), closest.point[row, obstacle]
    distance = float(closest.distance[row, obstacle])
    jacobian = point_jacobians(spatial_jacobian, segments.moved[segment], point[np.newaxis])[0]
    direction = _away(point - centres[obstacle], distance, distal[row] - proximal[row])
    return CriticalSegment(
        critical=Critical(distance=distance, direction=direction, jacobian=jacobian[:, free]),
        link=segments.links[segment],
        obstacle=obstacle,
        fraction=float(closest.fraction[row, obstacle]),
        point=point,
        radius=float(radii[obstacle]),
    )


def _away(offset: Array, distance: float, along: Array) -> Array:
    """Return the unit vector away from the centre; where that is on the axis, one across the axis."""
    if distance > _ON_AXIS_M:
        return np.asarray(offset / np.linalg.norm(offset))
    across = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    length = float(np.linalg.norm(across))
    return np.asarray(across / length) if length > 0.0 else np.array([0.0, 0.0, 1.0])

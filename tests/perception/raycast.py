"""An independent reading: closed-form ray–shape intersections over the directions of a cone.

Every hit is a point of the shape in the cone, so the result is never below the true reading. The
distance to a convex shape is quasi-convex in the direction, so refining round the best direction
converges to it.
"""

import math

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation


def random_quaternion(rng):
    value = rng.normal(size=4)
    return tuple(value / np.linalg.norm(value))


def random_pose(rng):
    pose = np.eye(4)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = rng.uniform(-2.0, 2.0, 3)
    return pose


def rotation_of(quaternion):
    """Rodrigues by the quaternion product's matrix, written apart from the package's own."""
    vector, w = np.array(quaternion[:3]), quaternion[3]
    cross = np.array([[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def quaternion_of(rotation):
    return tuple(Rotation.from_matrix(rotation).as_quat())


def _interval(a, b, c):
    """The roots of a·t² + 2·b·t + c <= 0 as (enter, leave); (inf, −inf) where it never holds."""
    disc = b * b - a * c
    with np.errstate(all="ignore"):
        root = np.sqrt(np.maximum(disc, 0.0))
        enter, leave = (-b - root) / a, (-b + root) / a
    flat = a < 1e-15  # parallel to a cylinder's axis: inside for ever or never
    enter = np.where(flat, np.where(c <= 0.0, -np.inf, np.inf), enter)
    leave = np.where(flat, -enter, leave)
    return np.where(disc < 0.0, np.inf, enter), np.where(disc < 0.0, -np.inf, leave)


def _slab(o, d, h):
    with np.errstate(all="ignore"):
        t = np.stack([(-h - o) / d, (h - o) / d])
    inside = np.abs(o) <= h
    enter = np.where(d == 0.0, np.where(inside, -np.inf, np.inf), t.min(axis=0))
    leave = np.where(d == 0.0, np.where(inside, np.inf, -np.inf), t.max(axis=0))
    return enter, leave


def _entry(*intervals):
    enter = np.max([i[0] for i in intervals], axis=0)
    leave = np.min([i[1] for i in intervals], axis=0)
    return np.where((enter > leave) | (leave < 0.0), np.inf, np.maximum(enter, 0.0))


def _round_side(o, d, radius):
    across_o, across_d = np.broadcast_to(o[:2], d[:, :2].shape), d[:, :2]
    return _interval((across_d**2).sum(1), (across_o * across_d).sum(1), (across_o**2).sum(1) - radius**2)


def _ball(o, d, centre, radius):
    away = o - centre
    return _interval((d * d).sum(1), d @ away, np.full(len(d), away @ away - radius**2))


def ray_distances(obstacle, origin, directions):
    """Distance along each unit direction (m, 3) from origin to the obstacle, base frame; inf for a miss."""
    rotation = rotation_of(obstacle.quaternion_xyzw)
    o = rotation.T @ (np.asarray(origin) - np.array(obstacle.position))
    d = directions @ rotation
    if obstacle.shape == "sphere":
        return _entry(_ball(o, d, np.zeros(3), obstacle.size[0]))
    if obstacle.shape == "box":
        return _entry(*[_slab(np.full(len(d), o[k]), d[:, k], obstacle.size[k] / 2) for k in range(3)])
    radius, half = obstacle.size[0], obstacle.size[1] / 2
    side = _entry(_round_side(o, d, radius), _slab(np.full(len(d), o[2]), d[:, 2], half))
    if obstacle.shape == "cylinder":
        return side
    caps = [_entry(_ball(o, d, np.array([0, 0, z]), radius)) for z in (-half, half)]
    return np.min([side, *caps], axis=0)


def _cone_directions(pose, psi, azimuth):
    psi, azimuth = (grid.ravel() for grid in np.meshgrid(psi, azimuth))
    local = np.stack([np.cos(psi), np.sin(psi) * np.cos(azimuth), np.sin(psi) * np.sin(azimuth)], axis=1)
    return psi, azimuth, local @ pose[:3, :3].T


def raycast_reading(obstacle, pose, half_angle, *, polar=60, around=180, levels=16, polish=2):
    psi = np.linspace(0.0, half_angle, polar)
    azimuth = np.linspace(-math.pi, math.pi, around, endpoint=False)
    width = np.array([half_angle / (polar - 1), 2 * math.pi / around])
    best, centre = math.inf, (0.0, 0.0)
    for _ in range(levels):
        p, a, directions = _cone_directions(pose, psi, azimuth)
        distances = ray_distances(obstacle, pose[:3, 3], directions)
        index = int(np.argmin(distances))
        if distances[index] < best:
            best, centre = float(distances[index]), (p[index], a[index])
        if best == math.inf:
            return math.inf
        psi = np.clip(centre[0] + np.linspace(-4 * width[0], 4 * width[0], 31), 0.0, half_angle)
        azimuth = centre[1] + np.linspace(-4 * width[1], 4 * width[1], 31)
        width = width / 2.0

    def along(at):
        _, _, direction = _cone_directions(pose, np.clip(at[:1], 0.0, half_angle), at[1:])
        return min(float(ray_distances(obstacle, pose[:3, 3], direction)[0]), 1e3)

    for k in range(polish if best > 0.0 else 0):  # grids creep along an oblique crease: finish with simplices
        step = 1e-3 * 0.1**k
        simplex = np.array(centre) + step * np.array([[0.0, 0.0], [1.0, 0.3], [-0.3, 1.0]])
        options = {"initial_simplex": simplex, "xatol": 1e-10, "fatol": 1e-12, "maxiter": 300}
        found = minimize(along, np.array(centre), method="Nelder-Mead", options=options)
        if found.fun < best:
            best, centre = float(found.fun), tuple(found.x)
    return best


def mesh_ray_distances(corners, origin, directions, chunk=100_000):
    """Distance along each unit direction (m, 3) from origin to the nearest of the triangles (t, 3, 3)."""
    found = np.full(len(directions), math.inf)
    step = max(1, chunk // max(1, len(directions)))
    for first in range(0, len(corners), step):
        a, b, c = np.swapaxes(corners[first : first + step] - origin, 0, 1)
        # Cramer's rule on t·d = a + v·(b − a) + w·(c − a).
        e, f = b - a, c - a
        n = np.cross(e, f)
        below = directions @ n.T
        m = np.cross(a, directions[:, None, :])  # (m, t, 3)
        with np.errstate(all="ignore"):
            t = np.sum(n * a, axis=1) / below
            v = np.sum(m * f, axis=2) / below
            w = -np.sum(m * e, axis=2) / below
            t = np.where((v >= -1e-9) & (w >= -1e-9) & (v + w <= 1.0 + 1e-9) & (t >= 0.0), t, math.inf)
        found = np.minimum(found, t.min(axis=1, initial=math.inf))
    return found


def _in_reach(corners, origin, direction, angle):
    """Whether a ball round each triangle reaches into the cone round a direction (true rather than false)."""
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    away = np.linalg.norm(middle - origin, axis=1)
    with np.errstate(all="ignore"):
        off = np.arccos(np.clip((middle - origin) @ direction / away, -1.0, 1.0))
        spread = np.where(away > radius, np.arcsin(np.minimum(radius / away, 1.0)), math.pi)
    return off <= angle + spread + 1e-9


def raycast_mesh(corners, pose, half_angle, *, polar=17, around=48, starts=4, levels=14):
    """The least distance to a mesh in the cone, convex or not: several refinements, the best counts."""
    origin = pose[:3, 3]
    corners = corners[_in_reach(corners, origin, pose[:3, 0], half_angle)]
    psi, azimuth, directions = _cone_directions(
        pose, np.linspace(0.0, half_angle, polar), np.linspace(-math.pi, math.pi, around, endpoint=False)
    )
    distances = mesh_ray_distances(corners, origin, directions)
    best = float(distances.min())
    left = np.isfinite(distances)
    for _ in range(starts):
        if not left.any():
            break
        index = int(np.argmin(np.where(left, distances, math.inf)))
        left &= directions @ directions[index] < math.cos(0.15 * half_angle)
        best = min(
            best, _refined(corners, pose, half_angle, (psi[index], azimuth[index]), polar, around, levels)
        )
    return best


def _refined(corners, pose, half_angle, centre, polar, around, levels):
    origin, reach = pose[:3, 3], math.inf
    width = np.array([half_angle / (polar - 1), 2 * math.pi / around])
    for _ in range(levels):
        _, _, (aim,) = _cone_directions(pose, np.array(centre[:1]), np.array(centre[1:]))
        near = corners = corners[_in_reach(corners, origin, aim, 4.0 * float(width[0] + width[1]))]
        psi = np.clip(centre[0] + np.linspace(-2 * width[0], 2 * width[0], 13), 0.0, half_angle)
        azimuth = centre[1] + np.linspace(-2 * width[1], 2 * width[1], 13)
        p, a, directions = _cone_directions(pose, psi, azimuth)
        distances = mesh_ray_distances(near, origin, directions)
        index = int(np.argmin(distances))
        if distances[index] < reach:
            reach, centre = float(distances[index]), (p[index], a[index])
        width = width / 1.8
    return reach

"""The least distance from a cone's apex to a convex shape inside the cone, as a second-order cone program."""

from __future__ import annotations

import math
from typing import Any, Final

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from ..errors import SsmError
from .seen_shapes import SeenShape

GRAZING_MARGINS: Final = (1e-7, 1e-6, 1e-5)
"""By how much shape [m] and cone [rad] grow where the solver can tell neither 'hit' nor 'miss'."""


def _settings(tolerance: float, equilibrate: bool) -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.equilibrate_enable = equilibrate
    for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas", "tol_infeas_abs", "tol_infeas_rel"):
        setattr(settings, name, tolerance)
    return settings


# One reading in about 500 stalls at a residual of 1e-10 to 5e-9 m: those are solved again, less tightly.
_TIGHT: Final = _settings(1e-10, True)
_USUAL: Final = _settings(1e-8, False)
_CONES: Final[dict[str, list[Any]]] = {
    "box": [clarabel.NonnegativeConeT(6)],
    "capsule": [clarabel.NonnegativeConeT(2), clarabel.SecondOrderConeT(4)],
    "cylinder": [clarabel.NonnegativeConeT(2), clarabel.SecondOrderConeT(3)],
}


def least_distance(seen: SeenShape, half_angle: float) -> float:
    """Return ``min |x|`` over the points x of ``seen`` inside the cone, ``inf`` where there is none [m].

    ``inf`` is given only with a certificate that the intersection is empty, checked here. Where shape and
    cone graze so closely that the solver ends undecided, both are grown by ``GRAZING_MARGINS``, the least
    first, until the grown problem decides: its miss is a miss, and its echo is never farther than the true
    one.

    Args:
        seen: The shape in the sensor's frame.
        half_angle: Half of the cone's opening angle [rad], below 90°.

    Raises:
        SsmError: The solver stayed undecided.
    """
    for settings in (_TIGHT, _USUAL):
        found = _solve(seen, half_angle, settings)
        if found is not None:
            return found
    for margin in GRAZING_MARGINS:
        grown = SeenShape(shape=seen.shape, half=seen.half + margin, centre=seen.centre, axes=seen.axes)
        found = _solve(grown, min(half_angle + margin, math.pi / 2.0), _USUAL)
        if found is not None:
            return found
    raise SsmError(f"the reading of a {seen.shape} at {seen.centre.tolist()} (sensor frame) was not solved")


def _solve(seen: SeenShape, half_angle: float, settings: Any) -> float | None:
    """Return the least distance, ``inf`` for a proven miss, ``None`` where the solver is not sure."""
    matrix, offset = _constraints(seen, half_angle)
    rows, columns = matrix.shape
    cost = np.zeros(columns)
    cost[0] = 1.0
    indices = np.tile(np.arange(rows), columns)
    constraints = csc_matrix(
        (matrix.ravel(order="F"), indices, np.arange(0, rows * columns + 1, rows)), shape=matrix.shape
    )
    cones = [clarabel.SecondOrderConeT(4), clarabel.SecondOrderConeT(3), *_CONES[seen.shape]]
    quadratic = csc_matrix((columns, columns))
    solution = clarabel.DefaultSolver(quadratic, cost, constraints, offset, cones, settings).solve()
    if solution.status == clarabel.SolverStatus.Solved:
        return max(0.0, float(solution.x[0]))
    if _is_proven_empty(seen, matrix, offset, np.array(solution.z)):
        return math.inf
    return None


def _is_proven_empty(
    seen: SeenShape, matrix: NDArray[np.float64], offset: NDArray[np.float64], dual: NDArray[np.float64]
) -> bool:
    """Return whether ``dual`` (rows,) proves that no v has ``b − A·v ∈ K``, whatever the solver made of it.

    For z in the (self-dual) cone K every such v has ``zᵀb >= (Aᵀz)ᵀv``, and no |v| exceeds the shape's reach.
    """
    largest = float(np.abs(dual).max())
    if not 0.0 < largest < math.inf:
        return False
    z = _in_cone(seen.shape, dual / largest)
    reach = float(np.linalg.norm(seen.centre) + np.linalg.norm(seen.half))
    if seen.shape == "capsule":
        reach += float(seen.half[2])
    return bool(-(z @ offset) > 1.001 * reach * np.abs(matrix.T @ z).sum() + 1e-12 * np.abs(z * offset).sum())


def _in_cone(shape: str, dual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``dual`` moved into K: heads of second-order cones raised, negative entries set to 0."""
    z = dual.copy()
    linear = 6 if shape == "box" else 2
    z[7 : 7 + linear] = np.maximum(z[7 : 7 + linear], 0.0)
    heads = (0, 4) if shape == "box" else (0, 4, 9)
    ends = (4, 7) if shape == "box" else (4, 7, len(z))
    for head, end in zip(heads, ends, strict=True):
        z[head] = max(float(z[head]), float(np.linalg.norm(z[head + 1 : end])))
    return z


def _constraints(seen: SeenShape, half_angle: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return A and b of ``b − A·v ∈ K`` for v = (t, x, y, z), and s along a capsule's axis after them.

    The rows say, in this order: ``|x| ≤ t``; x is in the cone, ``cos α·|(y, z)| ≤ sin α·x``; x is in
    the shape.
    """
    block, offset = _box(seen) if seen.shape == "box" else _round(seen)
    columns = 5 if seen.shape == "capsule" else 4
    matrix = np.zeros((7 + len(offset), columns))
    matrix[:4, :4] = -np.eye(4)
    cos = -math.cos(half_angle)
    matrix[4, 1], matrix[5, 2], matrix[6, 3] = -math.sin(half_angle), cos, cos
    matrix[7:, 1:] = block
    return matrix, np.concatenate((np.zeros(7), offset))


def _box(seen: SeenShape) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    faces = seen.axes.T
    middle = faces @ seen.centre
    return np.vstack((faces, -faces)), np.concatenate((seen.half + middle, seen.half - middle))


def _round(seen: SeenShape) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows of a capsule (x within R of a point of its segment) or a cylinder (within R of its axis)."""
    radius, _, half_length = seen.half.tolist()
    axis = seen.axes[:, 2]
    if seen.shape == "capsule":
        block = np.zeros((6, 4))
        block[0, 3], block[1, 3] = 1.0, -1.0
        block[3:, :3] = -np.eye(3)
        block[3:, 3] = axis
        return block, np.concatenate(([half_length, half_length, radius], -seen.centre))
    across = seen.axes[:, :2].T
    block = np.vstack((axis, -axis, np.zeros(3), -across))
    along = float(axis @ seen.centre)
    ends = [half_length + along, half_length - along, radius]
    return block, np.concatenate((ends, -across @ seen.centre))

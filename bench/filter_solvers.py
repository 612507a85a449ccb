"""Solvers of quadratic programmes, each behind the same call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssm_service.motion import Box

Array = NDArray[np.float64]

Prepared = tuple[Array, Array, Array, Array, Array, Array]
"""Hessian (k, k), linear (k,), rows (p, k), their upper bounds (p,), and the box, (k,) each."""

Solve = Callable[[Array, Array, Array, Array, Array, Array], Array]
"""Returns the solution, (k,), or NaN where the solver says that there is none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Programme:
    """What one tick asks.

    Attributes:
        wanted: (k,) [rad/s].
        gradients: (p, k) [m/rad].
        bounds: (p,) [m/s], may be infinite.
        box: Of the joints.
    """

    wanted: Array
    gradients: Array
    bounds: Array
    box: Box

    def prepared(self) -> Prepared:
        """Return the programme without retreats, all rows of finite bound that are not 0."""
        chosen = np.isfinite(self.bounds) & (np.abs(self.gradients).max(axis=1) > 1e-9)
        rows, upper = self.gradients[chosen], np.maximum(self.bounds[chosen], 0.0)
        return np.eye(len(self.wanted)), -self.wanted, rows, upper, self.box.lower, self.box.upper


def daqp() -> Solve:
    """Return DAQP, as the filter calls it."""
    import daqp as package

    def solve(hessian: Array, linear: Array, rows: Array, upper: Array, low: Array, high: Array) -> Array:
        highest = np.concatenate([high, upper])
        lowest = np.concatenate([low, np.full(len(rows), -1e30)])
        sense = np.zeros(len(highest), dtype=np.int32)
        found, _, flag, _ = package.solve(hessian, linear, rows, highest, lowest, sense, primal_tol=1e-9)
        return np.array(found) if flag > 0 else np.full(len(linear), np.nan)

    return solve


def quadprog() -> Solve:
    """Return quadprog."""
    import quadprog as package

    def solve(hessian: Array, linear: Array, rows: Array, upper: Array, low: Array, high: Array) -> Array:
        sides = np.vstack([hessian, -hessian, -rows])
        return np.array(package.solve_qp(hessian, -linear, sides.T, np.concatenate([low, -high, -upper]))[0])

    return solve


def proxsuite() -> Solve:
    """Return ProxQP, dense, to an accuracy of 1e-9."""
    import proxsuite as package

    def solve(hessian: Array, linear: Array, rows: Array, upper: Array, low: Array, high: Array) -> Array:
        problem = package.proxqp.dense.QP(len(linear), 0, len(rows), True)
        problem.settings.eps_abs = 1e-9
        below = np.full(len(rows), -1e20)
        problem.init(hessian, linear, None, None, rows, below, upper, low, high)
        problem.solve()
        solved = problem.results.info.status == package.proxqp.QPSolverOutput.PROXQP_SOLVED
        return np.array(problem.results.x) if solved else np.full(len(linear), np.nan)

    return solve


def clarabel() -> Solve:
    """Return Clarabel, as it is by default."""
    import clarabel as package
    from scipy import sparse

    settings = package.DefaultSettings()
    settings.verbose = False

    def solve(hessian: Array, linear: Array, rows: Array, upper: Array, low: Array, high: Array) -> Array:
        sides = sparse.csc_matrix(np.vstack([hessian, -hessian, rows]))
        cones = [package.NonnegativeConeT(sides.shape[0])]
        limits = np.concatenate([high, -low, upper])
        solver = package.DefaultSolver(sparse.csc_matrix(hessian), linear, sides, limits, cones, settings)
        result = solver.solve()
        solved = result.status == package.SolverStatus.Solved
        return np.array(result.x) if solved else np.full(len(linear), np.nan)

    return solve


SOLVERS: dict[str, Callable[[], Solve]] = {
    "daqp": daqp,
    "quadprog": quadprog,
    "proxsuite": proxsuite,
    "clarabel": clarabel,
}

"""Differential kinematics: from the velocity of a point to the velocities of the joints."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesdd

from ..errors import InputError


def damped_pseudo_inverse(
    jacobian: NDArray[np.float64], *, threshold: float, max_damping: float
) -> NDArray[np.float64]:
    """Return the damped least-squares inverse of a Jacobian ([Neri2023]).

    ``J⁺ = Jᵀ (J Jᵀ + λ² I)⁻¹``, which equals ``(Jᵀ J + λ² I)⁻¹ Jᵀ``, through the singular values ``σ`` of J:
    each ``1/σ`` becomes ``σ / (σ² + λ²)``. With ``ε`` the threshold and ``σ_min`` the least of the
    ``min(m, k)`` singular values,

        λ² = 0                              σ_min ≥ ε
        λ² = (1 − (σ_min/ε)²) · λ_max²      σ_min < ε

    so at ``σ_min ≥ ε`` this is the Moore–Penrose inverse, for ``m < k`` as for ``m > k``, and the result is a
    continuous function of J everywhere: no singularity makes a command jump. Its greatest gain (spectral
    norm) is at most ``1/ε`` when ``λ_max ≥ ε/√2``, else ``1 / (2 λ_max √(1 − (λ_max/ε)²))``. With
    ``λ_max = ε`` the gain in the direction that is lost falls as ``σ/ε²``, a straight line to 0; a greater
    ``λ_max`` makes it fall within a small part of the threshold.

    Args:
        jacobian: (m, k) [m/rad, and rad/rad for angular rows], rows of the task, columns of the free joints.
        threshold: ε, the least singular value at which there is no damping.
        max_damping: λ_max, the damping at a singular configuration.

    Returns:
        (k, m), maps a velocity of the task to the joints' velocities [rad/s] of least norm.

    Raises:
        InputError: ``not_finite`` if the Jacobian holds NaN or infinity.
    """
    if jacobian.size == 0:
        return np.zeros(jacobian.shape[::-1])
    # LAPACK itself: numpy's wrapper costs twice as much at these sizes.
    left, singular, right, info = dgesdd(jacobian, full_matrices=0)
    least = float(singular[-1])
    if info != 0 or not math.isfinite(least):
        raise InputError("not_finite", "jacobian", jacobian.tolist(), "finite numbers")
    squared = singular * singular
    if least < threshold:
        ratio = least / threshold
        squared += (1.0 - ratio * ratio) * max_damping * max_damping
    inverse: NDArray[np.float64] = (right.T * (singular / squared)) @ left.T
    return inverse

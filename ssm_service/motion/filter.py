"""The quadratic programme: the joint velocity nearest to the wanted one that every pair and joint admits.

A pair closes by its link's own motion at ``g·q̇`` (``model.closing_gradients``). It should do so at no more
than ``b``, by its margin and by what comes towards it (``barrier_bounds``), and must not at more than
``c ≥ 0``, by the contact distance (``contact_bounds``). With ``lo ≤ 0 ≤ hi`` the box of the joints
(``velocity_box``),

    min   ½ (q̇ − wanted)ᵀ W (q̇ − wanted) + ½ Σ (s_i/λ_i)²
    s.t.  lo ≤ q̇ ≤ hi
          g_i·q̇ ≤ c_i                      every pair
          g_i·q̇ ≤ b_i + s_i,  s_i ≥ 0      pairs with b_i < c_i

``q̇ = 0`` fulfils every constraint whatever the obstacles do, so there always is a solution, and it is unique
in q̇. What the second rows ask for, the margin and the retreat, is a task, the heaviest one: λ is so small
that a wanted motion of 1 rad/s moves a link by a few mm into its margin at most. It is left for no less than
another such row: where something comes towards the arm and its way out leads past something that stands, the
arm comes nearer to that than the margin. With the margin a hard row it would wait there to be hit. What is
never left is the contact distance, and what the zones and separation make of the speed after this programme;
they are the safety, and no slack is on them. In penetration ``b < 0`` pushes out and what leads out is free;
nothing is locked in.

A retreat alone is the damped inverse ``q̇ = W⁻¹gᵀ b / (g W⁻¹gᵀ + λ²)``: a link that the joints can hardly
move (g near 0) makes no joint race, and one that they cannot move (g = 0, the base) asks for nothing.

Solver: `daqp`, a dual active-set method in C: MIT, wheels for CPython 3.11 to 3.14 on x86-64 and ARM, and
kept up. One call for k = 6 and 5, 20, 80 rows took 4, 6 and 11 µs on the machine where it was chosen, mostly
the way in and out of Python; quadprog took 17, 19 and 25 and is GPL; ProxQP, to the same accuracy, 80, 280
and 3000, and it called 3 of 176 programmes infeasible, which none is; Clarabel, an interior point method,
175, 330 and 1240 (`python -m bench.filter` compares them). A warm start (`daqp.Model.update`) saved nothing
at this size, so every call starts cold: the result depends on nothing but its inputs, and a recording replays
to the bit. DAQP's own soft constraints weigh the slack of a *normalised* row, which would make the damping
above vanish; the slacks are variables of our own instead.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, Literal, NamedTuple

import daqp
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..errors import InputError
from .barrier import Box

Array = NDArray[np.float64]
Status = Literal["free", "solved", "fallback"]

TOLERANCE_M_S: Final = 1e-6
"""A closing speed that does not count: a pair that may not come closer may at this. 1 µm in a second."""

DAMPING_M_RAD: Final = 0.01
"""λ: a retreat is damped where the joints move the link by less than this."""

MOST_SOFT: Final = 20
"""Pairs whose margin and retreat are tasks, the most urgent ones; all others keep the contact distance."""

_SHRINK: Final = 1.0 - 1e-7  # of what was scaled: more than rounding adds where terms of g·q̇ cancel
_PRIMAL_TOLERANCE: Final = 1e-9  # at DAQP's default of 1e-6, 1 of 500 random programmes was off by 0.01 rad/s
_ITERATIONS: Final = 1000
_FREE: Final = 1e30  # DAQP's infinity


class Filtered(Struct, frozen=True, kw_only=True, eq=False):
    """What the programme leaves of a wanted velocity.

    Attributes:
        velocity: (k,) [rad/s].
        active: Indices of the pairs that hold the motion back or are to retreat; first the one that the
            wanted velocity offends most.
        retreating: Whether the arm moves away from a pair that asks for it.
        missed: By how much the worst pair that the joints can move stays behind its retreat [m/s].
        status: ``free``: nothing was in the way; ``solved``; ``fallback``: the solver failed, and this is the
            best of standing, a part of the wanted velocity and a part of the retreat.
        rows: How many rows of pairs went into the programme; 0 where it was not needed.
    """

    velocity: Array
    active: tuple[int, ...]
    retreating: bool
    missed: float
    status: Status
    rows: int = 0


class VelocityFilter:
    """Solves the programme of this module. It keeps nothing between calls.

    Args:
        damping: λ of the retreat [m/rad].

    Raises:
        InputError: ``out_of_range``.
    """

    def __init__(self, damping: float = DAMPING_M_RAD) -> None:
        if not 0.0 < damping < math.inf:
            raise InputError("out_of_range", "damping", damping, "a number > 0")
        self._damping = damping

    def solve(
        self,
        wanted: Array,
        gradients: Array,
        bounds: Array,
        box: Box | tuple[Array, Array],
        metric: Array | None = None,
        ceilings: Array | None = None,
        softness: Array | None = None,
    ) -> Filtered:
        """Return the admissible velocity nearest to the wanted one.

        Only the size of a row's violation counts, so neither the order of the pairs nor a pair given twice
        makes a difference beyond rounding (but for a doubled row with slack, which weighs double).

        Args:
            wanted: (k,) [rad/s].
            gradients: (p, k) g of each pair [m/rad].
            bounds: (p,) b of each pair [m/s]; ``inf`` for none.
            box: (k,) least and greatest velocity of each joint [rad/s], with 0 in between.
            metric: (k, k) W, symmetric and positive definite, e.g. ``task_metric``; left out, the identity.
            ceilings: (p,) c of each pair [m/s], 0 where it is below; left out, b.
            softness: (p,) λ of each pair [m/rad]; left out, that of all.

        Raises:
            InputError: ``wrong_length``, ``not_finite``, ``out_of_range``.
        """
        lower, upper = box
        ceilings = bounds if ceilings is None else ceilings
        if softness is None:
            softness = np.full(len(bounds), self._damping)
        _check(wanted, gradients, bounds, lower, upper, metric)
        _check_softness(ceilings, softness, len(bounds))
        start = np.minimum(np.maximum(wanted, lower), upper)
        if metric is None or start.tolist() == wanted.tolist():
            closing = gradients @ start
            if not len(bounds) or bool(((closing <= bounds) & (bounds >= 0.0) & (closing <= ceilings)).all()):
                return Filtered(velocity=start, active=(), retreating=False, missed=0.0, status="free")
        rows = _Rows(gradients, bounds, ceilings, softness)
        return _Programme(wanted, rows, lower, upper, metric).solve(start)


def _solved(
    hessian: Array, linear: Array, rows: Array, highest: Array, lowest: Array, count: int
) -> Array | None:
    """Return the first variables of a programme's solution, (count,), unless the solver says that it failed.

    The bounds are those of the variables and then those of the rows. The solver keeps nothing and changes
    only the copies that it is given.
    """
    sense = np.zeros(len(highest), dtype=np.int32)
    solution, _, flag, _ = daqp.solve(
        hessian, linear, rows, highest, lowest, sense, primal_tol=_PRIMAL_TOLERANCE, iter_limit=_ITERATIONS
    )
    found = np.array(solution[:count])
    return found if flag > 0 and math.isfinite(float(found @ found)) else None


def in_box(wanted: Array, box: Box, metric: Array | None = None) -> Filtered | None:
    """Return what ``VelocityFilter.solve`` returns where no pair matters; ``None`` where the solver fails.

    Args:
        wanted: (k,) [rad/s].
        box: (k,) least and greatest velocity of each joint [rad/s], with 0 in between.
        metric: (k, k) W, symmetric and positive definite; left out, the identity.

    Raises:
        InputError: ``wrong_length``, ``not_finite``, ``out_of_range``.
    """
    none = _no_rows(len(wanted))
    _check(wanted, none, none.reshape(-1), box.lower, box.upper, metric)
    velocity: Array = np.minimum(np.maximum(wanted, box.lower), box.upper)
    status: Status = "free"
    if metric is not None and velocity.tolist() != wanted.tolist():
        found = _solved(
            metric.copy(), -(metric @ wanted), none.copy(), box.upper.copy(), box.lower.copy(), len(wanted)
        )
        if found is None:
            return None
        velocity, status = np.minimum(np.maximum(found, box.lower), box.upper), "solved"
    return Filtered(velocity=velocity, active=(), retreating=False, missed=0.0, status=status)


@lru_cache(maxsize=8)
def _no_rows(count: int) -> Array:
    """Return no gradients, (0, count), read-only."""
    none = np.empty((0, count))
    none.flags.writeable = False
    return none


def task_metric(jacobian: Array, freedom: float = 0.05) -> Array:
    """Return W that holds the end effector to its way and lets the other joints give, (k, k), mean weight 1.

    ``W ∝ JᵀJ + r² I``: motion that moves the end effector costs more than motion that does not.

    Args:
        jacobian: (m, k) of the task [m/rad].
        freedom: r, the motion of the end effector per joint angle that counts double [m/rad].
    """
    product = jacobian.T @ jacobian
    count = len(product)
    square = freedom * freedom
    share = count / (float(product.trace()) + count * square)
    metric: Array = product * share
    metric.flat[:: count + 1] += square * share
    return metric


def _check(
    wanted: Array, gradients: Array, bounds: Array, lower: Array, upper: Array, metric: Array | None
) -> None:
    """Refuse what has the wrong shape or is not a number. NaN passes no comparison: each test is positive."""
    count = len(wanted)
    shapes = [wanted.shape, gradients.shape, bounds.shape, lower.shape, upper.shape]
    right = [(count,), (len(bounds), count), (len(bounds),), (count,), (count,)]
    if metric is not None:
        shapes.append(metric.shape)
        right.append((count, count))
    if shapes != right:
        raise InputError("wrong_length", "programme", shapes, str(right))
    # A product with itself spoils on NaN and infinity, and costs a quarter of a test of each number.
    flat = gradients.reshape(-1)
    squares = float(wanted @ wanted) + float(flat @ flat)
    if metric is not None:
        weights = metric.reshape(-1)
        squares += float(weights @ weights)
    if not math.isfinite(squares):
        found = {"wanted": wanted.tolist(), "gradients": gradients.tolist()}
        raise InputError("not_finite", "programme", found, "finite numbers, and a finite metric")
    if len(bounds) and not float(bounds.min()) > -math.inf:
        raise InputError("not_finite", "bounds", bounds.tolist(), "numbers, or inf for no bound")
    for low, high in zip(lower.tolist(), upper.tolist(), strict=True):
        if not (-math.inf < low <= 0.0 <= high < math.inf):
            cause = "out_of_range" if math.isfinite(low + high) else "not_finite"
            found = {"lower": lower.tolist(), "upper": upper.tolist()}
            raise InputError(cause, "box", found, "finite, lower ≤ 0 ≤ upper")


def _check_softness(ceilings: Array, softness: Array, count: int) -> None:
    if ceilings.shape != (count,) or softness.shape != (count,):
        raise InputError(
            "wrong_length", "ceilings", [ceilings.shape, softness.shape], f"{count} numbers each"
        )
    if not count:
        return
    least = float(softness.min())
    if not (float(ceilings.min()) > -math.inf and least > -math.inf):
        found = {"ceilings": ceilings.tolist(), "softness": softness.tolist()}
        raise InputError("not_finite", "ceilings", found, "numbers; inf for no ceiling")
    if not least > 0.0:
        raise InputError("out_of_range", "softness", softness.tolist(), "numbers > 0")


class _Rows(NamedTuple):
    """Of p pairs: g (p, k), b, c and λ (p,)."""

    gradients: Array
    bounds: Array
    ceilings: Array
    softness: Array


class _Programme:
    """One programme: the rows that can matter, their solution, and its check.

    Indices of pairs: ``hard``, which may come too near; ``soft``, which may come into their margin or are to
    retreat; ``asked``, of the soft ones which are to retreat and can.
    """

    def __init__(self, wanted: Array, rows: _Rows, lower: Array, upper: Array, metric: Array | None) -> None:
        self._wanted, self._gradients, self._bounds = wanted, rows.gradients, rows.bounds
        self._lower, self._upper, self._metric, self._softness = lower, upper, metric, rows.softness
        middle, spread = (
            rows.gradients @ (0.5 * (upper + lower)),
            np.abs(rows.gradients) @ (0.5 * (upper - lower)),
        )
        # No velocity of the box closes a pair faster than this, none opens it faster than that.
        closing, opening = middle + spread, middle - spread
        ceilings = np.maximum(rows.ceilings, 0.0)
        self._caps = np.maximum(ceilings, TOLERANCE_M_S)
        self._hard = (closing > self._caps).nonzero()[0]
        self._hard_rows, self._hard_bounds = rows.gradients[self._hard], ceilings[self._hard]
        moved = (closing > TOLERANCE_M_S) | (opening < -TOLERANCE_M_S)
        self._soft = self._most_urgent(
            ((rows.bounds < ceilings) & (closing > rows.bounds) & moved).nonzero()[0]
        )
        self._soft_rows, self._soft_bounds = rows.gradients[self._soft], rows.bounds[self._soft]
        self._asked = self._soft[(self._soft_bounds < 0.0) & (opening[self._soft] < -TOLERANCE_M_S)]

    def solve(self, start: Array) -> Filtered:
        """Return the solution, or what can be had without the solver.

        Args:
            start: (k,) what the box leaves of the wanted velocity.
        """
        if not len(self._asked):
            nearest = self._metric is None or start.tolist() == self._wanted.tolist()
            if nearest and self._admits(start):
                return Filtered(velocity=start, active=(), retreating=False, missed=0.0, status="free")
        found = self._optimum()
        if found is None:
            return self._told(self._fallback(), "fallback")
        return self._told(self._admitted(found), "solved")

    def _admits(self, velocity: Array) -> bool:
        """Tell whether a velocity fulfils every row without slack."""
        hard = bool((self._hard_rows @ velocity <= self._hard_bounds).all())
        return hard and bool((self._soft_rows @ velocity <= self._soft_bounds).all())

    def _optimum(self) -> Array | None:
        """Return what the solver says, (k,), unless it says that it failed.

        Its variables are q̇ and s/λ; its rows those of the ceilings and then those with slack.
        """
        k, p, r = len(self._wanted), len(self._hard), len(self._soft)
        hessian = np.eye(k + r)
        if self._metric is not None:
            hessian[:k, :k] = self._metric
        linear = np.zeros(k + r)
        linear[:k] = -(hessian[:k, :k] @ self._wanted)
        rows = np.zeros((p + r, k + r))
        rows[:p, :k], rows[p:, :k] = self._hard_rows, self._soft_rows
        rows[range(p, p + r), range(k, k + r)] = -self._softness[self._soft]
        highest = np.concatenate((self._upper, np.full(r, _FREE), self._hard_bounds, self._soft_bounds))
        lowest = np.concatenate((self._lower, np.zeros(r), np.full(p + r, -_FREE)))
        return _solved(hessian, linear, rows, highest, lowest, k)

    def _most_urgent(self, soft: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the pairs whose slack counts, in an order of their own if not all can be."""
        if len(soft) <= MOST_SOFT:
            return soft
        order = np.lexsort((*self._gradients[soft].T, self._bounds[soft]))
        return soft[order[:MOST_SOFT]]

    def _admitted(self, velocity: Array) -> Array:
        """Return the velocity cut to the box and, where a pair closes too fast, scaled until it does not."""
        inside = np.minimum(np.maximum(velocity, self._lower), self._upper)
        closing = self._gradients @ inside
        if bool((closing <= self._caps).all()):
            return inside
        # 0 < caps < closing where it is above, so that the factor is in (0, 1); NaN stands still.
        over = ~(closing <= self._caps)
        factor = float((self._caps[over] / closing[over]).min()) * _SHRINK
        return inside * factor if 0.0 <= factor < 1.0 else np.zeros(len(inside))

    def _fallback(self) -> Array:
        """Return the best of standing still, the admissible part of the wanted velocity, and a retreat's."""
        choices = [np.zeros(len(self._wanted)), self._shared(self._wanted)]
        asked = self._asked
        if len(asked):
            gradients = self._gradients[asked]
            squares = (gradients * gradients).sum(axis=1) + self._softness[asked] ** 2
            choices.append(self._shared((self._bounds[asked] / squares) @ gradients))
        return min(choices, key=self._cost)

    def _shared(self, direction: Array) -> Array:
        """Return the greatest part of a direction that the box and the pairs admit."""
        limit = np.where(direction > 0.0, self._upper, self._lower)
        moving = direction != 0.0
        share = float((limit[moving] / direction[moving]).min(initial=1.0))
        return self._admitted(direction * share)

    def _cost(self, velocity: Array) -> float:
        off = velocity - self._wanted
        task = off if self._metric is None else self._metric @ off
        slack = (self._soft_rows @ velocity - self._soft_bounds).clip(0.0) / self._softness[self._soft]
        return float(off @ task + slack @ slack)

    def _told(self, velocity: Array, status: Status) -> Filtered:
        """Return the velocity with what there is to say about it."""
        held = (self._hard_rows @ velocity >= self._hard_bounds - TOLERANCE_M_S).nonzero()[0]
        near = (self._soft_rows @ velocity >= self._soft_bounds - TOLERANCE_M_S).nonzero()[0]
        tight = {*self._hard[held].tolist(), *self._soft[near].tolist(), *self._asked.tolist()}
        missed, retreating = 0.0, False
        if len(self._asked):
            speeds = self._gradients[self._asked] @ velocity
            missed = max(0.0, float((speeds - self._bounds[self._asked]).max()))
            retreating = float(speeds.min()) < -TOLERANCE_M_S
        rows = sorted(tight)
        if len(rows) > 1:
            offence = (self._gradients[rows] @ self._wanted - self._bounds[rows]).tolist()
            rows = [rows[i] for i in sorted(range(len(rows)), key=lambda i: -offence[i])]
        return Filtered(
            velocity=velocity,
            active=tuple(rows),
            retreating=retreating,
            missed=missed,
            status=status,
            rows=len(self._hard) + len(self._soft),
        )

"""From readings to a bound, with a memory for the commonest patterns. Compiled: import lazily."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.compiled import compiled
from .bound_hidden import hidden
from .bound_leaves import leaves_of
from .bound_solve import TOLERANCE, limits, solve

STEP = 2.5e-4  # [m]; single echoes are rounded to this, to the safe side
__all__ = ["STEP", "bound_of", "bounds_of", "fill_bins", "prepare"]


@compiled
def bound_of(
    link: Any,
    leaves: Any,
    sensors: Any,
    radii: Any,
    rules: Any,
    memory: Any,
    readings: Any,
    own: Any,
    found: Any,
) -> Any:
    """Return the bound of one scan [m], inf where no ball is admissible.

    Args:
        link: As for ``solve``.
        leaves: As for ``hidden``.
        sensors: (k, 10).
        radii: (2,) [m].
        rules: (3,) ε [m]; 1.0 for ``many`` obstacles, else 0; the silent bound, nan where not known yet [m].
        memory: (k, bins, 6) what was found for single echoes: bound (nan: not yet), and ``found``.
        readings: (k,) [m], inf for silence.
        own: (k,) which echoes are known to be the arm's.
        found: (5,) written: gap, centre, radius of the ball that attains it, to the search's tolerance.
    """
    error, silent = rules[0], rules[2]
    count, echoes, which, place = len(readings), 0, -1, -1
    for i in range(count):
        if readings[i] < math.inf:
            echoes += 1
            which = i
    if echoes == 1 and not own[which] and readings[which] < STEP * memory.shape[1]:
        place = int(readings[which] / STEP)
        kept = memory[which, place]
        if not math.isnan(kept[0]):
            found[:] = kept[1:]
            return kept[0]
    lows, highs, any_high = np.empty(count), np.empty(count), False
    for i in range(count):
        lows[i], highs[i] = limits(sensors[i], readings[i], error)
        if own[i]:
            highs[i] = math.inf
    if place >= 0:
        lows[which] = limits(sensors[which], place * STEP, error)[0]
        highs[which] = limits(sensors[which], (place + 1) * STEP, error)[1]
    for i in range(count):
        any_high = any_high or highs[i] < math.inf
    if not math.isnan(silent) and (rules[1] != 0.0 or not any_high):
        bound = hidden(link, leaves, sensors, lows, highs, radii, silent, found)
    else:
        bound = solve(link, sensors, lows, highs, radii, math.inf, TOLERANCE, found)
    if place >= 0:
        memory[which, place, 1:] = found
        memory[which, place, 0] = bound  # last: another thread may be reading
    return bound


@compiled
def prepare(link: Any, sensors: Any, radii: Any, rules: Any) -> Any:
    """Return ``leaves`` for ``bound_of``; none where the silent bound is not known or leaves no room."""
    free = np.empty(len(sensors))
    for i in range(len(sensors)):
        free[i] = limits(sensors[i], math.inf, rules[0])[0]
    silent = 0.0 if math.isnan(rules[2]) else rules[2]
    boxes, keys, masks = leaves_of(link, sensors, free, radii[0], silent)
    return boxes, keys, masks, free


@compiled
def bounds_of(
    link: Any, leaves: Any, sensors: Any, radii: Any, rules: Any, memory: Any, readings: Any, result: Any
) -> None:
    """Write the bounds of many scans, (n, k), into ``result``, (n,); nan where no ball is admissible."""
    found, own = np.empty(5), np.zeros(readings.shape[1], np.bool_)
    for n in range(len(readings)):
        silent = True
        for i in range(readings.shape[1]):
            silent = silent and readings[n, i] == math.inf
        if silent or (rules[1] != 0.0 and rules[2] == 0.0):
            result[n] = rules[2]
            continue
        bound = bound_of(link, leaves, sensors, radii, rules, memory, readings[n], own, found)
        result[n] = bound if bound < math.inf else math.nan


@compiled
def fill_bins(
    link: Any,
    leaves: Any,
    sensors: Any,
    radii: Any,
    rules: Any,
    memory: Any,
    readings: Any,
    own: Any,
    found: Any,
    first: int,
    last: int,
) -> None:
    """Fill ``memory`` for the bins ``first`` to ``last``, counted through all sensors; see ``bound_of``."""
    bins = memory.shape[1]
    for n in range(first, min(last, len(sensors) * bins)):
        if math.isnan(memory[n // bins, n % bins, 0]):
            readings[:] = math.inf
            readings[n // bins] = STEP * (n % bins + 0.5)
            bound_of(link, leaves, sensors, radii, rules, memory, readings, own, found)

"""Boxes round a link that one silent sensor keeps free each: what only echoes can open. Compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.compiled import compiled
from ..model.link_table import squared_minus
from .bound_box import excludes
from .sectors import cone_coordinates, sector_distance

EDGE = 0.12  # [m]; of a leaf, at least
LEAVES = 8_000  # or so, of a link with much room round it
WORD = 63  # sensors in one word of a mask


@compiled
def leaves_of(link: Any, sensors: Any, free: Any, radius: float, silent: float) -> Any:
    """Return all boxes of centres nearer than the silent bound, and which sensors clear them.

    Args:
        link: Distance table: levels, values, box, near points.
        sensors: (k, 10).
        free: (k,) sectors that silence keeps free; 0: none [m].
        radius: Of the least ball [m].
        silent: The silent bound [m].

    Returns:
        Boxes (n, 6): centre and half edges [m]; a lower bound of the gap in each [m], ascending; masks
        (n, words), with a bit for each sensor whose silence alone excludes the box.
    """
    _, _, box, _ = link
    words = (len(free) + WORD - 1) // WORD
    root = np.empty(6)
    volume = 1.0
    for a in range(3):
        root[a] = 0.5 * (box[a] + box[a + 3])
        root[a + 3] = 0.5 * (box[a + 3] - box[a]) + silent + radius
        volume *= 2.0 * root[a + 3]
    edge = max(EDGE, (volume / LEAVES) ** (1.0 / 3.0))
    size, used, open_ = 1024, 0, 1
    boxes, keys, masks = np.empty((size, 6)), np.empty(size), np.zeros((size, words), np.int64)
    stack = np.empty((256, 6))
    stack[0] = root
    mask = np.zeros(words, np.int64)
    while open_ > 0:
        open_ -= 1
        m = stack[open_].copy()
        key = _least_gap(link, m, radius)
        if key >= silent:
            continue
        side = 3
        if m[4] > m[side]:
            side = 4
        if m[5] > m[side]:
            side = 5
        is_leaf = 2.0 * m[side] <= edge
        if is_leaf:
            cleared = _mask(sensors, free, m, radius, mask)
            is_leaf = cleared or 8.0 * m[side] <= edge or used > 3 * LEAVES
        if not is_leaf:
            m[side] *= 0.5
            stack[open_] = m
            stack[open_, side - 3] -= m[side]
            stack[open_ + 1] = m
            stack[open_ + 1, side - 3] += m[side]
            open_ += 2
            continue
        if used >= size:
            size *= 2
            more_boxes, more_keys, more_masks = (
                np.empty((size, 6)),
                np.empty(size),
                np.zeros((size, words), np.int64),
            )
            more_boxes[:used], more_keys[:used], more_masks[:used] = boxes[:used], keys[:used], masks[:used]
            boxes, keys, masks = more_boxes, more_keys, more_masks
        boxes[used], keys[used], masks[used] = m, key, mask
        used += 1
    order = np.argsort(keys[:used])
    return boxes[:used][order], keys[:used][order], masks[:used][order]


@compiled
def _least_gap(link: Any, m: Any, radius: float) -> Any:
    """Return a lower bound of D − R over a box [m]; see ``bound_box.certificate``."""
    levels, values, box, _ = link
    reach2 = m[3] * m[3] + m[4] * m[4] + m[5] * m[5]
    least = math.inf
    for j in range(8):
        x, y, z = (
            m[0] + (1 - 2 * (j & 1)) * m[3],
            m[1] + (1 - (j & 2)) * m[4],
            m[2] + (1 - 0.5 * (j & 4)) * m[5],
        )
        least = min(least, squared_minus(levels, values, box, x, y, z) + (x * x + y * y + z * z) - reach2)
    x, y, z = m[0], m[1], m[2]
    middle = squared_minus(levels, values, box, x, y, z) + (x * x + y * y + z * z)
    distance = max(math.sqrt(max(0.0, least)), math.sqrt(max(0.0, middle)) - math.sqrt(reach2))
    return max(0.0, distance - radius - 1e-9)


@compiled
def _mask(sensors: Any, free: Any, m: Any, radius: float, mask: Any) -> Any:
    """Write which sensors' silence excludes a box; return whether any does."""
    mask[:] = 0
    cleared = False
    for i in range(len(free)):
        if free[i] > 0.0:
            t, b = cone_coordinates(sensors[i], m[0], m[1], m[2])
            if sector_distance(t, b, free[i]) < radius and excludes(sensors[i], free[i], m, radius):
                mask[i // WORD] |= 1 << (i % WORD)
                cleared = True
    return cleared


@compiled
def opened(masks: Any, keys: Any, lows: Any, free: Any, limit: float) -> Any:
    """Return the leaves that no silence excludes, those with the least bounds first, below ``limit``."""
    words = masks.shape[1]
    silent = np.zeros(words, np.int64)
    for i in range(len(free)):
        if lows[i] >= free[i]:
            silent[i // WORD] |= 1 << (i % WORD)
    chosen = np.empty(1024, np.int64)
    count, end = 0, np.searchsorted(keys, limit)
    for n in range(end):
        hit = 0
        for w in range(words):
            hit |= masks[n, w] & silent[w]
        if hit == 0:
            if count == len(chosen):
                more = np.empty(2 * count, np.int64)
                more[:count] = chosen
                chosen = more
            chosen[count] = n
            count += 1
    return chosen[:count]

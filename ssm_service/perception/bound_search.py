"""Branch and bound for ``lower_bound``: compiled, so import this module lazily."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.compiled import compiled
from .bound_box import box_bound, scratch

MOST = 400_000  # boxes; then the bound reached so far is returned


@compiled
def search(
    task: Any,
    roots: Any,
    starts: Any,
    order: Any,
    tolerance: float,
    smallest: float,
    most: int,
    found: Any,
) -> Any:
    """Return a lower bound of the gap of all admissible balls [m], at most ``tolerance`` or so below it.

    Boxes of centres are cut in half in the order of their bounds. The least of the bounds of the boxes still
    open is a bound of all; the search ends when it is near enough to the best ball found, or its box is tiny.

    Args:
        task: Distance table (levels, values, box, near points), sensors (k, 8), lows (k,) [m]: the sectors of
            these lengths must not be met; 0 or less: none; highs (k,) [m]: those of these must be met; inf:
            none; least and greatest radius [m].
        roots: (n, 6) centres and half edges of boxes that hold the centres in question [m].
        starts: (n,) lower bounds of the gaps in them [m].
        order: Indices of those to search, with ascending bounds.
        tolerance: [m].
        smallest: Half diagonal of boxes that are not cut further [m].
        most: Boxes to look at, at most.
        found: (5,) gap, centre and radius of a ball found; the gap inf on entry.

    Returns:
        The bound, inf where no ball is admissible, and the number of boxes looked at.
    """
    work = scratch()
    size = 1024
    boxes, keys, heap = np.empty((size, 6)), np.empty(size), np.empty(size, np.int64)
    open_, used, taken = 0, 0, 0
    while open_ > 0 or taken < len(order):
        while taken < len(order) and (open_ == 0 or starts[order[taken]] <= keys[heap[0]]):
            start = starts[order[taken]]
            if start >= found[0] - tolerance:
                if open_ == 0:
                    return min(start, found[0]), used
                taken = len(order)  # none of the others could matter
                break
            boxes[used] = roots[order[taken]]
            keys[used] = max(start, box_bound(task, boxes[used], found[0] - tolerance, work, found))
            taken += 1
            if keys[used] < found[0]:
                _rise(heap, keys, open_, used)
                open_ += 1
                used += 1
                if used + 1 >= size:
                    size *= 2
                    boxes, keys, heap = _grown(boxes, keys, heap, used, open_)
        if open_ == 0:
            break
        top = heap[0]
        bound = keys[top]
        m = boxes[top]
        if bound >= found[0] - tolerance or used >= most:
            return min(bound, found[0]), used
        if m[3] * m[3] + m[4] * m[4] + m[5] * m[5] < smallest * smallest:
            return bound, used
        open_ -= 1
        if open_ > 0:
            _sink(heap, keys, open_, heap[open_])
        if used + 1 >= size:
            size *= 2
            boxes, keys, heap = _grown(boxes, keys, heap, used, open_)
            m = boxes[top]
        side = 3
        if m[4] > m[side]:
            side = 4
        if m[5] > m[side]:
            side = 5
        m[side] *= 0.5
        place, half = m[side - 3], m[side]
        boxes[used] = m
        for child in range(2):
            index = top if child == 0 else used
            c = boxes[index]
            c[side - 3] = place - half if child == 0 else place + half
            key = max(bound, box_bound(task, c, found[0] - tolerance, work, found))
            keys[index] = key
            if key < found[0]:
                _rise(heap, keys, open_, index)
                open_ += 1
        used += 1
    return (math.inf if found[0] == math.inf else found[0]), used


@compiled
def _grown(boxes: Any, keys: Any, heap: Any, used: int, open_: int) -> Any:
    """Return larger copies of what the search holds."""
    size = 2 * len(keys)
    more_boxes, more_keys, more_heap = np.empty((size, 6)), np.empty(size), np.empty(size, np.int64)
    more_boxes[:used], more_keys[:used], more_heap[:open_] = boxes[:used], keys[:used], heap[:open_]
    return more_boxes, more_keys, more_heap


@compiled
def _rise(heap: Any, keys: Any, place: int, index: int) -> None:
    """Put ``index`` into a heap that holds ``place`` entries."""
    while place > 0:
        parent = (place - 1) // 2
        if keys[heap[parent]] <= keys[index]:
            break
        heap[place] = heap[parent]
        place = parent
    heap[place] = index


@compiled
def _sink(heap: Any, keys: Any, count: int, index: int) -> None:
    """Put ``index`` in place of the top of a heap that now holds ``count`` entries."""
    place = 0
    while True:
        child = 2 * place + 1
        if child >= count:
            break
        if child + 1 < count and keys[heap[child + 1]] < keys[heap[child]]:
            child += 1
        if keys[heap[child]] >= keys[index]:
            break
        heap[place] = heap[child]
        place = child
    heap[place] = index

"""Strata of the sweep, and the figures of each: errors against a truth, bearing errors, zones."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .common import Row
from .sweep import Arrays
from .triangulation_estimators import BOUNDS
from .triangulation_scenes import Floats

Mask = NDArray[np.bool_]

GAP_EDGES_M = (0.01, 0.05, 0.1, 0.1775, 0.355, 0.5)
AXIAL_EDGES_M = (0.0, 1.0 / 30.0, 2.0 / 30.0, 0.1)
BEARING_PARTS = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
TRUTHS = {"link": "the sensed link", "arm": "the whole arm"}
ZONES = ("red", "yellow", "green")
"""In rising order of what they allow."""


def strata(found: Arrays, noise: str, count: int) -> Iterator[tuple[str, str, Mask]]:
    """Yield kind and name of each stratum, and the scenes that belong to it.

    Args:
        found: The merged sweep of one shape.
        noise: Decides the number of echoes.
        count: Number of the ring's sensors.
    """
    yield "all", "all", np.ones(len(found["gap"]), dtype=np.bool_)
    yield from _parted("gap", found["gap"], GAP_EDGES_M, "m")
    pitch = 2.0 * math.pi / count
    aside = np.abs(found["bearing"] - pitch * np.round(found["bearing"] / pitch))
    edges = tuple(round(math.degrees(0.5 * pitch) * part, 4) for part in BEARING_PARTS)
    yield from _parted("bearing", np.degrees(aside), edges, "° off a sensor")
    yield from _parted("axial", np.abs(found["axial"]), AXIAL_EDGES_M, "m")
    echoes = found[f"{noise}.echoes"]
    yield "echoes", "0 echoes", echoes == 0
    yield "echoes", "1 echo", echoes == 1
    several = echoes >= 2
    yield "echoes", "2+ echoes", several
    for _, name, chosen in _parted("gap", found["gap"], GAP_EDGES_M, "m"):
        yield "echoes", f"2+ echoes, {name}", several & chosen


def _parted(
    kind: str, values: Floats, edges: tuple[float, ...], unit: str
) -> Iterator[tuple[str, str, Mask]]:
    for i, (low, high) in enumerate(itertools.pairwise(edges)):
        last = i == len(edges) - 2
        inside = (values >= low) & ((values <= high) if last else (values < high))
        yield kind, f"{kind} {low:.4g}–{high:.4g} {unit}", inside


def figures(
    found: Arrays, name: str, noise: str, truth: str, chosen: Mask, edges: tuple[float, float]
) -> Row:
    """Return what one estimator is worth in one stratum, errors in m, shares as fractions.

    Scenes in which the obstacle touches the link (or arm) are left out, as are those whose distance from the
    whole arm was not measured. An error is the estimate less the truth: above 0 it is on the unsafe side.

    Args:
        found: The merged sweep of one shape.
        name: The estimator.
        noise: What its readings were like.
        truth: ``link`` or ``arm``.
        chosen: The stratum.
        edges: Greatest distances of the red and the yellow zone [m].
    """
    counted = chosen & (found[truth] > 0.0)
    true, said = found[truth][counted], found[f"{noise}.{name}"][counted]
    answered = ~np.isnan(said)
    error = (said - true)[answered]
    row: Row = {
        "scenes": len(true),
        "answered": len(error),
        "answers": _ratio(len(error), len(true)),
        **_errors(error),
        **_bearings(found, name, noise, counted, answered),
        **zones(true, np.where(np.isnan(said), _unanswered(name), said), edges),
    }
    return row


def _errors(error: Floats) -> Row:
    names = ("bias", "median", "abs_p50", "abs_p95", "abs_p99", "worst_over", "worst_under", "over")
    if not len(error):
        return dict.fromkeys(names)
    p50, p95, p99 = np.percentile(np.abs(error), [50.0, 95.0, 99.0]).tolist()
    over, under = max(0.0, float(error.max())), min(0.0, float(error.min()))
    values = (float(error.mean()), float(np.median(error)), p50, p95, p99, over, under)
    return dict(zip(names, (*values, float((error > 0.0).mean())), strict=True))


def _bearings(found: Arrays, name: str, noise: str, counted: Mask, answered: Mask) -> Row:
    said = found.get(f"{noise}.{name}.bearing")
    if said is None or not answered.any():
        return {"bearing_p50_deg": None, "bearing_p95_deg": None}
    turn = (said - found["towards"])[counted][answered]
    turn = np.degrees(np.abs(np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi))
    turn = turn[~np.isnan(turn)]
    if not len(turn):
        return {"bearing_p50_deg": None, "bearing_p95_deg": None}
    p50, p95 = np.percentile(turn, [50.0, 95.0]).tolist()
    return {"bearing_p50_deg": p50, "bearing_p95_deg": p95}


def zones(true: Floats, said: Floats, edges: tuple[float, float]) -> Row:
    """Return the confusion matrix, rows Coal's zone and columns the estimate's, and the unsafe share.

    Unsafe: a milder zone than Coal's.
    """
    ours = np.searchsorted(edges, said, side="left")
    coals = np.searchsorted(edges, true, side="left")
    matrix = np.zeros((len(ZONES), len(ZONES)), dtype=np.int64)
    np.add.at(matrix, (coals, ours), 1)
    unsafe, strict = int(np.triu(matrix, 1).sum()), int(np.tril(matrix, -1).sum())
    return {
        "zones": matrix.tolist(),
        "unsafe": _ratio(unsafe, len(true)),
        "too_strict": _ratio(strict, len(true)),
    }


def _unanswered(name: str) -> float:
    """Return the distance that no answer stands for.

    Silence is green to the paper's profile; readings that contradict a bound's assumptions are a stop.
    """
    return 0.0 if name in BOUNDS else math.inf


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def all_rows(
    found: Arrays,
    shape: str,
    noises: tuple[str, ...],
    estimators: tuple[str, ...],
    count: int,
    edges: tuple[float, float],
) -> list[Row]:
    """Return a row for each noise, stratum, truth and estimator of one shape."""
    rows = []
    for noise in noises:
        for kind, stratum, chosen in strata(found, noise, count):
            for truth in TRUTHS:
                for name in estimators:
                    said = figures(found, name, noise, truth, chosen, edges)
                    where = {"shape": shape, "noise": noise, "kind": kind, "stratum": stratum}
                    rows.append({**where, "truth": truth, "estimator": name, **said})
    return rows


def touching(found: Arrays) -> Row:
    """Return the shares of scenes in which the obstacle touches the link, and the arm where measured."""
    measured = ~np.isnan(found["arm"])
    return {
        "scenes": len(found["gap"]),
        "touch_link": float((found["link"] <= 0.0).mean()),
        "arm_measured": int(measured.sum()),
        "touch_arm": _ratio(int((found["arm"][measured] <= 0.0).sum()), int(measured.sum())),
    }

"""What the text claims of the ring, asked of the sweep: who sees what, and which estimator is better."""

from __future__ import annotations

import itertools
import math

import numpy as np

from .common import Row
from .sweep import Arrays
from .triangulation_scenes import Floats
from .triangulation_strata import Mask, strata

ROUNDED = 0.005
"""The claims are whole per cents."""
UNSEEN_CLAIM, UNSEEN_ABOUT = 0.40, 0.05
SEEN_CLAIMS = ((0.0, 0.05, 0.16), (0.05, 0.1, 0.05), (0.1, math.inf, 0.0))
"""From gap, to gap [m], share of the directions that two sensors see."""
CHAMPION = "sphere_fit"
RESAMPLES = 200
UNSEEN_EDGES_M = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, math.inf)


def coverage(found: Arrays) -> list[Row]:
    """Return the shares of ball scenes that two sensors see, and none, beside what is claimed.

    'Agrees' is within four standard errors and the claim's rounding; 'about 40 %' is taken as 35 to 45 %.
    """
    echoes, gap = found["none.echoes"], found["gap"]
    rows = []
    for low, high, claim in SEEN_CLAIMS:
        inside = (gap >= low) & (gap < high)
        rows.append(_share("two sensors or more", low, high, echoes[inside] >= 2, claim, ROUNDED))
    for low, high in itertools.pairwise(UNSEEN_EDGES_M):
        inside = (gap >= low) & (gap < high)
        rows.append(_share("no sensor", low, high, echoes[inside] == 0, UNSEEN_CLAIM, UNSEEN_ABOUT))
    rows.append(_share("no sensor", 0.0, math.inf, echoes == 0, UNSEEN_CLAIM, UNSEEN_ABOUT))
    return rows


def _share(seen_by: str, low: float, high: float, hits: Mask, claim: float, rounded: float) -> Row:
    count = len(hits)
    share = float(hits.mean()) if count else None
    error = math.sqrt(max(share * (1.0 - share), 0.25 / count) / count) if share is not None else None
    agrees = None
    if share is not None and error is not None:
        agrees = abs(share - claim) <= rounded + 4.0 * error
    upper = f"{high:g}" if math.isfinite(high) else "0.5"
    return {
        "seen_by": seen_by,
        "gap": f"{low:g}–{upper} m",
        "scenes": count,
        "share": share,
        "standard_error": error,
        "claimed": claim,
        "agrees": {None: None, True: "yes", False: "NO"}[agrees],
    }


def contests(
    found: Arrays,
    shape: str,
    noises: tuple[str, ...],
    count: int,
    champion: str = CHAMPION,
    rivals: tuple[str, ...] = ("corrected", "nearest"),
) -> list[Row]:
    """Return how ``champion`` does against each rival where two or more sensors have an echo.

    Both are judged on the same scenes: those in which both answer and nothing touches the link.
    """
    rows = []
    for noise in noises:
        for kind, stratum, chosen in strata(found, noise, count):
            if kind != "echoes" or not stratum.startswith("2+"):
                continue
            for rival in rivals:
                ours, theirs = (found[f"{noise}.{name}"] for name in (champion, rival))
                both = chosen & (found["link"] > 0.0) & ~np.isnan(ours) & ~np.isnan(theirs)
                where = {"shape": shape, "noise": noise, "stratum": stratum, "rival": rival}
                rows.append({**where, **_duel(found["link"][both], ours[both], theirs[both])})
    return rows


def _duel(true: Floats, ours: Floats, theirs: Floats) -> Row:
    row: Row = {
        "scenes": len(true),
        "p50": None,
        "rival_p50": None,
        "p95": None,
        "rival_p95": None,
        "wins": None,
    }
    if len(true):
        row["p50"], row["p95"] = np.percentile(np.abs(ours - true), [50.0, 95.0]).tolist()
        row["rival_p50"], row["rival_p95"] = np.percentile(np.abs(theirs - true), [50.0, 95.0]).tolist()
        row["median"], row["rival_median"] = (float(np.median(said - true)) for said in (ours, theirs))
        median, tail = row["p50"] < row["rival_p50"], row["p95"] < row["rival_p95"]
        row["chance_p50"], row["chance_p95"] = _resampled(np.abs(ours - true), np.abs(theirs - true))
        row["wins"] = "both" if median and tail else "median" if median else "p95" if tail else "neither"
    return row


def _resampled(ours: Floats, theirs: Floats) -> tuple[float, float]:
    """Return in which share of resampled strata median and p95 are better: near 1 or 0 is beyond chance."""
    picks = np.random.default_rng(len(ours)).integers(len(ours), size=(RESAMPLES, len(ours)))
    better = np.percentile(ours[picks], [50.0, 95.0], axis=1) < np.percentile(
        theirs[picks], [50.0, 95.0], axis=1
    )
    return float(better[0].mean()), float(better[1].mean())

"""The table of ``bench.kang2022``: what each run came to, beside the paper's figures, and what follows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from .common import Row
from .kang2022_run import Run
from .kang2022_scene import CASES, FIELD, FIELD3D, FREE, FULL, PLANTS, Array, Case, robot, scene

ZONES = ("green", "yellow", "red")
IDEAL, REAL = PLANTS
PROPOSED, CONVENTIONAL = (FIELD3D, True), (FIELD, False)

PAPER_S = {
    (FREE, True, IDEAL): 8.04,
    (FREE, True, REAL): 7.96,
    (*PROPOSED, IDEAL): 16.40,
    (*PROPOSED, REAL): 16.8,
    (*CONVENTIONAL, IDEAL): 13.47,
}
"""Times to the goal [s]."""

PAPER_PATH_M = {(FREE, True, REAL): 0.011, (*PROPOSED, REAL): 0.027}
"""Greatest difference between the paths of simulation and experiment [m]."""

COLUMNS = {
    "case": "case",
    "plant": "plant",
    "arrived": "arrived",
    "time_s": "time [s]",
    "paper_s": "paper [s]",
    "left_m": "left [m]",
    "mean_green": "mean green",
    "mean_yellow": "yellow",
    "mean_red": "red",
    "most_green": "most green",
    "most_yellow": "yellow",
    "most_red": "red",
    "over_sensed": "over limit [%]",
    "over_true": "by Coal's zone [%]",
    "unseen": "near unseen [%]",
    "arm_m": "least d [m]",
    "ringed_m": "forearm's [m]",
    "contacts": "contacts",
    "path_most_m": "path diff. [m]",
    "path_mean_m": "mean [m]",
    "paper_path_m": "paper [m]",
}


def limits() -> Array:
    """Return the joints' speed limits by zone, green's infinite, (3,) [rad/s]."""
    zones = robot(IDEAL).config.file.profiles["kang2022"]
    if zones.red is None or zones.yellow is None:
        raise ValueError("profile kang2022 has no zones")
    return np.array([np.inf, zones.yellow.joint_speed_rad_s, zones.red.joint_speed_rad_s])


def zone_of(distance: Array) -> Array:
    """Return the zone of each distance [m]: 0 green, 1 yellow, 2 red."""
    zones = robot(IDEAL).config.file.profiles["kang2022"]
    return np.asarray(sum((distance <= edge).astype(np.int64) for edge in zones.edges))


def path_difference(path: Array, reference: Array) -> Array:
    """Return each point's distance from the other path, (t,) [m], however fast either was run.

    Args:
        path: (t, 3) [m].
        reference: (u, 3) [m], joined by straight lines.
    """
    begin, step = reference[:-1], np.diff(reference, axis=0)
    squared = np.maximum(np.einsum("ij,ij->i", step, step), 1e-18)
    least = []
    for point in path:
        along = np.clip(np.einsum("ij,ij->i", point - begin, step) / squared, 0.0, 1.0)
        gap = point - begin - along[:, None] * step
        least.append(float(np.sqrt(np.einsum("ij,ij->i", gap, gap).min())))
    return np.array(least)


def thinned(path: Array) -> Array:
    """Return every fifth point, a few millimetres apart, and the last one."""
    return np.vstack((path[::5], path[-1:]))


def row(runs: Sequence[Run], ideal: Run | None) -> Row:
    """Return a line of the table: the first run's figures, and of how many the goal was reached.

    Args:
        runs: Of one case, with one seed after the other.
        ideal: The ideal run of the same case, for a real one.
    """
    first = runs[0]
    case, record = first.case, first.record
    key = (case.method, case.limited, case.plant)
    speeds = np.abs(record.speeds)
    sensed, true = zone_of(record.sensed), zone_of(record.arm)
    result: Row = {
        "case": case.name,
        "plant": case.plant,
        "arrived": f"{sum(one.arrived_s is not None for one in runs)}/{len(runs)}",
        "time_s": first.arrived_s,
        "times_s": [one.arrived_s for one in runs],
        "paper_s": PAPER_S.get(key),
        "left_m": first.remaining_m,
        "over_sensed": _over(speeds, sensed),
        "over_true": _over(speeds, true),
        "unseen": 100.0 * float((true > sensed).mean()),
        "arm_m": None if case.method == FREE else float(record.arm.min()),
        "ringed_m": None if case.method == FREE else float(record.ringed.min()),
        "contacts": first.contacts,
        "contacts_all": [one.contacts for one in runs],
        "paper_path_m": PAPER_PATH_M.get(key),
    }
    for index, zone in enumerate(ZONES):
        inside = speeds[sensed == index]
        result[f"mean_{zone}"] = float(inside.mean()) if len(inside) else None
        result[f"most_{zone}"] = float(inside.max()) if len(inside) else None
    if ideal is not None:
        difference = path_difference(record.place, thinned(ideal.record.place))
        result |= {"path_most_m": float(difference.max()), "path_mean_m": float(difference.mean())}
    return result


def _over(speeds: Array, zones: Array) -> float:
    """Return the share of samples in which a joint is over its zone's limit [%]; rounding is none."""
    return 100.0 * float((speeds.max(axis=1) > limits()[zones] + 1e-9).mean())


def table(found: dict[tuple[str, bool, str], Sequence[Run]]) -> list[Row]:
    """Return all rows, by method, limits and plant."""
    rows = []
    for method, limited in CASES:
        (ideal,) = found[method, limited, IDEAL]
        rows += [row([ideal], None), row(found[method, limited, REAL], ideal)]
    return rows


def notes(rows: Sequence[Row]) -> Iterator[str]:
    """Yield what one must know to read the table, and which of the paper's claims hold here."""
    yield (
        "zones by the ring's least reading, as the paper's; mean and most: absolute speeds of all three "
        "joints [rad/s]; `over limit`: share of the samples with a joint over its zone's limit, the zone by "
        "the readings, and by Coal's exact distance of the whole arm; `near unseen`: Coal's zone is more "
        "severe than the readings'"
    )
    yield (
        f"time: to within {1e3 * scene().arrival_m:g} mm of the goal; `left`: distance from it at the end; a "
        f"run ends after {scene().horizon_s:g} s, or {scene().stuck_s:g} s in one place (stuck); a row of "
        "several runs shows the first seed's figures; contacts do not stop the arm"
    )
    yield (
        "real robot: lag of the joints, noise of the readings, a scan every 0.16 s, a link at 125 Hz "
        "(bench/kang2022.toml); path diff.: distance of its path from the ideal one's, whatever the time "
        "(the paper's, by Levenberg–Marquardt, is not described)"
    )
    by = {(r["case"], r["plant"]): r for r in rows}
    yield from _claims(by)
    yield from _reasons(by)


def _claims(by: dict[tuple[str, str], Row]) -> Iterator[str]:
    names = {
        (method, limited): _name(method, limited) for method, limited in (*CASES, PROPOSED, CONVENTIONAL)
    }
    free, ours, theirs = (names[key] for key in ((FREE, True), PROPOSED, CONVENTIONAL))
    yield _ratio("time with the obstacle over time without", by[ours, IDEAL], by[free, IDEAL], 16.40 / 8.04)
    yield _ratio("3-D with SSM over conventional without", by[ours, IDEAL], by[theirs, IDEAL], 16.40 / 13.47)
    for name, paper in ((free, 0.98), (ours, 2.38)):
        here = _percent(by[name, IDEAL]["time_s"], by[name, REAL]["time_s"])
        yield f"{name}: times of simulation and real robot differ by {here} (the paper: {paper} %)"
    with_it, real, without = (by[key] for key in ((ours, IDEAL), (ours, REAL), (theirs, IDEAL)))
    yield (
        f"only SSM keeps the zones' limits, by the readings: {with_it['over_sensed']:.2g} % of the samples "
        f"are over with it (ideal: the tick that enters a zone), {real['over_sensed']:.2g} % (real robot, "
        f"whose joints lag), {without['over_sensed']:.2g} % without; by Coal's distance "
        f"{with_it['over_true']:.2g} % are over with it: what no sensor sees slows nothing"
    )


def _reasons(by: dict[tuple[str, str], Row]) -> Iterator[str]:
    """Yield why the figures are other than the paper's, as far as the rows show it."""
    ours, theirs = _name(*PROPOSED), _name(*CONVENTIONAL)
    plain, full = _name(FIELD3D, False), _name(FULL, True)
    shown = {name: _seconds(by[name, IDEAL]["time_s"]) for name in (ours, theirs, plain, full)}
    yield (
        "why the ratios differ: an echo repels a quarter as much in the 3-D field as in the conventional one "
        f"with the same ξ and η, so the limits alone slow it ({shown[plain]} without, {shown[ours]} with), "
        f"while the conventional field is slow where its forces balance ({shown[theirs]}); at δ = 1 the 3-D "
        f"field takes {shown[full]}; the paper's δ, start, goal and place of the ball are not printed. The "
        "ball's place was chosen, of some twenty, as one with the paper's order of times: that order is no "
        "finding of this table; how it is elsewhere stands below"
    )
    yield (
        "conventional, ideal: a scan every tick and one direction only, so the arm trembles at the edge of a "
        "sensor's cone; the real robot's slow and noisy scans carry it past such places, and it takes "
        f"{_seconds(by[theirs, REAL]['time_s'])}"
    )
    yield (
        "'no blind spot' does not hold: with the 3-D field and SSM, ideal, in "
        f"{by[ours, IDEAL]['unseen']:.2g} % of the samples the ball is in a nearer zone than the ring says"
    )
    yield (
        "differences of the paths are below the paper's: the simulated robot has no load, no friction and no "
        "calibration error"
    )


def _seconds(time_s: float | None) -> str:
    return "no arrival" if time_s is None else f"{time_s:.2f} s"


def _name(method: str, limited: bool) -> str:
    return Case(method=method, limited=limited, plant=IDEAL).name


def _percent(one: float | None, other: float | None) -> str:
    if one is None or other is None:
        return "nothing that can be said, as one of them does not arrive"
    return f"{100.0 * abs(other - one) / one:.2g} %"


def _ratio(what: str, one: Row, other: Row, paper: float) -> str:
    if one["time_s"] is None or other["time_s"] is None:
        late = [row["case"] for row in (one, other) if row["time_s"] is None]
        return f"{what}: not reproduced, `{', '.join(late)}` does not arrive (the paper: {paper:.2f})"
    return f"{what}: {one['time_s'] / other['time_s']:.2f} (the paper: {paper:.2f})"

"""The numbers of ``ssm coverage`` in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from .words import counted

TOUCHING_M = 0.001
"""A ball nearer than this touches, as far as words go."""


def summary_lines(report: dict[str, Any]) -> Iterator[str]:
    """Yield the summary, line by line."""
    radius, distance = report["radius_m"], report["distance_m"]
    yield (
        f"{report['robot']}: {counted(report['sensors'], 'sensor')}, balls of {1e3 * radius:g} mm radius, "
        f"gaps to {distance:g} m, reading error {1e3 * report['reading_error_m']:g} mm"
    )
    if report["links_without_sensors"]:
        yield f"no sensors on: {', '.join(report['links_without_sensors'])}"
    for name, link in report["links"].items():
        yield ""
        yield f"{name}: {counted(link['sensors'], 'sensor')} in {counted(len(link['rings']), 'ring')}"
        yield from _clear(link, radius, distance)
        yield from _largest(link)
        yield "  seen by … sensors, share of"
        yield from _table("places round the link", link["places_by_gap"])
        yield from _table(f"bearings in the plane of ring {link['ring']}", link["ring_plane_by_gap"])
        yield from _table("bearings and offsets within ±0.1 m of it", link["ring_band_by_gap"])
        yield from _speed(link["speed"])
    yield from _search(report.get("search"))
    yield ""
    where = "no configuration" if report["position"] is None else "the given configuration"
    yield f"Computed for {where}; {report['assumes']}."


def _clear(link: dict[str, Any], radius: float, distance: float) -> Iterator[str]:
    clear = link["clear_distance"]
    proved, witness = clear["proved_m"], clear["unseen_ball_at_m"]
    if clear["no_blind_spot_to_distance"]:
        yield f"  no blind spot up to {distance:g} m: proved (nothing is unseen up to {proved:.3f} m)"
    elif witness is not None and witness < TOUCHING_M:
        yield f"  a ball of {1e3 * radius:g} mm can touch it unseen, for instance one {_at(clear)}"
    elif witness is not None and witness <= distance:
        yield f"  a ball can be {witness:.3f} m near unseen, for instance one {_at(clear)}"
    else:
        yield f"  no blind spot found up to {distance:g} m, but only proved up to {proved:.3f} m"
    if clear["no_blind_spot_to_distance"] and witness is not None:
        yield f"  the nearest unseen ball is {witness:.3f} m away, {_at(clear)}"


def _at(clear: dict[str, Any]) -> str:
    x, y, z = clear["unseen_ball_centre_m"]
    return f"centred at ({x:.3f}, {y:.3f}, {z:.3f}) m in the link's frame"


def _largest(link: dict[str, Any]) -> Iterator[str]:
    largest = link["largest_unseen_touching_ball"]
    if largest["at_most_m"] is None:
        yield f"  balls of any radius up to {largest['looked_to_m']:g} m can touch it unseen"
    else:
        low, high = 1e3 * largest["at_least_m"], 1e3 * largest["at_most_m"]
        yield (f"  smallest ball that cannot reach it unseen: radius {high:.1f} mm (one of {low:.1f} mm can)")


def _table(what: str, rows: list[dict[str, Any]]) -> Iterator[str]:
    yield f"    {what:45} {'none':>14} {'one':>14} {'two':>14} {'more':>14}"
    for row in rows:
        low, high = row["gap_m"]
        cells = [_share(row[key]) for key in ("unseen", "by_one", "by_two", "by_more")]
        yield f"      gap {low:.3f} to {high:.3f} m{'':22} {'  '.join(f'{cell:>13}' for cell in cells)}"


def _share(cell: dict[str, float]) -> str:
    return f"{100.0 * cell['share']:.1f} ±{100.0 * cell['error']:.1f} %"


def _speed(speed: dict[str, Any]) -> Iterator[str]:
    if speed["stopping_time_s"] is None:
        yield "  no speed can be said: the robot file has no stopping data, and no --stopping-time is given"
        return
    yield (
        f"  greatest closing speed that a silence justifies: {speed['greatest_m_s']:.3f} m/s; by the range "
        f"of {speed['range_m']:g} m alone, if nothing were unseen: "
        f"{speed['greatest_if_nothing_were_unseen_m_s']:.3f} m/s"
    )
    yield (
        f"    (person {speed['human_speed_m_s']:g} m/s, reaction {speed['reaction_time_s']:g} s, of which "
        f"{speed['scan_period_s']:g} s for a scan, stopping {speed['stopping_time_s']:g} s: a robot that "
        f"stands still needs {speed['standing_still_needs_m']:.3f} m)"
    )


def _search(found: dict[str, Any] | None) -> Iterator[str]:
    for name, rows in (found or {}).items():
        yield ""
        yield f"{name}: fewest sensors that close the gap, by field of view, among the plans searched"
        for row in rows:
            best = row["best"]
            start = f"  {row['field_of_view_deg']:g}°: "
            if best is None:
                yield f"{start}none of {row['plans']} plans"
                continue
            rings = ", ".join(
                f"{ring['count']} at {ring['place_m']:.3f} m tilted {ring['tilt_deg']:.0f}°"
                for ring in best["rings"]
            )
            least = " (the least)" if row["least"] else ""
            yield f"{start}{counted(best['sensors'], 'sensor')}{least}: {rings}"

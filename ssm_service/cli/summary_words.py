"""A summary in words."""

from __future__ import annotations

from typing import Any

from .words import metres


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Return a summary as lines for people."""
    rows = [*_what(summary), *_obeyed(summary), *_timing(summary)]
    return [f"{name:<16}{words}" for name, words in rows]


def _what(summary: dict[str, Any]) -> list[tuple[str, str]]:
    shares = ", ".join(f"{zone} {_percent(share)}" for zone, share in summary["zones"].items())
    exact, estimated = summary["least_exact_distance_m"], summary["least_estimated_distance_m"]
    reasons = ", ".join(f"{reason} ({count})" for reason, count in summary["reasons"].items())
    return [
        ("time", f"{summary['seconds']:.1f} s, {summary['decisions']['received']} decisions"),
        ("zones", f"{shares}; {summary['zone_changes']} changes"),
        ("least distance", f"exact {metres(exact)}, estimated {metres(estimated)}"),
        ("reasons", reasons or "none"),
    ]


def _obeyed(summary: dict[str, Any]) -> list[tuple[str, str]]:
    limits = summary["joint_speed_limits"]
    share, states = _percent(limits["obeyed_share"]), limits["joint_states"]
    longest = _milliseconds(limits["longest_excess_s"])
    greatest = _number(limits["greatest_excess_rad_s"], ".3f")
    within, commands = _percent(limits["commands_within_share"]), limits["commands"]
    return [
        (
            "limits obeyed",
            f"{share} of {states} joint states; above for at most {longest}, by {greatest} rad/s",
        ),
        ("commands", f"{within} of {commands} within their limits"),
    ]


def _timing(summary: dict[str, Any]) -> list[tuple[str, str]]:
    arrivals, stops, service = summary["decisions"], summary["watchdog_stops"], summary["service"]
    rate, worst = _number(arrivals["mean_rate_hz"], ".1f"), _milliseconds(arrivals["worst_gap_s"])
    gaps = f"{arrivals['sequence_gaps']} sequence gaps ({arrivals['lost']} lost)"
    rows = [("rate", f"{rate} decisions/s, worst gap {worst}, {gaps}")]
    if stops["count"]:
        rows.append(("watchdog", f"{stops['count']} stops of this consumer's own, {stops['seconds']:.3f} s"))
    if service is not None and service["tick_us"]:
        tick, late = service["tick_us"], service["lateness_us"]
        times = f"tick p50 {tick['p50']:.0f} µs, p99 {tick['p99']:.0f} µs"
        lateness = f"lateness p50 {late['p50']:.1f} µs, p99 {late['p99']:.0f} µs"
        rows.append(("service", f"{times}; {lateness}; {service['overruns']} overruns"))
    return rows


def _percent(share: float | None) -> str:
    if share is None:
        return "–"
    text = f"{100.0 * share:.1f} %"
    return "> 99.9 %" if text == "100.0 %" and share < 1.0 else text


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def _milliseconds(value: float | None) -> str:
    return "–" if value is None else f"{1e3 * value:.1f} ms"

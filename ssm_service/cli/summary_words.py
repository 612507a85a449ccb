"""A summary in words."""

from __future__ import annotations

import textwrap
from typing import Any, Final

from .words import counted, metres

WIDTH: Final = 80
NAME_WIDTH: Final = 16
EASY_RATE_HZ: Final = 200.0
"""A rate that a busy machine may still keep; suggested to whoever asked for more."""


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Return a summary as lines for people, none wider than 80 columns."""
    rows = [*_what(summary), *_obeyed(summary["joint_speed_limits"]), *_timing(summary), *_busy(summary)]
    return [line for name, words in rows for line in row_lines(name, words)]


def row_lines(name: str, words: str) -> list[str]:
    """Return one entry, wrapped with its words below each other."""
    return textwrap.wrap(
        words,
        WIDTH,
        initial_indent=f"{name:<{NAME_WIDTH}}",
        subsequent_indent=" " * NAME_WIDTH,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _what(summary: dict[str, Any]) -> list[tuple[str, str]]:
    shares = ", ".join(f"{zone} {_percent(share)}" for zone, share in summary["zones"].items())
    exact, estimated = summary["least_exact_distance_m"], summary["least_estimated_distance_m"]
    reasons = ", ".join(f"{reason} ({count})" for reason, count in summary["reasons"].items())
    return [
        ("time", f"{summary['seconds']:.1f} s, {counted(summary['decisions']['received'], 'decision')}"),
        ("zones", f"{shares}; {counted(summary['zone_changes'], 'change')}"),
        ("least distance", f"exact {metres(exact)}, estimated {metres(estimated)}"),
        ("reasons", reasons or "none"),
    ]


def _obeyed(limits: dict[str, Any]) -> list[tuple[str, str]]:
    within = _percent(limits["commands_within_share"])
    if limits["directed"]:
        words = f"{within} of {limits['commands']} within the limits that are safe in any direction"
        return [("commands", f"{words}; this profile does not slow what moves away")]
    rows = [("commands", f"{within} of {limits['commands']} within the speed limits sent with them")]
    falling, otherwise = limits["above_a_limit_that_had_just_fallen"], limits["above_a_limit_otherwise"]
    if limits["joint_states"] and not (falling["joint_states"] or otherwise["joint_states"]):
        rows.append(("measured speed", f"never above a limit, in {counted(limits['joint_states'], 'state')}"))
    if falling["joint_states"]:
        longest = _milliseconds(falling["longest_after_the_fall_s"])
        greatest = _number(falling["greatest_excess_rad_s"], ".3f")
        words = (
            f"above a limit that had just fallen: until at most {longest} after the change, by at most "
            f"{greatest} rad/s (the simulated arm brakes with a lag)"
        )
        if not otherwise["joint_states"]:
            words += "; never above a limit otherwise"
        rows.append(("measured speed", words))
    if otherwise["joint_states"]:
        states = counted(otherwise["joint_states"], "joint state")
        words = (
            f"{states} above a limit that had not fallen within {limits['just_fallen_s']:g} s before, "
            f"by at most {otherwise['greatest_excess_rad_s']:.3f} rad/s"
        )
        rows.append(("TOO FAST", words))
    return rows


def _timing(summary: dict[str, Any]) -> list[tuple[str, str]]:
    arrivals, stops, service = summary["decisions"], summary["watchdog_stops"], summary["service"]
    rate, worst = _number(arrivals["mean_rate_hz"], ".1f"), _milliseconds(arrivals["worst_gap_s"])
    rows = [("rate", f"{rate} decisions/s, worst gap {worst}, {arrivals['lost']} lost")]
    if arrivals["refused"]:
        causes = ", ".join(f"{cause} ({count})" for cause, count in arrivals["refused"].items())
        rows.append(("refused", f"{counted(sum(arrivals['refused'].values()), 'message')}: {causes}"))
    if stops["count"]:
        own = counted(stops["count"], "stop")
        rows.append(("watchdog", f"{own} of this consumer's own, {stops['seconds']:.3f} s in all"))
    if service is not None and service["tick_us"]:
        tick, late = service["tick_us"], service["lateness_us"]
        times = f"tick p50 {tick['p50']:.0f} µs, p99 {tick['p99']:.0f} µs"
        rows.append(("service", f"{times}; {counted(service['overruns'], 'overrun')}"))
        rows.append(
            ("lateness", f"of the service's ticks: p50 {late['p50']:.1f} µs, p99 {late['p99']:.0f} µs")
        )
    return rows


def _busy(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Say what to do about a machine that did not keep up, with the measurement that shows it."""
    if not summary["machine_too_busy"]:
        return []
    asked = summary.get("asked_rate_hz") or (summary["service"] or {}).get("rate_hz") or 0.0
    slower = f"--rate {EASY_RATE_HZ:g}" if asked > EASY_RATE_HZ else "a lower --rate"
    worst = _milliseconds(summary["decisions"]["worst_gap_s"])
    words = (
        f"this machine did not keep up with {asked:g} Hz (worst gap {worst}); try {slower}, "
        "or a quieter machine"
    )
    return [("too busy", words)]


def _percent(share: float | None) -> str:
    if share is None:
        return "–"
    text = f"{100.0 * share:.1f} %"
    return "> 99.9 %" if text == "100.0 %" and share < 1.0 else text


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def _milliseconds(value: float | None) -> str:
    return "–" if value is None else f"{1e3 * value:.1f} ms"

"""What a soak run must show, and whether it did: memory, descriptors, gaps, overruns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .soak_rig import ROLES
from .soak_samples import AFTERMATH_S, HELD_UP_S, Event, Life, Run, within

WARM_UP_S = 300.0
"""Of a process's life, at most a third of the run: caches and tables fill, threads are made."""

BLOCK_S = 30.0
"""Means of so long are what is fitted: samples after one another are not independent."""

SPAN_S = 600.0
"""Shorter than this, nothing is said of a slope: what looks like one may be a step."""

GRAIN = 256 * 1024
"""Growth over the run below which nothing can be said: allocators take memory in such pieces [bytes]."""

SIGMAS = 3.0
TICKS_OFF = 2.0
"""How far deadlines and ticks may be apart in one life of the service: the first and last are cut."""


@dataclass(frozen=True, kw_only=True)
class Slope:
    """Growth of memory, pooled over the lives of one role.

    Attributes:
        per_hour: Least squares over the blocks' means, each life with a level of its own [bytes/h].
        error: Its standard error, widened by the blocks' correlation [bytes/h].
        robust: Theil–Sen's slope of the longest life [bytes/h].
        thread: What a thread takes [bytes].
        span_s: Time over which the longest life was measured [s].
    """

    per_hour: float
    error: float
    robust: float
    thread: float
    span_s: float

    @property
    def leaks(self) -> bool:
        """Whether it grows beyond its noise, and by more than the grain, by either measure."""
        grown = min(self.per_hour, self.robust) * self.span_s / 3600.0
        return self.per_hour > SIGMAS * self.error and grown > GRAIN


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One question and its answer.

    Attributes:
        what: The question.
        ok: Whether it is as it must be; ``None`` where that cannot be said.
        says: The numbers.
    """

    what: str
    ok: bool | None
    says: str


def verdict(run: Run) -> list[Finding]:
    """Return all findings of a run."""
    return [
        *memory(run),
        *descriptors(run),
        gaps(run),
        deadlines(run),
        reported(run),
        revived(run),
        answered(run),
    ]


def others(run: Run) -> list[Finding]:
    """Return what was asked and who died."""
    return [revived(run), answered(run)]


def slope(lives: list[Life], warm_up_s: float) -> Slope | None:
    """Return the growth of memory over lives of one role; ``None`` where they are too short.

    Each life has a level of its own. Threads come and go with connections, and where memory is locked each
    takes its whole stack: what a thread takes is fitted beside the slope and taken out.
    """
    warm = [_blocks(life, life.t[0] + warm_up_s) for life in lives]
    warm = [rows for rows in warm if len(rows) >= 2]
    if not warm:
        return None
    longest = max(warm, key=lambda rows: float(rows[-1, 0] - rows[0, 0]))
    span_s = float(longest[-1, 0] - longest[0, 0])
    if span_s < SPAN_S:
        return None
    level = np.concatenate([rows - rows.mean(axis=0) for rows in warm])
    x = level[:, [0, 2]] if np.ptp(level[:, 2]) > 0.0 else level[:, [0]]
    inverse = np.linalg.pinv(x.T @ x)
    found = inverse @ (x.T @ level[:, 1])
    rest = level[:, 1] - x @ found
    freedom = max(len(x) - len(warm) - x.shape[1], 1)
    alike = float(np.clip(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-12), 0.0, 0.9))
    error = np.sqrt(rest @ rest / freedom * inverse[0, 0] * (1.0 + alike) / (1.0 - alike))
    thread = float(found[1]) if len(found) > 1 else 0.0
    return Slope(
        per_hour=3600.0 * float(found[0]),
        error=3600.0 * float(error),
        robust=3600.0 * _theil_sen(longest[:, 0], longest[:, 1] - thread * longest[:, 2]),
        thread=thread,
        span_s=span_s,
    )


def _blocks(life: Life, begin: float) -> NDArray[np.float64]:
    """Return the means of time [s], memory [bytes] and threads over blocks of a life, (k, 3)."""
    warm = life.t > begin
    rows = np.stack((life.t[warm], life.rss[warm], life.threads[warm]), axis=1)
    if not len(rows):
        return rows
    place = (rows[:, 0] - rows[0, 0]) // BLOCK_S
    return np.array([rows[place == k].mean(axis=0) for k in np.unique(place)])


def _theil_sen(t: NDArray[np.float64], rss: NDArray[np.float64]) -> float:
    from scipy.stats import theilslopes

    return float(theilslopes(rss, t).slope)


def memory(run: Run) -> list[Finding]:
    """Return whether each role's memory stays within its noise."""
    warm_up_s = min(WARM_UP_S, run.end / 3.0)
    found = []
    for role in ROLES:
        lives = [life for life in run.lives if life.role == role]
        made = slope(lives, warm_up_s)
        if made is None:
            found.append(Finding(what=f"memory, {role}", ok=None, says=f"{len(lives)} lives, all too short"))
            continue
        says = (
            f"{made.per_hour / 2**20:+.2f} ± {made.error / 2**20:.2f} MiB/h, Theil–Sen "
            f"{made.robust / 2**20:+.2f} MiB/h; {made.thread / 2**20:.1f} MiB a thread; "
            f"{len(lives)} lives, the longest for {made.span_s:.0f} s"
        )
        found.append(Finding(what=f"memory, {role}", ok=not made.leaks, says=says))
    return found


def descriptors(run: Run) -> list[Finding]:
    """Return whether each role's descriptors are the same in quiet times, first to last."""
    found, warm_s = [], min(0.2 * WARM_UP_S, run.end / 3.0)
    for role in ROLES:
        quiet = [(life, run.quiet(life.t) & (life.t > warm_s)) for life in run.lives if life.role == role]
        fds = np.concatenate([life.fds[calm] for life, calm in quiet] or [np.empty(0)])
        threads = np.concatenate([life.threads[calm] for life, calm in quiet] or [np.empty(0)])
        if len(fds) < 8:
            found.append(Finding(what=f"descriptors, {role}", ok=None, says="too few quiet samples"))
            continue
        quarter = len(fds) // 4
        first, last = np.median(fds[:quarter]), np.median(fds[-quarter:])
        says = (
            f"{first:.0f} at first, {last:.0f} at last, {fds.min():.0f} to {fds.max():.0f}; "
            f"threads {threads.min():.0f} to {threads.max():.0f}"
        )
        found.append(Finding(what=f"descriptors, {role}", ok=bool(last <= first), says=says))
    return found


def gaps(run: Run) -> Finding:
    """Return whether the consumer missed a tick while nobody kept it, the service or the network from work.

    A service that is stopped for longer than its lease has lost its connections when it goes on.
    """
    hindered = run.windows("stop consumer", "kill consumer", "stop service", "kill service")
    late = [(each["t"] - each["late_s"], each["t"] + AFTERMATH_S) for each in run.events.get("late", [])]
    counts, missed, found = {"stopped": 0, "machine": 0, "none": 0}, 0, run.events.get("gap", [])
    for gap in found:
        missed += gap["next"] - gap["after"] - 1
        if within(gap["t"], hindered):
            counts["stopped"] += 1
        elif gap["pause_s"] >= HELD_UP_S or within(gap["t"], late):
            counts["machine"] += 1
        else:
            counts["none"] += 1
    total = sum(last["messages"] for last in _last_of_each(run.events.get("consumer", [])))
    says = (
        f"{len(found)} gaps ({missed} ticks) in {total} messages: "
        f"{counts['stopped']} while it or the service was stopped, "
        f"{counts['machine']} while the machine held ordinary threads up, {counts['none']} without a cause; "
        f"the machine did so {len(late)} times"
    )
    return Finding(what="sequence gaps", ok=not counts["none"] if total else None, says=says)


def deadlines(run: Run) -> Finding:
    """Return whether every deadline was a tick or was counted as skipped, by the service's own uptime.

    A service that answers while it is late has not counted yet what it is about to count: of a few answers
    at the beginning and at the end of each life, those count that are owed the least.
    """
    lives: dict[str, list[Event]] = {}
    for health in run.events.get("health", []):
        lives.setdefault(health["producer"], []).append(health)
    off, totals = 0.0, dict.fromkeys(("ticks", "overruns", "skipped"), 0)
    for seen in lives.values():
        owed = [each["uptime_s"] * each["rate_hz"] - each["ticks"] - each["skipped"] for each in seen]
        off = max(off, abs(min(owed[-10:]) - min(owed[:10])))
        for name in totals:
            totals[name] += seen[-1][name]
    counts = ", ".join(f"{count} {name}" for name, count in totals.items())
    says = f"{counts}; at most {off:.1f} deadlines unaccounted for"
    return Finding(what="deadlines", ok=off <= TICKS_OFF if lives else None, says=says)


def reported(run: Run) -> Finding:
    """Return whether every long pause between two ticks was told as an overrun in the messages."""
    lasts = _last_of_each(run.events.get("consumer", []))
    silent = len(run.events.get("unreported", []))
    long, said = (sum(last[name] for last in lasts) for name in ("long", "overruns"))
    says = f"{said} ticks said 'overrun'; of {long} long pauses between ticks {silent} were not reported"
    return Finding(what="overruns", ok=silent == 0 if lasts else None, says=says)


def revived(run: Run) -> Finding:
    """Return whether only those died who were killed."""
    killed = [fault for fault in run.events.get("fault", []) if fault["what"].startswith("kill")]
    windows = run.windows("kill")
    deaths = [death for death in run.events.get("death", []) if not within(death["t"], windows)]
    says = f"{len(killed)} killed; {len(deaths)} died by themselves"
    said = {f"{death['role']} (status {death['status']})" for death in deaths}
    return Finding(what="deaths", ok=not deaths, says=f"{says}: {', '.join(sorted(said))}" if said else says)


def answered(run: Run) -> Finding:
    """Return how the queries went; a bound for them is nobody's promise."""
    answers = [event["t"] for kind in ("health", "evaluated") for event in run.events.get(kind, [])]
    longest = max(np.diff(sorted(answers)), default=0.0)
    without = len(run.events.get("unanswered", []))
    says = f"{len(answers)} answered, {without} not; at most {longest:.1f} s from one answer to the next"
    return Finding(what="queries", ok=None, says=says)


def _last_of_each(events: list[Event]) -> list[Event]:
    """Return each consumer's last word."""
    return list({event["pid"]: event for event in events}.values())

"""Hours of ``ssm demo``'s load with random faults: memory, descriptors, overruns and gaps over time.

Service, simulated robot and consumer run as three processes, with the service's evaluating process as a
fourth. A seeded schedule stops, kills and floods them; a share of the time nothing is done. Everything is
sampled and written at once to ``samples.jsonl``, so a run that is interrupted still has its report:
``python -m bench.soak --report FOLDER`` makes figure and verdict from what is there. Ends with status 1 where
the verdict is no.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import msgspec

from ssm_service.cli.processes import unwinding_on_termination
from ssm_service.client import Client
from ssm_service.errors import SsmError

from .common import Report, parser, progress
from .soak_faults import REST_SHARE, Injector, schedule
from .soak_figure import draw
from .soak_rig import ROLES, SAMPLES, Log, Rig, vitals
from .soak_samples import Run, read
from .soak_verdict import Finding, verdict

NOTES = f"""\
Memory is within its noise where the slope of the resident memory after the warm-up is not above three \
standard errors, by least squares over means of half a minute, with a level for each life \
and a term for the threads.
A gap has a cause where the consumer or the service was stopped or killed by this run (a service that stands \
for longer than its lease has lost its connections when it goes on), or where the machine held up its \
loop, or an ordinary thread beside it, for half as long as a decision is valid: Zenoh drops then what it \
cannot send.
Every deadline is a tick or was counted as skipped: health's counters against its uptime. A pause between \
two ticks that only an overrun explains must be told in the messages.
'–': not to be said of a run so short, or nobody's promise.
In {REST_SHARE:.0%} of the time nothing is done to anybody.\
"""
START_S = 90.0
QUESTION = {"position": [0.4, -1.1, 1.0, 0.0, 0.0, 0.0], "ranges": [0.3, *[None] * 7], "obstacles": []}


class Sampler:
    """Looks at all processes again and again, in a thread of its own.

    Args:
        rig: The processes.
        log: Gets the samples.
        every_s: Between two looks [s].
    """

    def __init__(self, rig: Rig, log: Log, every_s: float) -> None:
        self._rig, self._log, self._every_s = rig, log, every_s
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._look, self._ask)]

    def __enter__(self) -> Sampler:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(5.0)

    def _look(self) -> None:
        while not self._ended.wait(self._every_s):
            sample: dict[str, Any] = {"load": os.getloadavg()[0]}
            for role in ROLES:
                pid = self._rig.pid(role)
                seen = None if pid is None else vitals(pid)
                if seen is not None:
                    sample[role] = {"pid": pid, **seen}
            self._log.write("sample", **sample)

    def _ask(self) -> None:
        """Ask the service how it is, and keep its evaluating process at work."""
        with Client(self._rig.robot, connect=[self._rig.endpoint], timeout_s=0.5) as client:
            while not self._ended.wait(self._every_s):
                try:
                    health = client.health()
                    self._log.write("health", **msgspec.to_builtins(health))
                    if health.latched is not None:
                        self._log.write("reset", why=health.latched)
                        client.reset()
                    answers = client.evaluate([QUESTION] * 4, timeout_s=2.0)
                    self._log.write("evaluated", count=len(answers))
                except SsmError as error:
                    self._log.write("unanswered", why=str(error)[:200])


def soak(folder: Path, arguments: argparse.Namespace) -> None:
    """Run it, for as long as asked for or until Ctrl-C."""
    seconds = 60.0 * arguments.minutes
    log = Log(folder)
    service = ["--profile", arguments.profile] if arguments.profile else []
    try:
        with Rig(log, folder, arguments=service, scenario=arguments.scenario) as rig:
            log.write("settings", **_settings(arguments))
            for role in ("service", "simulation", "consumer", "witness"):
                rig.start(role)
            with Client(rig.robot, connect=[rig.endpoint]) as client:
                _wait_for(client)
                with Sampler(rig, log, arguments.every), progress() as bar:
                    task = bar.add_task("soak", total=seconds)
                    _run(rig, Injector(rig, client.connection.wait(5.0), log), seconds, arguments, bar, task)
    finally:
        log.close()


def _wait_for(client: Client) -> None:
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        with contextlib.suppress(SsmError):
            if client.zone().zone != "stop":
                return
        time.sleep(0.2)
    raise SystemExit(f"nothing but stop within {START_S:g} s; the processes' words are beside {SAMPLES}")


def _run(
    rig: Rig, injector: Injector, seconds: float, arguments: argparse.Namespace, bar: Any, task: Any
) -> None:
    begin = time.monotonic()
    faults = list(schedule(arguments.seed, seconds, kill_service=arguments.kill_service))
    while (now := time.monotonic() - begin) < seconds:
        bar.update(task, completed=now)
        rig.revive()
        if faults and now >= faults[0].at_s:
            injector.do(faults.pop(0))
        else:
            time.sleep(min(0.2, max(faults[0].at_s - now, 0.0)) if faults else 0.2)


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    names = ("seed", "minutes", "scenario", "profile", "every", "kill_service")
    return {name: getattr(arguments, name) for name in names}


def report(folder: Path) -> tuple[Report, list[Finding]]:
    """Return what a run shows, also one that was cut off."""
    run = read(folder)
    found = verdict(run)
    words = {True: "yes", False: "NO", None: "–"}
    rows = [{**dataclasses.asdict(finding), "answer": words[finding.ok]} for finding in found]
    made = Report(
        name="soak",
        settings={**run.settings, "seconds": round(run.end, 1)},
        columns={"what": "what", "answer": "as it must be", "says": "numbers"},
        rows=rows,
        notes=[*NOTES.splitlines(), f"Done to them: {_done(run)}.", _load(run)],
        draw=lambda path: draw(run, path),
    )
    return made, found


def _done(run: Run) -> str:
    counts: dict[str, int] = {}
    for fault in run.events.get("fault", []):
        counts[fault["what"]] = counts.get(fault["what"], 0) + fault["done"]
    return ", ".join(f"{what} {count}×" for what, count in sorted(counts.items())) or "nothing"


def _load(run: Run) -> str:
    loads = sorted(sample["load"] for sample in run.events.get("sample", [])) or [0.0]
    cores = len(os.sched_getaffinity(0))
    return (
        f"Load average: median {loads[len(loads) // 2]:.1f}, greatest {loads[-1]:.1f}, on {cores} cores. "
        "Much above 2 to 3 it is others' load, and gaps then say more of the machine than of the service."
    )


def _arguments() -> argparse.Namespace:
    options = parser("soak", __doc__, "minutes", 60.0, "minutes of load")
    options.add_argument("--report", type=Path, metavar="FOLDER", help="only the report of a run's folder")
    options.add_argument("--scenario", default="crossing", help="of the simulation (default: %(default)s)")
    options.add_argument("--profile", default=None, help="of the service (default: the robot file's)")
    options.add_argument("--every", type=float, default=1.0, help="s between samples (default: %(default)s)")
    options.add_argument("--kill-service", action="store_true", help="kill the service as well, now and then")
    return options.parse_args()


def main() -> None:
    """Run the benchmark."""
    arguments = _arguments()
    if arguments.report is not None:
        folder = arguments.out = arguments.report
    else:
        folder = arguments.out or Path(tempfile.mkdtemp(prefix="soak-"))
        print(f"samples go to {folder / SAMPLES}", file=sys.stderr)
        with unwinding_on_termination(), contextlib.suppress(KeyboardInterrupt):
            soak(folder, arguments)
    made, found = report(folder)
    made.finish(arguments)
    if any(finding.ok is False for finding in found):
        sys.exit("not as it must be: " + "; ".join(f.what for f in found if f.ok is False))


if __name__ == "__main__":
    main()

"""The scenes and outcomes of ``bench.avoidance`` as lines of a file, so that a run can go on where it ended.

A line counts only while what it depends on is the same: its digest is that of the settings, the robot file
and the code of the benchmark and of the method. Comments, docstrings and layout do not count, nor do packages
and what lies below the methods: kinematics, distances and the tests for collision.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from .avoidance_outcome import Outcome
from .avoidance_scenes import robot

_ROOT = Path(__file__).resolve().parents[1]
_DRAWING = ("bench/avoidance_draw.py", "bench/avoidance_scenes.py", "bench/avoidance_things.py")
_PLANNING = tuple(f"ssm_service/motion/{name}.py" for name in ("planner", "path", "free_space", "shortening"))
_RUNNING = (
    "bench/avoidance_run.py",
    "bench/avoidance_judge.py",
    "bench/avoidance_sight.py",
    "bench/avoidance_state.py",
    "ssm_service/monitor/command.py",
    *(
        f"ssm_service/motion/{name}.py"
        for name in ("limiting", "fields", "targets", "tracking", "differential")
    ),
)
_OURS = ("ssm_service/monitor/methods.py",)
_FILTER = (
    "bench/avoidance_filter.py",
    *_OURS,
    *(f"ssm_service/monitor/{name}.py" for name in ("filtering", "filter_rows")),
    *(f"ssm_service/motion/{name}.py" for name in ("filter", "barrier", "circulation", "self_collision")),
)
_CLIK = (*_OURS, "ssm_service/motion/clik.py", "ssm_service/motion/segments.py")
SOURCES = {
    "field": _OURS,
    "field3d": (*_OURS, "ssm_service/motion/field3d.py"),
    "clik-1": _CLIK,
    "clik-2": _CLIK,
    "clik-3": _CLIK,
    "filter-only": _FILTER,
    "filter": _FILTER,
    "filter+planner": (*_FILTER, *_PLANNING, "ssm_service/motion/guide.py"),
    "pink": ("bench/avoidance_peer.py",),
}
"""The code of each method, beside what all have in common."""

_OF_JUDGE = ("approach_gain", "contact_m", "margin_m")
"""What judge and peer take from the filter's settings."""


@cache
def _meaning(name: str) -> str:
    """Return a source without comments, docstrings and layout."""
    tree = ast.parse((_ROOT / name).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            kept = [one for one in body if not (isinstance(one, ast.Expr) and _is_text(one.value))]
            node.body = kept or [ast.Pass()]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _digest(settings: Sequence[Any], sources: Iterable[str]) -> str:
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for name in sorted(set(sources)):
        digest.update(f"{name} {_meaning(name)}\n".encode())
    return digest.hexdigest()[:16]


def scene_digest(seed: int, number: int) -> str:
    """Return what a drawn scene and its plan depend on.

    Changes of the tests for collision do not count: a scene stays a scene, however it was found.
    """
    settings = _settings(())
    return _digest([seed, number, settings], (*_DRAWING, *_PLANNING))


def outcome_digest(scene: dict[str, Any], method: str, horizon_s: float) -> str:
    """Return what an outcome depends on, solve times apart."""
    sources = SOURCES.get(method, ())
    settings = _settings(None if sources[:1] == _FILTER[:1] else _OF_JUDGE)
    return _digest([scene, method, horizon_s, settings], (*_RUNNING, *sources))


def _settings(of_filter: tuple[str, ...] | None) -> dict[str, Any]:
    """Return the robot file with all defaults, of the filter's settings only some; None: all."""
    values: dict[str, Any] = msgspec.to_builtins(robot().config.file)
    if of_filter is not None:
        own = values["motion"]["filter"]
        values["motion"] = values["motion"] | {"filter": {name: own[name] for name in of_filter}}
    return values


class Lines:
    """Scenes and outcomes that are done.

    Args:
        path: The file, which keeps each as it comes; None keeps them for this run only.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._kept: dict[str, dict[str, Any]] = {}
        self._torn = False
        if path is not None and path.exists():
            whole = path.read_text(encoding="utf-8")
            self._torn = not whole.endswith("\n")
            for text in whole.splitlines():
                try:
                    line = json.loads(text)
                    self._kept[line["digest"]] = line["value"]
                except (ValueError, KeyError, TypeError):
                    continue  # the end of a run that was interrupted

    def get(self, digest: str) -> dict[str, Any] | None:
        """Return what was kept under a digest."""
        return self._kept.get(digest)

    def keep(self, digest: str, value: dict[str, Any]) -> None:
        """Keep something."""
        self._kept[digest] = value
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            # A line that was cut off must not swallow this one.
            before, self._torn = "\n" if self._torn else "", False
            with self._path.open("a", encoding="utf-8") as file:
                file.write(before + json.dumps({"digest": digest, "value": value}) + "\n")


def to_value(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome as JSON values."""
    times = {str(time): count for time, count in sorted(outcome.solve_us.items())}
    return asdict(outcome) | {"solve_us": times}


def of_value(value: dict[str, Any]) -> Outcome:
    """Return the outcome that ``to_value`` wrote."""
    times = Counter({float(time): count for time, count in value["solve_us"].items()})
    return Outcome(**value | {"solve_us": times})

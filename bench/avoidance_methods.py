"""The methods that ``bench.avoidance`` compares, each as ``velocity(state)``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ssm_service.model import Robot

from .avoidance_filter import Filter
from .avoidance_peer import Pink
from .avoidance_state import Method, Service

METHODS: dict[str, Callable[[Robot], Method]] = {
    "field": lambda robot: Service(robot, "field"),
    "field3d": lambda robot: Service(robot, "field3d"),
    "clik-1": lambda robot: Service(robot, "clik-1"),
    "clik-2": lambda robot: Service(robot, "clik-2"),
    "clik-3": lambda robot: Service(robot, "clik-3"),
    "filter-only": lambda robot: Filter(robot, circulating=False),
    "filter": lambda robot: Filter(robot),
    "filter+planner": lambda robot: Filter(robot, planner=True),
    "pink": lambda robot: Pink(robot),
}


def info_of(method: Method) -> dict[str, Any]:
    """Return what a method has to say of itself after a run."""
    rescue = getattr(method, "rescue", None)
    return {"plans": rescue.plans if rescue is not None else 0, "failed": getattr(method, "failed", 0)}

"""Speed and separation monitoring for robot arms.

The three names of the README are loaded when they are first used, so that ``import ssm_service`` is cheap.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from .client import Client
    from .model import Robot
    from .monitor import Monitor

__all__ = ["Client", "Monitor", "Robot", "__version__"]

_ROOMS = {"Client": ".client", "Monitor": ".monitor", "Robot": ".model"}


def __getattr__(name: str) -> Any:
    if name not in _ROOMS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_ROOMS[name], __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

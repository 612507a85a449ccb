"""Compilation of the few inner loops that neither NumPy nor a library can take."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

_F = TypeVar("_F", bound=Callable[..., Any])


def compiled(function: _F) -> _F:
    """Return ``function`` compiled at its first call, and kept on disk where there is a place for it."""
    options = {"error_model": "numpy", "nogil": True}
    try:
        return cast(_F, numba.njit(cache=True, **options)(function))
    except RuntimeError:  # no folder for the cache can be written: compile anew in each process
        return cast(_F, numba.njit(**options)(function))

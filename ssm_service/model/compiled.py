"""Compilation of the few inner loops that neither NumPy nor a library can take.

Import this lazily: numba takes half a second.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

_F = TypeVar("_F", bound=Callable[..., Any])
_ROOMS = ("model", "perception")


def compiled(function: _F) -> _F:
    """Return ``function`` compiled at its first call, and kept on disk where there is a place for it.

    numba keeps compiled code until the file of the function itself changes. It does not look at the files
    of the functions that are called, so that an upgrade could leave old code behind in new. Here code is
    kept only until any file with compiled functions changes.
    """
    options = {"error_model": "numpy", "nogil": True}
    try:
        kept = numba.njit(cache=True, **options)(function)
        file = kept._cache._cache_file
        file._source_stamp = (file._source_stamp, sources())
        return cast(_F, kept)
    except (RuntimeError, OSError, AttributeError):
        # No folder can be written to, or numba keeps its caches in another way: each process compiles anew.
        return cast(_F, numba.njit(**options)(function))


@cache
def sources() -> str:
    """Return a digest of all sources that compiled functions may come from."""
    digest = hashlib.sha256()
    package = Path(__file__).resolve().parents[1]
    for room in _ROOMS:
        for path in sorted((package / room).glob("*.py")):
            content = path.read_bytes()
            if b"@compiled" not in content:
                continue
            digest.update(f"{room}/{path.name} {len(content)} ".encode() + content)
    return digest.hexdigest()

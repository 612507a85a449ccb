"""Tables that take seconds to make, kept on disk between runs: believed only where nothing has changed."""

from __future__ import annotations

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final


def folder() -> Path:
    """Return where tables are kept: ``ssm-service`` in the user's cache."""
    cache = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cache) if os.path.isabs(cache) else Path.home() / ".cache") / "ssm-service"


MOST: Final = 64
"""Tables that are kept; of more, the oldest are removed."""


def load(name: str, size: int) -> bytes | None:
    """Return the table of that name; None where it is missing, damaged or of another size [bytes]."""
    try:
        content = (folder() / name).read_bytes()
    except (OSError, RuntimeError):  # RuntimeError: nobody's home
        return None
    if len(content) != 32 + size or hashlib.sha256(name.encode() + content[32:]).digest() != content[:32]:
        return None
    return content[32:]


def save(name: str, content: bytes) -> bool:
    """Keep a table under a name, all at once; return whether there was a place for it."""
    try:
        place = folder()
        place.mkdir(parents=True, exist_ok=True)
        handle, path = tempfile.mkstemp(dir=place)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(name.encode() + content).digest() + content)
            os.replace(path, place / name)
        except OSError:
            with suppress(OSError):
                os.unlink(path)
            raise
        _remove_oldest(place)
    except (OSError, RuntimeError):
        return False
    return True


def _remove_oldest(place: Path) -> None:
    tables = sorted(place.glob("*-*"), key=lambda path: path.stat().st_mtime)
    for path in tables[:-MOST]:
        path.unlink(missing_ok=True)

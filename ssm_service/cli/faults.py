"""All faults of a robot file, not only the first one that loading it stops at."""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
from msgspec import inspect

from ..config import RobotConfig, RobotFile
from ..config.check import DocumentCheck
from ..config.describe import Place
from ..errors import ConfigError, shown
from ..model import DistanceModel, Robot
from .findings import Finding

MOST: Final = 50
"""Faults after which the search ends."""

_STEP: Final = re.compile(r'\.?("(?:[^"\\]|\\.)*"|[^.\[\]"]+)|\[(\d+)\]')

Step = str | int


def all_faults(path: Path, first: ConfigError) -> Iterator[Finding]:
    """Yield the faults of a file one after the other.

    After each of them the search goes on without the entry that it is about. That ends where the rest
    cannot be judged without it, which is said.

    Args:
        path: The file, which can be parsed.
        first: What loading it stopped at.
    """
    document: dict[str, Any] | None = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    removed, named, whole = Removed(), list[str](), True
    error: ConfigError | None = first
    while document is not None and error is not None and len(named) < MOST:
        steps = steps_of(error.key)
        key = removed.original(steps)
        if any(gone == key or gone.startswith((f"{key}.", f"{key}[")) for gone in named):
            whole = False  # only a consequence of what was taken out: what is round it goes as well
        else:
            yield Finding("fault", key, f"found {shown(error.found)}, allowed: {error.allowed}")
            named.append(key)
        document = removed.without(document, steps)
        error = None if document is None else _next_fault(path, document)
    if document is None or error is not None or not whole:
        what = "this; mend it" if len(named) == 1 else "these; mend them"
        yield Finding("note", "", f"not all of the file could be looked at because of {what} and check again")


class Removed:
    """What was taken out so far, so that later entries of a list are still called by their own numbers."""

    def __init__(self) -> None:
        self._of_list: dict[tuple[Step, ...], list[int]] = {}

    def without(self, document: dict[str, Any], steps: list[Step]) -> dict[str, Any] | None:
        """Return a document without the entry at ``steps``, or without the nearest entry of a list round it.

        ``None`` where there is nothing that could be taken out.
        """
        left = copy.deepcopy(document)
        holders: list[Any] = [left]
        for step in steps[:-1]:
            try:
                holders.append(holders[-1][step])
            except (KeyError, IndexError, TypeError):
                break
        for place in reversed(range(len(holders))):
            holder, step = holders[place], steps[place]
            if isinstance(holder, dict) and step in holder:
                del holder[step]
                return left
            if isinstance(holder, list) and isinstance(step, int) and step < len(holder):
                del holder[step]
                self._of_list.setdefault(tuple(steps[:place]), []).append(
                    self._original_index(tuple(steps[:place]), step)
                )
                return left
        return None

    def original(self, steps: list[Step]) -> str:
        """Return the key path ``steps`` as it is in the file itself."""
        place = Place()
        for i, step in enumerate(steps):
            if isinstance(step, int):
                place = place.item(self._original_index(tuple(steps[:i]), step))
            else:
                place = place.child(step)
        return place.key

    def _original_index(self, of: tuple[Step, ...], index: int) -> int:
        for gone in sorted(self._of_list.get(of, ())):
            index += gone <= index
        return index


def steps_of(key: str) -> list[Step]:
    """Return the steps of a dotted key path, e.g. ``rings[0].parent_frame``."""
    return [
        int(index) if index else str(json.loads(name)) if name.startswith('"') else name
        for name, index in _STEP.findall(key)
    ]


def _next_fault(path: Path, document: dict[str, Any]) -> ConfigError | None:
    try:
        DocumentCheck(path).check(document, inspect.type_info(RobotFile), Place())
        file = msgspec.convert(document, RobotFile, strict=True)
        DistanceModel(Robot(RobotConfig(name=path.stem, path=str(path.resolve()), file=file)))
    except ConfigError as error:
        return error if error.key else None
    except msgspec.ValidationError:
        return None
    return None

"""One tree of errors; each carries its data as attributes.

SsmError
├── ConfigError         a file that a person wrote is wrong: file, key, found, allowed
├── InputError          a value that arrived is wrong: cause, where, found, allowed
└── ServiceError        the network or the machine did not do what was asked
    ├── NoServiceError      nobody answered
    └── DuplicateServiceError   somebody else already serves this robot name
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


class SsmError(Exception):
    """Base of every error that this package raises on purpose."""


class ConfigError(SsmError):
    """A robot file, scenario or network configuration is wrong.

    Attributes:
        file: The file that was read.
        key: Dotted path of the offending key, empty when the file as a whole is wrong.
        found: What stands there.
        allowed: What may stand there.
    """

    def __init__(self, file: object, key: str, found: object, allowed: str) -> None:
        self.file = str(file)
        self.key = key
        self.found = found
        self.allowed = allowed
        place = f"{self.file}: {key}" if key else self.file
        super().__init__(f"{place}: found {shown(found)}, allowed: {allowed}")


class InputError(SsmError):
    """A value that arrived from outside is refused whole.

    Attributes:
        cause: One fixed word, the name of the counter in ``health`` (``wrong_length``, ``not_finite``, …).
        where: The field, e.g. ``obstacles[2].size``.
        found: What arrived.
        allowed: What is allowed there.
        fault: The fault of transmission that it shows (``corruption``, ``repetition``, ``insertion``, …), one
            fixed word; empty where the content alone is wrong.
    """

    def __init__(self, cause: str, where: str, found: object, allowed: str, *, fault: str = "") -> None:
        self.cause = cause
        self.fault = fault
        self.where = where
        self.found = found
        self.allowed = allowed
        super().__init__(f"{where}: found {shown(found)}, allowed: {allowed}")


class ServiceError(SsmError):
    """The network or the machine did not do what was asked."""


class NoServiceError(ServiceError):
    """No service answered."""


class DuplicateServiceError(ServiceError):
    """Another service already answers for this robot name."""


def shown(value: object, limit: int = 120) -> str:
    """Return ``repr(value)``, cut to ``limit`` characters, for use in an error."""
    if isinstance(value, bool):
        return "true" if value else "false"  # as TOML and JSON write them
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def listed(names: Iterable[Any]) -> str:
    """Return the names as one comma-separated phrase, in their given order."""
    return ", ".join(str(name) for name in names) or "(none)"


def suggestion(word: str, valid: Iterable[str]) -> str:
    """Return ``"did you mean 'x'? "`` for the nearest valid word, or an empty string."""
    near = difflib.get_close_matches(word, list(valid), n=1, cutoff=0.5)
    return f"did you mean '{near[0]}'? " if near else ""

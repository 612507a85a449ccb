"""Strict loading of TOML files into the structures of ``schema``."""

from __future__ import annotations

import os
import re
import threading
import tomllib
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from ..errors import ConfigError, listed, suggestion
from .check import DocumentCheck, refuse_huge_integers
from .describe import Phrase, Place
from .schema import RobotConfig, RobotFile

T = TypeVar("T")

# msgspec (0.22) works out what it must know of a type on first use, and crashes where two threads do so.
_ONE_AT_A_TIME = threading.Lock()


def robots_directory() -> Path:
    """Return the folder of the robot files that come with the package."""
    package = Path(__file__).resolve().parents[1]
    inside_wheel = package / "robots"
    return inside_wheel if inside_wheel.is_dir() else package.parent / "robots"


def robot_names() -> list[str]:
    """Return the names that ``load_robot_config`` accepts without a path, sorted."""
    return sorted(path.stem for path in robots_directory().glob("*.toml"))


def load_robot_config(name_or_path: str | Path) -> RobotConfig:
    """Read a robot file by name (``ur3``) or by path (``arms/mine.toml``).

    Raises:
        ConfigError: The file does not exist, is no TOML, has an unknown key, a wrong type or a value out
            of bounds; the message names file, key, what was found and what is allowed.
    """
    path = _find(name_or_path)
    file = load_toml(path, RobotFile)
    return RobotConfig(name=path.stem, path=str(path.resolve()), file=file)


def load_toml(path: Path, kind: type[T]) -> T:
    """Read one TOML file strictly into ``kind``, a ``msgspec.Struct``.

    Raises:
        ConfigError: As for ``load_robot_config``.
    """
    document = _parsed(path, _text(path))
    with _ONE_AT_A_TIME:
        return _converted(path, document, kind)


def _converted(path: Path, document: dict[str, Any], kind: type[T]) -> T:
    info = inspect.type_info(kind)
    if not document and isinstance(info, inspect.StructType):
        required = [field.encode_name for field in info.fields if field.required]
        if required:
            raise ConfigError(path, "", Phrase("no keys at all"), f"at least the keys {listed(required)}")
    DocumentCheck(path).check(document, info, Place())
    try:
        return msgspec.convert(document, kind, strict=True)
    except msgspec.ValidationError as error:  # what the check above does not know, in msgspec's own words
        what, _, place = str(error).partition(" - at `$")
        raise ConfigError(path, place.strip("`."), Phrase("another value"), what) from error


def _find(name_or_path: str | Path) -> Path:
    text = str(name_or_path)
    path = Path(text)
    if path.suffix == ".toml" or "/" in text:
        if not os.path.exists(path):  # unlike Path.exists, never raises, however odd the path
            names = f"an existing robot file, or a name: {listed(robot_names())}"
            raise ConfigError(text, "", Phrase("no such file"), names)
        return path
    if text not in robot_names():
        allowed = f"a name ({listed(robot_names())}) or the path of a .toml file"
        raise ConfigError("--robot", "", text, suggestion(text, robot_names()) + allowed)
    return robots_directory() / f"{text}.toml"


def _text(path: Path) -> str:
    """Read a file as UTF-8; a byte-order mark, which some editors write, is skipped."""
    try:
        data = path.read_bytes()
    except IsADirectoryError as error:
        raise ConfigError(path, "", Phrase("a folder"), "a TOML file") from error
    except OSError as error:
        raise ConfigError(path, "", Phrase(error.strerror or str(error)), "a readable TOML file") from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        found = Phrase(f"byte 0x{data[error.start]:02x} at line {line}, which is no UTF-8")
        raise ConfigError(path, "", found, "a TOML file in UTF-8") from error


def _parsed(path: Path, text: str) -> dict[str, Any]:
    try:
        document = tomllib.loads(text)
        refuse_huge_integers(path, document)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"at line (\d+)", str(error))
        lines = text.splitlines()
        line = lines[int(place[1]) - 1].strip() if place and int(place[1]) <= len(lines) else ""
        found = f"{error}: {line}" if line else str(error)
        raise ConfigError(path, "", Phrase(found), "valid TOML, in which a key stands only once") from error
    except (ValueError, RecursionError) as error:  # an integer of thousands of digits, thousands of brackets
        found = str(error).partition(";")[0]
        raise ConfigError(path, "", Phrase(found), "TOML with values of sane size") from error
    return document

"""Strict loading of TOML files into the structures of ``schema``."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from ..errors import ConfigError, listed, shown, suggestion
from .schema import RobotConfig, RobotFile

T = TypeVar("T")


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
    return RobotConfig(name=path.stem, path=str(path), file=file)


def load_toml(path: Path, kind: type[T]) -> T:
    """Read one TOML file strictly into ``kind``, a ``msgspec.Struct``.

    Raises:
        ConfigError: As for ``load_robot_config``.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(path, "", str(error), "a readable TOML file in UTF-8") from error
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(path, "", str(error), "valid TOML") from error
    _refuse_non_finite(path, document)
    _refuse_unknown_keys(path, document, inspect.type_info(kind), "")
    try:
        return msgspec.convert(document, kind, strict=True)
    except msgspec.ValidationError as error:
        raise _explained(path, document, str(error)) from error


def _find(name_or_path: str | Path) -> Path:
    text = str(name_or_path)
    path = Path(text)
    if path.suffix == ".toml" or "/" in text:
        if not path.is_file():
            raise ConfigError(text, "", "no such file", f"an existing robot file, or a name: {listed(robot_names())}")
        return path.resolve()
    if text not in robot_names():
        raise ConfigError(
            "--robot",
            "",
            text,
            f"{suggestion(text, robot_names())}a name ({listed(robot_names())}) or the path of a .toml file",
        )
    return robots_directory() / f"{text}.toml"


def _refuse_non_finite(path: Path, document: dict[str, Any]) -> None:
    for key, value in _leaves(document, ""):
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(path, key, value, "a finite number")


def _leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _leaves(inner, f"{key}[{index}]")
    else:
        yield key, value


def _refuse_unknown_keys(path: Path, value: Any, kind: inspect.Type, key: str) -> None:
    if isinstance(kind, inspect.Metadata):
        _refuse_unknown_keys(path, value, kind.type, key)
    elif isinstance(kind, inspect.UnionType):
        for option in kind.types:
            if isinstance(option, inspect.StructType | inspect.ListType | inspect.DictType):
                _refuse_unknown_keys(path, value, option, key)
    elif isinstance(kind, inspect.StructType) and isinstance(value, dict):
        fields = {field.encode_name: field.type for field in kind.fields}
        for name, inner in value.items():
            place = f"{key}.{name}" if key else name
            if name not in fields:
                allowed = f"{suggestion(name, fields)}the keys here are {listed(fields)}"
                raise ConfigError(path, place, f"unknown key '{name}'", allowed)
            _refuse_unknown_keys(path, inner, fields[name], place)
    elif isinstance(kind, inspect.ListType) and isinstance(value, list):
        for index, inner in enumerate(value):
            _refuse_unknown_keys(path, inner, kind.item_type, f"{key}[{index}]")
    elif isinstance(kind, inspect.DictType) and isinstance(value, dict):
        for name, inner in value.items():
            _refuse_unknown_keys(path, inner, kind.value_type, f"{key}.{name}")


def _explained(path: Path, document: dict[str, Any], message: str) -> ConfigError:
    """Turn msgspec's message into one that also shows the value that stands there."""
    match = re.fullmatch(r"(?P<what>.*?)(?: - at `(?:key in )?\$(?P<path>.*)`)?", message, flags=re.DOTALL)
    what, place = (match["what"], match["path"] or "") if match else (message, "")
    key = place.lstrip(".")
    return ConfigError(path, key, shown(_value_at(document, key)), what.replace("Expected ", ""))


def _value_at(document: Any, key: str) -> Any:
    """Follow a msgspec path; ``[...]`` stands for some entry of a mapping, which it does not name."""
    value = document
    for step in re.findall(r"[^.\[\]]+|\[\d+\]|\[\.\.\.\]", key):
        try:
            if step == "...":
                return value
            value = value[int(step)] if isinstance(value, list) else value[step]
        except (KeyError, IndexError, TypeError, ValueError):
            return "nothing" if isinstance(value, dict) else value
    return "this table" if isinstance(value, dict) else value

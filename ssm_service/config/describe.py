"""Words for the types of ``schema``: what may stand at a key, for errors and for the reference page."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any, TypeGuard

from msgspec import inspect

Number = inspect.IntType | inspect.FloatType
NO_UNIT = "–"


class Phrase(str):
    """Words that an error shows as they are, where a value from the file would be shown in quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A place in a file: its key path, and the unit and the meaning of what stands there."""

    key: str = ""
    unit: str = NO_UNIT
    meaning: str = ""

    def child(self, name: str) -> Place:
        """Return the place of the entry ``name`` of a table; unusual names are quoted as TOML does."""
        bare = name if re.fullmatch(r"[\w-]+", name, flags=re.ASCII) else json.dumps(name, ensure_ascii=False)
        return Place(key=f"{self.key}.{bare}" if self.key else bare, unit=self.unit, meaning=self.meaning)

    def item(self, index: int) -> Place:
        """Return the place of one entry of an array, counted from 0."""
        return Place(key=f"{self.key}[{index}]", unit=self.unit, meaning=self.meaning)


def unwrapped(kind: inspect.Type, place: Place) -> tuple[inspect.Type, Place]:
    """Strip a type of ``None``, which TOML cannot say, and of its ``Meta``, which the place takes up."""
    while isinstance(kind, inspect.Metadata):
        unit = (kind.extra or {}).get("unit", NO_UNIT)
        meaning = (kind.extra_json_schema or {}).get("description", "")
        place = Place(key=place.key, unit=unit, meaning=meaning)
        kind = kind.type
    if isinstance(kind, inspect.UnionType):
        options = [option for option in kind.types if not isinstance(option, inspect.NoneType)]
        if len(options) == 1:
            return unwrapped(options[0], place)
    return kind, place


def is_number(kind: inspect.Type) -> TypeGuard[Number]:
    """Say whether the type is a whole or a real number."""
    return isinstance(kind, inspect.IntType | inspect.FloatType)


def type_words(kind: inspect.Type, *, plural: bool = False) -> str:
    """Return the type in the words of TOML, without its bounds."""
    kind, _ = unwrapped(kind, Place())
    match kind:
        case inspect.FloatType():
            return "numbers" if plural else "number"
        case inspect.IntType():
            return "whole numbers" if plural else "whole number"
        case inspect.BoolType():
            return "true or false"
        case inspect.StrType():
            return "text"
        case inspect.LiteralType():
            return " or ".join(f"'{value}'" for value in kind.values)
        case inspect.TupleType():
            return f"array of {len(kind.item_types)} {type_words(kind.item_types[0], plural=True)}"
        case inspect.ListType():
            return f"array of {type_words(kind.item_type, plural=True)}"
        case inspect.DictType():
            return f"table of name = {type_words(kind.value_type)}"
        case inspect.StructType() | inspect.UnionType():
            return "tables" if plural else "table"
        case _:
            return "values" if plural else "value"


def bound_words(kind: inspect.Type) -> str:
    """Return the bounds of a number, or of the numbers in an array or table: ``> 0 and ≤ 2``."""
    kind, _ = unwrapped(kind, Place())
    if is_number(kind):
        signs = (">", kind.gt), ("≥", kind.ge), ("<", kind.lt), ("≤", kind.le)
        return " and ".join(f"{sign} {value:.12g}" for sign, value in signs if value is not None)
    if isinstance(kind, inspect.StrType):
        return _length_words(kind, "character", "characters")
    if isinstance(kind, inspect.TupleType):
        return _each(kind.item_types[0])
    if isinstance(kind, inspect.ListType):
        parts = _length_words(kind, "entry", "entries"), _each(kind.item_type)
    elif isinstance(kind, inspect.DictType):
        parts = _length_words(kind, "entry", "entries"), _each(kind.value_type)
    else:
        return ""
    return ", ".join(part for part in parts if part)


def allowed_words(kind: inspect.Type, place: Place) -> str:
    """Return what may stand at a place: type, bounds with unit, meaning."""
    kind, place = unwrapped(kind, place)
    words = type_words(kind)
    if not isinstance(kind, inspect.BoolType | inspect.LiteralType | inspect.StrType):
        words = f"an {words}" if words.startswith("array") else f"a {words}"
    if bounds := bound_words(kind):
        words += f" {bounds}" if is_number(kind) else f", {bounds}"
    if place.unit != NO_UNIT:
        words += f" {place.unit}" if bounds else f", in {place.unit}"
    return f"{words} ({place.meaning})" if place.meaning else words


def found_words(value: Any) -> Any:
    """Return a value as an error shows it: a table by its keys, everything else as it is."""
    if isinstance(value, dict):
        return Phrase(f"a table with the keys {', '.join(value)}" if value else "an empty table")
    return value


def _each(kind: inspect.Type) -> str:
    words = bound_words(kind)
    return f"each {words}" if words else ""


def _length_words(
    kind: inspect.StrType | inspect.ListType | inspect.DictType, singular: str, plural: str
) -> str:
    bounds = ("at least", kind.min_length or None), ("at most", kind.max_length)
    parts = [f"{sign} {n} {singular if n == 1 else plural}" for sign, n in bounds if n is not None]
    return " and ".join(parts)

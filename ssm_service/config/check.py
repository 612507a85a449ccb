"""Finds the first wrong place of a parsed TOML document and says what is allowed there.

``msgspec`` has the last word on what is valid. This walk runs before it, because ``msgspec`` names
neither the keys of mappings nor the offending value.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import msgspec
from msgspec import inspect

from ..errors import ConfigError, listed, shown, suggestion
from .describe import Number, Phrase, Place, allowed_words, found_words, unwrapped

LARGEST_INTEGER = 2**63 - 1


class DocumentCheck:
    """One document on its way through ``msgspec``; every complaint names the file and the exact key."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def check(self, value: Any, kind: inspect.Type, place: Place) -> None:
        """Check a value and all that it holds, tables before what is in them.

        Raises:
            ConfigError: At the first wrong place, in the order of the file.
        """
        kind, place = unwrapped(kind, place)
        match kind:
            case inspect.StructType():
                self._struct(value, kind, place)
            case inspect.UnionType():
                self._union(value, kind, place)
            case inspect.DictType():
                self._dict(value, kind, place)
            case inspect.ListType() | inspect.TupleType():
                self._array(value, kind, place)
            case inspect.IntType() | inspect.FloatType():
                self._number(value, kind, place)
            case inspect.BoolType() if not isinstance(value, bool):
                self._refuse(value, kind, place)
            case inspect.StrType() if not isinstance(value, str) or not _length_fits(value, kind):
                self._refuse(value, kind, place)
            case inspect.LiteralType() if not _is_one_of(value, kind.values):
                near = suggestion(value, map(str, kind.values)) if isinstance(value, str) else ""
                self._refuse(value, kind, place, near)
            case inspect.AnyType():
                self._finite(value, place)

    def _refuse(self, value: Any, kind: inspect.Type, place: Place, hint: str = "") -> NoReturn:
        raise ConfigError(self.path, place.key, found_words(value), hint + allowed_words(kind, place))

    def _struct(self, value: Any, kind: inspect.StructType, place: Place) -> None:
        if not isinstance(value, dict):
            self._refuse(value, kind, place)
        inside = Place(key=place.key)
        fields = {field.encode_name: field for field in kind.fields}
        names = [*([kind.tag_field] if kind.tag_field else []), *fields]
        for name in value:
            if name not in names and kind.forbid_unknown_fields:
                allowed = f"{suggestion(name, names)}the keys here are {listed(names)}"
                raise ConfigError(self.path, inside.child(name).key, Phrase("an unknown key"), allowed)
        for name, field in fields.items():
            if field.required and name not in value:
                found, allowed = Phrase("nothing, but it is required"), allowed_words(field.type, Place())
                raise ConfigError(self.path, inside.child(name).key, found, allowed)
        for name, inner in value.items():
            if name in fields:
                self.check(inner, fields[name].type, inside.child(name))
        self._whole(value, kind, place)

    def _whole(self, value: dict[str, Any], kind: inspect.StructType, place: Place) -> None:
        """Let ``msgspec`` build the table, whose keys are right one by one: its cross-field rules."""
        try:
            msgspec.convert(value, kind.cls, strict=True)
        except msgspec.ValidationError as error:
            rule, _, inner = str(error).partition(" - at `$.")
            if inner:  # no rule of this table: a type that this walk leaves to msgspec
                inner = inner.strip("`")
                found, key = _value_at(value, kind.cls, inner), f"{place.key}.{inner}".strip(".")
                raise ConfigError(self.path, key, found_words(found), rule) from error
            keys = dict.fromkeys(re.findall(r"`([\w.]+)`", rule))
            values = {key: _value_at(value, kind.cls, key) for key in keys}
            pairs = [f"{key} = {shown(found_words(found), 60)}" for key, found in values.items()]
            raise ConfigError(self.path, place.key, Phrase(", ".join(pairs) or "this table"), rule) from error

    def _union(self, value: Any, kind: inspect.UnionType, place: Place) -> None:
        """Check a table that is one of several kinds, which its tag tells apart."""
        kinds = [
            option for option in kind.types if isinstance(option, inspect.StructType) and option.tag_field
        ]
        if len(kinds) != len(kind.types):
            return  # a union of other things is left to msgspec
        if not isinstance(value, dict):
            self._refuse(value, kind, place)
        tags = {option.tag: option for option in kinds}
        tag_field = str(kinds[0].tag_field)
        tag = value.get(tag_field, Phrase("nothing"))
        if not _is_one_of(tag, tags):
            near = suggestion(tag, map(str, tags)) if isinstance(tag, str) else ""
            raise ConfigError(self.path, place.child(tag_field).key, tag, f"{near}one of {listed(tags)}")
        self._struct(value, tags[tag], place)

    def _dict(self, value: Any, kind: inspect.DictType, place: Place) -> None:
        if not isinstance(value, dict) or not _length_fits(value, kind):
            self._refuse(value, kind, place)
        for name, inner in value.items():
            self.check(inner, kind.value_type, place.child(name))

    def _array(self, value: Any, kind: inspect.ListType | inspect.TupleType, place: Place) -> None:
        if not isinstance(value, list):
            self._refuse(value, kind, place)
        if isinstance(kind, inspect.TupleType):
            kinds = kind.item_types
            if len(value) != len(kinds):
                self._refuse(value, kind, place)
        else:
            kinds = (kind.item_type,) * len(value)
            if not _length_fits(value, kind):
                self._refuse(value, kind, place)
        for index, (inner, item_kind) in enumerate(zip(value, kinds, strict=True)):
            self.check(inner, item_kind, place.item(index))

    def _number(self, value: Any, kind: Number, place: Place) -> None:
        real = isinstance(kind, inspect.FloatType)
        if isinstance(value, bool) or not isinstance(value, int | float if real else int):
            self._refuse(value, kind, place)
        if not math.isfinite(value):
            self._refuse(value, kind, place, "finite; ")
        if not _within(value, kind):
            self._refuse(value, kind, place)

    def _finite(self, value: Any, place: Place) -> None:
        for leaf_place, leaf in leaves(value, place):
            if isinstance(leaf, float) and not math.isfinite(leaf):
                raise ConfigError(self.path, leaf_place.key, leaf, "a finite number")


def refuse_huge_integers(path: Path, document: dict[str, Any]) -> None:
    """Refuse integers that no TOML reader need accept, and that Python may refuse even to print.

    Raises:
        ConfigError: An integer has more than 64 bits.
    """
    for place, value in leaves(document, Place()):
        if isinstance(value, int) and not -LARGEST_INTEGER - 1 <= value <= LARGEST_INTEGER:
            found = Phrase(f"an integer of {value.bit_length()} bits")
            raise ConfigError(path, place.key, found, f"an integer up to {LARGEST_INTEGER}, as in TOML")


def leaves(value: Any, place: Place) -> Iterator[tuple[Place, Any]]:
    """Walk over all values that are neither tables nor arrays, with their places."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from leaves(inner, place.child(name))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from leaves(inner, place.item(index))
    else:
        yield place, value


def _within(value: float, kind: Number) -> bool:
    return (
        (kind.gt is None or value > kind.gt)
        and (kind.ge is None or value >= kind.ge)
        and (kind.lt is None or value < kind.lt)
        and (kind.le is None or value <= kind.le)
    )


def _length_fits(value: Any, kind: inspect.StrType | inspect.ListType | inspect.DictType) -> bool:
    return (kind.min_length or 0) <= len(value) and (kind.max_length is None or len(value) <= kind.max_length)


def _is_one_of(value: Any, words: Any) -> bool:
    return isinstance(value, str | int) and not isinstance(value, bool) and value in words


def _value_at(table: dict[str, Any], cls: Any, dotted: str) -> Any:
    """Return what stands at a key of a table, or the default that holds in its place."""
    value: Any = table
    for name in dotted.split("."):
        if isinstance(value, dict):
            value = value.get(name, _default(cls, name))
        else:
            value = getattr(value, name, Phrase("nothing"))
        cls = _class_of(cls, name)
    return value


def _class_of(cls: Any, name: str) -> Any:
    for field in inspect.type_info(cls).fields if cls is not None else ():  # type: ignore[attr-defined]
        if field.encode_name == name:
            kind, _ = unwrapped(field.type, Place())
            return kind.cls if isinstance(kind, inspect.StructType) else None
    return None


def _default(cls: Any, name: str) -> Any:
    for field in msgspec.structs.fields(cls) if cls is not None else ():
        if field.encode_name == name:
            if field.default is not msgspec.NODEFAULT:
                plain = msgspec.to_builtins(field.default)
                return list(plain) if isinstance(plain, tuple) else plain
            if field.default_factory is not msgspec.NODEFAULT:
                return field.default_factory()
    return Phrase("nothing")

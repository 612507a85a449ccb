"""The reference page of all keys of a kind of file, written from its structures.

``python -m ssm_service.config.reference`` prints that of robot files; ``robots/REFERENCE.md`` holds it.
"""

from __future__ import annotations

import inspect as python_inspect
import json
import sys
from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import inspect

from .describe import Place, bound_words, type_words, unwrapped
from .schema import RobotFile

INTRODUCTION = """\
# Robot files: every key

A robot file is one TOML file that describes one robot: `ur3.toml` beside this page is a short, real one.
It is read strictly. An unknown key, a wrong type or a value out of bounds stops the program with a message
that names the file, the key, what was found and what is allowed. Numbers are finite; a whole number may
stand wherever a number is asked for. Units are SI, except for angles whose name ends in `_deg`.

In the keys below, `NAME` is a name of your choice (of a profile) or of the URDF (of a joint or link),
and `rings[]` is each entry of the array `rings`, one `[[rings]]` table in the file for each.

<!-- Written by `python -m ssm_service.config.reference > robots/REFERENCE.md` from
     ssm_service/config/schema.py. Change the schema, not this page. -->
"""

COLUMNS = ("key", "type", "unit", "bounds", "default", "meaning")


def reference(file: type[msgspec.Struct] = RobotFile, introduction: str = INTRODUCTION) -> str:
    """Return the page as Markdown, one section for each kind of table.

    Args:
        file: What a file may hold, in the manner of ``schema``.
        introduction: What the page begins with.
    """
    root = inspect.type_info(file)
    places: dict[type, list[str]] = {}
    kinds: dict[type, inspect.StructType] = {}
    for prefix, kind in _tables(root, ""):
        places.setdefault(kind.cls, []).append(prefix)
        kinds[kind.cls] = kind
    sections = [_section(kinds[cls], prefixes) for cls, prefixes in places.items()]
    return "\n".join([introduction, *sections])


def _tables(kind: inspect.Type, prefix: str) -> Iterator[tuple[str, inspect.StructType]]:
    """Walk over all tables that a type may hold, from the outside in, with their key paths."""
    kind, _ = unwrapped(kind, Place())
    if isinstance(kind, inspect.StructType):
        yield prefix, kind
        for field in kind.fields:
            yield from _tables(field.type, f"{prefix}.{field.encode_name}" if prefix else field.encode_name)
    elif isinstance(kind, inspect.ListType):
        yield from _tables(kind.item_type, f"{prefix}[]")
    elif isinstance(kind, inspect.DictType):
        yield from _tables(kind.value_type, f"{prefix}.NAME")


def _section(kind: inspect.StructType, prefixes: list[str]) -> str:
    titles = [_title(prefix) for prefix in prefixes]
    lines = [
        f"## {', '.join(titles)}",
        "",
        " ".join(python_inspect.cleandoc(kind.cls.__doc__ or "").split()),
        "",
        f"| {' | '.join(COLUMNS)} |",
        "|---" * len(COLUMNS) + "|",
    ]
    prefix = _joined(prefixes)
    lines += [_row(prefix, field) for field in kind.fields]
    return "\n".join([*lines, ""])


def _title(prefix: str) -> str:
    if not prefix:
        return "Top of the file"
    table = prefix.replace("[]", "")
    return f"`[[{table}]]`" if prefix.endswith("[]") else f"`[{table}]`"


def _joined(prefixes: list[str]) -> str:
    """Return several key paths as one: ``sources.{joints,ranges}.``."""
    if prefixes == [""]:
        return ""
    if len(prefixes) == 1:
        return prefixes[0] + "."
    parents = {prefix.rpartition(".")[0] for prefix in prefixes}
    parent = parents.pop() + "." if len(parents) == 1 else ""
    return f"{parent}{{{','.join(prefix.removeprefix(parent) for prefix in prefixes)}}}."


def _row(prefix: str, field: inspect.Field) -> str:
    kind, place = unwrapped(field.type, Place())
    name = field.encode_name + (".NAME" if isinstance(kind, inspect.DictType) else "")
    if isinstance(kind, inspect.DictType):
        kind = unwrapped(kind.value_type, Place())[0]
        type_ = f"{type_words(kind)} for each name"
    else:
        type_ = type_words(kind).replace("'", "`")
    cells = f"`{prefix}{name}`", type_, place.unit, bound_words(kind) or "–", _default(field), place.meaning
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _default(field: inspect.Field) -> str:
    if field.required:
        return "**required**"
    value = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    if value is None or value == {}:
        return "none"
    if isinstance(value, msgspec.Struct):
        if not any(inner.required for inner in msgspec.structs.fields(value)):
            return "the defaults below"
        value = msgspec.to_builtins(value)
    return f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    """Return a value as TOML writes it on one line."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{name} = {_toml(inner)}' for name, inner in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value, ensure_ascii=False)


if __name__ == "__main__":
    sys.stdout.write(reference())

"""What all tables of a robot file are made of."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct


def described(meaning: str, unit: str | None = None, **bounds: Any) -> Meta:
    """Return a key's description for errors and for the reference page, with its unit and its bounds."""
    return Meta(description=meaning, extra={"unit": unit or "–"}, **bounds)


Coordinate = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of every table in a robot file: frozen, no unknown keys."""

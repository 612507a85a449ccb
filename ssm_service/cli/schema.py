"""``ssm schema``: the messages as JSON Schemas."""

from __future__ import annotations

from .output import emit_json


def schema() -> None:
    """Print the JSON Schemas of all messages, as one document with a definition for each."""
    from ..wire import json_schemas

    emit_json(json_schemas(), indent=2)

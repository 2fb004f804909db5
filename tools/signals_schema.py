"""Write the JSON schema of signals files, derived from the classes that read them.

    python tools/signals_schema.py

Run it when a class in ``drive_id/files/messages/signal_sources.py`` changes.
"""

from __future__ import annotations

import dataclasses
import json
import types
import typing
from pathlib import Path
from typing import Any

from drive_id.files.messages.signal_sources import (
    TYPESTORES,
    Combination,
    PhaseSource,
    ReferenceSource,
    RotorSource,
    ScalarSource,
    TimeSource,
)
from drive_id.types import SCALARS

SCHEMA = Path(__file__).parent.parent / "drive_id" / "files" / "messages" / "signals.schema.json"
"""The published schema, by which editors check and complete signals files."""
_PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string"}
_DEFINITIONS: dict[str, type] = {
    "time": TimeSource,
    "phases": PhaseSource,
    "rotor": RotorSource,
    "reference": ReferenceSource,
    "scalar": ScalarSource,
}
_REQUIRED = {
    PhaseSource: ["fields"],
    ScalarSource: ["field"],
}


def signals_schema() -> dict[str, Any]:
    """Return the schema of a signals file, draft 2020-12."""
    optional = {name: {"$ref": "#/$defs/scalar"} for name in SCALARS}
    sections = {
        "defaults": ("time", "What all sections share"),
        "currents": ("phases", "Measured phase currents, A"),
        "voltages": ("phases", "Commanded phase voltages, held for one sample period from their stamp, V"),
        "resolver": ("rotor", "Rotor angle and speed"),
        "reference": ("reference", "Current references in the rotor frame, A"),
    }
    properties: dict[str, Any] = {
        name: {"$ref": f"#/$defs/{kind}", "description": said} for name, (kind, said) in sections.items()
    }
    properties["optional"] = {
        "type": "object",
        "description": "Signals that may be missing: V, degrees Celsius (twice), Nm",
        "properties": optional,
        "additionalProperties": False,
    }
    properties["typestore"] = {
        "enum": list(TYPESTORES),
        "default": "jazzy",
        "description": "ROS distribution whose message definitions serve for bags that carry none",
    }
    properties["definitions"] = {
        "type": "object",
        "description": "Further message definitions, type name to the text of its .msg file",
        "propertyNames": {"pattern": r"^\w+/msg/\w+$"},
        "additionalProperties": {"type": "string"},
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Signals file of drive_id",
        "description": "Where the signals of a drive are in a log: topics and fields of a bag, or columns.",
        "type": "object",
        "properties": properties,
        "required": ["currents", "voltages", "resolver"],
        "additionalProperties": False,
        "$defs": {name: _section(kind) for name, kind in _DEFINITIONS.items()},
    }


def schema_json() -> str:
    """Return the text of the schema's file."""
    return json.dumps(signals_schema(), indent=2) + "\n"


def _section(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    members = {item.name: _member(item, hints[item.name]) for item in dataclasses.fields(kind)}
    found: dict[str, Any] = {"type": "object", "properties": members, "additionalProperties": False}
    if kind in _REQUIRED:
        found["required"] = _REQUIRED[kind]
    return found


def _member(item: dataclasses.Field[Any], hint: Any) -> dict[str, Any]:
    """Return the schema of one field, its bounds and choices included."""
    found = _of_type(hint)
    low, high, choices, unit = (item.metadata.get(key) for key in ("minimum", "maximum", "choices", "unit"))
    bounds = {key: value for key, value in (("minimum", low), ("maximum", high)) if value is not None}
    if choices:
        found = {"enum": list(choices)}
    elif bounds:
        found = {"anyOf": [part | bounds if _is_number(part) else part for part in found.get("anyOf", [found])]}
        found = found["anyOf"][0] if len(found["anyOf"]) == 1 else found
    default = item.default
    if default is not dataclasses.MISSING and default not in ((), "", None):
        found["default"] = list(default) if isinstance(default, tuple) else default
    found["description"] = item.metadata["description"] + (f", {unit}" if unit else "")
    return found


def _is_number(part: dict[str, Any]) -> bool:
    return part.get("type") in ("number", "integer")


def _of_type(hint: Any) -> dict[str, Any]:
    if isinstance(hint, types.UnionType):
        return {"anyOf": [_of_type(part) for part in typing.get_args(hint)]}
    if typing.get_origin(hint) is tuple:
        return {"type": "array", "items": _of_type(typing.get_args(hint)[0]), "minItems": 1}
    if hint is type(None):
        return {"type": "null"}
    if hint is Combination:
        return {"type": "object", "additionalProperties": {"type": "number"}, "minProperties": 1}
    if hint is ScalarSource:
        return {"$ref": "#/$defs/scalar"}
    return {"type": _PLAIN[hint]}


if __name__ == "__main__":
    SCHEMA.write_text(schema_json(), encoding="utf-8")

"""Types of messages by name: their classes, and their definitions as a bag holds them."""

from __future__ import annotations

import importlib.util
import pkgutil
import re
from pathlib import Path
from typing import Any

from drive_id.errors import ConfigurationError

_TYPE = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9]*)", re.ASCII)
_MENTIONED = re.compile(r"(\w+)/(\w+)")
_SEPARATOR = "=" * 80


def message_class(type_name: str) -> Any:
    """Return the class of a message type, ``package/msg/Name``.

    Raises ConfigurationError when its package is not installed, or it has no such type.
    """
    found = _TYPE.fullmatch(type_name)
    if found is None:
        raise ConfigurationError(f"'{type_name}' is not the name of a message type: record topics of messages only.")
    package, name = found.groups()
    try:
        return pkgutil.resolve_name(f"{package}.msg:{name}")
    except (ImportError, AttributeError) as error:
        raise ConfigurationError(f"{type_name} is not installed: install or source {package}.") from error


def definition(type_name: str) -> str:
    """Return the complete ``ros2msg`` definition of an installed type; empty where a ``.msg`` file is missing."""
    texts: dict[str, str] = {}
    wanted = [type_name]
    while wanted:
        name = wanted.pop(0)
        if name in texts:
            continue
        file = _file(name)
        if file is None:
            return ""
        texts[name] = file.read_text(encoding="utf-8")
        fields = message_class(name).get_fields_and_field_types().values()
        wanted += [f"{package}/msg/{inner}" for kind in fields for package, inner in _MENTIONED.findall(kind)]
    own = texts.pop(type_name)
    parts = [f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in texts.items()]
    return "\n".join([own, *parts])


def _file(type_name: str) -> Path | None:
    """Return the ``.msg`` file that was installed beside the Python package of a type."""
    package, _, name = type_name.split("/")
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        return None
    for folder in Path(found.origin).resolve().parents:
        file = folder / "share" / package / "msg" / f"{name}.msg"
        if file.is_file():
            return file
    return None

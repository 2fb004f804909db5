"""Types of messages by name: their classes, and their definitions as a bag holds them."""

from __future__ import annotations

import importlib.util
import pkgutil
import re
from pathlib import Path
from typing import Any

from drive_id.errors import ConfigurationError

_TYPE = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9]*)", re.ASCII)
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)", re.ASCII)
_SEPARATOR = "=" * 80
_PRIMITIVES = {
    "bool", "byte", "char", "float32", "float64", "string", "wstring",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
}  # fmt: skip


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
        wanted += _mentioned(name, texts[name])
    own = texts.pop(type_name)
    parts = [f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in texts.items()]
    return "\n".join([own, *parts])


def _mentioned(type_name: str, text: str) -> list[str]:
    """Return the types of the fields of a definition."""
    package = type_name.partition("/")[0]
    found = []
    for line in text.splitlines():
        field = _FIELD.match(line.partition("#")[0])
        if field is None or field[1] in _PRIMITIVES:
            continue
        outer, _, name = field[1].rpartition("/")
        found.append(f"{outer.partition('/')[0] or package}/msg/{name}")
    return found


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

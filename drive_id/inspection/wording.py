"""Names of files and columns as text of a signals file."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

_YAML_WORDS = ("y", "n", "yes", "no", "on", "off", "true", "false", "null")


def quoted(name: str) -> str:
    """Return a name for YAML, quoted unless it is a plain word."""
    if re.fullmatch(r"[A-Za-z_][\w.]*", name) and name.lower() not in _YAML_WORDS:
        return name
    return json.dumps(name, ensure_ascii=not name.isprintable())


def printable(name: str) -> str:
    """Return a name for a comment, without characters that end it."""
    return "".join(letter for letter in name if letter.isprintable())


def listed(names: Sequence[str]) -> str:
    """Return names as a list for YAML."""
    return "[" + ", ".join(quoted(name) for name in names) + "]"

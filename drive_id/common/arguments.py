"""What callers of the Python interface pass: of another kind than wanted, it is refused in one sentence."""

from __future__ import annotations

import os
from pathlib import Path
from typing import cast

from drive_id.errors import ConfigurationError


def expect(value: object, kinds: type | tuple[type, ...], name: str, remedy: str) -> None:
    """Raise ConfigurationError unless an argument is of one of some kinds."""
    if not isinstance(value, kinds):
        raise ConfigurationError(f"{name} is of type {type(value).__name__}: {remedy}.")


def path_of(value: object, name: str = "path", remedy: str = "give a str or Path") -> Path:
    """Return the path that an argument is; raises ConfigurationError for anything else."""
    expect(value, (str, os.PathLike), name, remedy)
    return Path(cast("str | os.PathLike[str]", value))

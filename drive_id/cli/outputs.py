"""Where a command writes when it is not told: beside its input, and never over anything."""

from __future__ import annotations

from itertools import count
from pathlib import Path


def beside(source: Path, ending: str) -> Path:
    """Return a path beside the input, its name with an ending (``log_full``), numbered where that is taken.

    Parameters
    ----------
    source : Path
        Folder, or file, whose suffix is left out.
    ending : str
        To append; a number stands before its suffix.
    """
    where = source.absolute()
    name = where.name if where.is_dir() else where.stem
    stem, dot, suffix = ending.partition(".")
    numbered = (where.with_name(f"{name}{stem}{f'_{n}' if n > 1 else ''}{dot}{suffix}") for n in count(1))
    return next(path for path in numbered if not path.exists())

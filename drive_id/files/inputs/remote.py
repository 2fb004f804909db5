"""Recordings on object storage: each is copied to this computer for as long as it is read.

All of a recording is read, up to three times (to check, to accumulate, for its digest), so reading it piece by piece
from there would cost more.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drive_id.errors import ConfigurationError, DriveIdError, NotABagError

_URL = re.compile(r"([a-z][a-z0-9+-]+):/(.*)")


def url_of(path: Path) -> str:
    """Return the URL that became a path, which has one slash less: ``s3://bucket/bag``; empty for a file from here."""
    found = _URL.fullmatch(str(path))
    if not found:
        return ""
    root = "/" if found[1] in ("file", "local") else ""  # without a host, but with the root
    return f"{found[1]}://{root}{found[2]}"


def shown(path: Path) -> str:
    """Return a path, or the URL that became it, for a sentence."""
    return url_of(path) or str(path)


@contextmanager
def fetched(path: Path) -> Iterator[Path]:
    """Give a path that can be read here: the path itself, or that of a copy, which ends with the body.

    Errors that the body raises name the URL. Raises ConfigurationError without the extra ``remote``, and NotABagError
    when the storage does not give the recording.
    """
    url = url_of(path)
    if not url:
        yield path
        return
    try:
        import fsspec  # noqa: PLC0415  # an extra
    except ImportError as error:
        raise ConfigurationError(f"{url} needs the package fsspec: pip install 'drive_id[remote]'.") from error
    with tempfile.TemporaryDirectory(prefix="drive_id_") as folder:
        here = Path(folder) / path.name
        try:
            system, place = fsspec.core.url_to_fs(url)
            system.get(place, str(here), recursive=system.isdir(place))
        except Exception as error:  # each storage has errors of its own
            why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise NotABagError(f"{url} cannot be fetched ({why}): check the address and your access to it.") from error
        try:
            yield here
        except DriveIdError as error:
            raise type(error)(str(error).replace(str(here), url)) from error

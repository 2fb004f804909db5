"""MATLAB files in memory."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any


def mat_bytes(variables: Mapping[str, Any]) -> bytes:
    """Return a MATLAB file of version 5; nested mappings become structs, 1-D arrays rows."""
    from scipy.io import savemat  # noqa: PLC0415  # takes a quarter of a second, and only these formats need it

    stream = io.BytesIO()
    savemat(stream, dict(variables), oned_as="row", do_compression=True, long_field_names=True)
    return stream.getvalue()

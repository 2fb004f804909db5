"""Progress of long computations on a bar of tqdm, in a terminal or a notebook."""

from __future__ import annotations

from typing import Any

from drive_id.types import Progress


def on_bar(bar: Any) -> Progress:
    """Return what shows progress on a bar: ``drive_id.fit(bag, tell=drive_id.on_bar(tqdm()))``.

    Parameters
    ----------
    bar : tqdm.tqdm
        Or any object with ``total``, ``n``, ``set_description`` and ``refresh``.
    """

    def tell(what: str, share: float | None) -> None:
        bar.total, bar.n = 1.0, share or 0.0
        bar.set_description(what)
        bar.refresh()

    return tell

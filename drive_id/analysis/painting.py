"""The picture of a fit, drawn by a process of its own.

Loading matplotlib takes longer than many a fit, and keeps Python busy: here another process does it at the same time.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # so that the other process starts before this one loads numpy
    from drive_id.core.identification import FluxMap
    from drive_id.types import FloatArray

_PROGRAM = "import sys; sys.path[:] = filter(None, sys.path); from drive_id.analysis.painting import serve; serve()"
_MOST_POINTS = 20_000


class Painter:
    """Draws one picture, see :func:`~drive_id.analysis.plots.draw_flux_maps`. Use it in a ``with`` statement.

    Parameters
    ----------
    wanted : bool
        Whether there will be something to draw: if not, no process is started.

    Notes
    -----
    On a single processor, and where the process fails, the picture is drawn in this process.
    """

    def __init__(self, *, wanted: bool = True) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._pool = ThreadPoolExecutor(1, "painter")
        self._waiting: Future[tuple[bytes, bytes]] | None = None
        if wanted and sys.executable and len(os.sched_getaffinity(0)) > 1:
            command = [sys.executable, "-c", _PROGRAM]
            pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
            with suppress(OSError):
                self._process = subprocess.Popen(
                    command, stdin=pipe, stdout=pipe, stderr=nowhere, start_new_session=True
                )

    def __enter__(self) -> Painter:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process:
            self._process.kill()
            self._pool.shutdown()  # whoever waits for the process, does so no longer
            with self._process:  # closes the pipes and waits
                pass

    def begin(self, flux_map: FluxMap, i_max: float, i_dq: FloatArray, title: str) -> None:
        """Let the picture be drawn while this process goes on; once."""
        self._wanted = flux_map, i_max, i_dq[:: max(1, len(i_dq) // _MOST_POINTS)], title
        if self._process:
            request = pickle.dumps(self._wanted)
            self._waiting = self._pool.submit(self._process.communicate, request)

    def picture(self) -> bytes:
        """Return the picture that was begun, as PNG."""
        if self._waiting and self._process:
            png, _ = self._waiting.result()
            if self._process.returncode == 0:
                return png
        return paint(*self._wanted)


def paint(flux_map: FluxMap, i_max: float, i_dq: FloatArray, title: str) -> bytes:
    """Draw in this process."""
    from drive_id.analysis.plots import draw_flux_maps, to_png  # noqa: PLC0415  # matplotlib takes half a second

    return to_png(draw_flux_maps(flux_map, i_max, i_dq, title))


def serve() -> None:
    """Load everything, then draw what standard input asks for; nothing when it ends without asking."""
    from matplotlib.figure import Figure  # noqa: PLC0415  # see above

    from drive_id.analysis.plots import to_png  # noqa: PLC0415

    blank = Figure()
    blank.suptitle(r"$\psi_\mathrm{d}$ / Wb")
    to_png(blank)  # loads fonts
    request = sys.stdin.buffer.read()
    if request:
        sys.stdout.buffer.write(paint(*pickle.loads(request)))
        sys.stdout.flush()
        os._exit(0)  # somebody waits, and tidying up takes half as long as drawing

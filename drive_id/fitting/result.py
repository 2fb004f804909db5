"""What :func:`drive_id.fit` and :func:`drive_id.load` return: a result that draws, saves and reports itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from drive_id.common.arguments import path_of
from drive_id.files.results.identification import write_results
from drive_id.result.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FigureFormat = Literal["png", "svg", "pdf", "pgf"]


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Result):
    """An identified drive: what :func:`drive_id.fit` and :func:`drive_id.load` return.

    Parameters
    ----------
    drive : drive_id.core.result.identification.IdentifiedDrive
        The numbers.
    provenance : Provenance
        Inputs, settings, and what is known of the experiment besides.
    excerpts : tuple of Samples
        Of the recordings, for pictures; empty when the result was loaded.
    truth : GroundTruth or None
        Of a simulation; None when the result was loaded.
    last_stamp : int
        Of the last sample, ns; 0 when the result was loaded.
    stored : Diagnostics or None
        Residuals, simulated currents and the paper's methods on the same data, where they are known already; see
        :attr:`diagnostics`.
    evidence : Evidence or None
        Sums over all samples for the paper's methods; None: formed when needed, if the excerpts are all samples.
    """

    def save(
        self,
        directory: str | Path,
        *,
        force: bool = False,
        draw: bool = False,
        report: bool = False,
        figure_format: FigureFormat = "png",
        style: str = "screen",
    ) -> None:
        """Write a result folder, as ``drive-id fit`` does; :func:`drive_id.load` reads it.

        Parameters
        ----------
        directory : path
            Created when missing; an earlier result of the same recordings in it is replaced.
        force : bool
            Replace the result of other recordings, and write into a folder that holds other files.
        draw : bool
            Write pictures, too, and what the paper's methods make of the data, for reports of the folder.
        report : bool
            The same, and ``report.html``.
        figure_format : {"png", "svg", "pdf", "pgf"}
            Of the pictures.
        style : {"screen", "ieee"}
            Of the pictures; ``ieee`` is one column of a journal: 3.5 in wide, serif, without caption and trajectory.

        Raises
        ------
        OutputError
            When the folder is not ours to write, or cannot be written.
        """
        target = path_of(directory, "directory")
        compared = draw or report or "diagnostics" in self.__dict__
        judged = self.diagnostics if compared else self._judged(compared=False)
        files: dict[str, bytes] = {}
        if draw or report:
            from drive_id.result.pictures.plots import result_pictures  # noqa: PLC0415  # matplotlib takes half a second

            drawn = self.drive, self.excerpts, self.caption()
            files |= result_pictures(*drawn, figure_format=figure_format, style=style)
        if report:
            from drive_id.reporting.page.report import report_files  # noqa: PLC0415  # only it needs plotly and jinja2

            files |= report_files(self)
        write_results(target, self.drive, self.provenance, force=force, pictures=files, diagnostics=judged)

    def report(self, path: str | Path, *, pdf: bool = False) -> tuple[Path, ...]:
        """Write a report, as ``drive-id report`` does: one HTML file that needs nothing else.

        Parameters
        ----------
        path : path
            Of the HTML file; an earlier report is replaced.
        pdf : bool
            Write a PDF of the same name beside it, too.

        Returns
        -------
        tuple of Path
            The files that were written.

        Raises
        ------
        OutputError
            When something else is under this name, or it cannot be written.
        """
        from drive_id.reporting.page.report import write_report  # noqa: PLC0415  # matplotlib takes half a second

        return write_report(self, path_of(path), pdf=pdf)

    def plot(self, ax: Sequence[Axes] | None = None, *, style: str = "screen") -> Figure:
        """Draw both flux linkages over the current plane, and the trajectory where excerpts of it are kept.

        Parameters
        ----------
        ax : two matplotlib.axes.Axes, optional
            For psi_d and psi_q. Default: those of a new figure.
        style : {"screen", "ieee"}
            As in :meth:`save`.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it; ``savefig`` saves it.
        """
        from drive_id.result.pictures.plots import draw_flux_maps, trajectory  # noqa: PLC0415  # matplotlib takes half a second

        return draw_flux_maps(self.flux_map, self.i_max, trajectory(self.excerpts), self.caption(), ax, style=style)

    def _repr_png_(self) -> bytes:
        """Return the picture of :meth:`plot`, for notebooks and exports of them."""
        from drive_id.result.pictures.picture import SCREEN_DPI, rendered  # noqa: PLC0415  # matplotlib takes half a second

        return rendered(self.plot(), dpi=SCREEN_DPI)


def load(directory: str | Path) -> Identification:
    """Load a result folder that ``drive-id fit``, :func:`drive_id.fit` or a node wrote.

    Parameters
    ----------
    directory : path

    Returns
    -------
    Identification

    Raises
    ------
    ResultError
        When it is not a result folder, is damaged, or was written by a newer version.
    """
    return Identification.load(directory)


def report(
    result: Identification | str | Path,
    path: str | Path,
    *,
    pdf: bool = False,
    pole_pairs: int | None = None,
    u_dc: float | None = None,
) -> tuple[Path, ...]:
    """Write a report, see :meth:`Identification.report`.

    Parameters
    ----------
    result : Identification or path
        Or its folder.
    pole_pairs : int, optional
        Default: those of the result.
    u_dc : float, optional
        DC-link voltage, V. Default: that of the result.

    Returns
    -------
    tuple of Path
        The files that were written.
    """
    found = result if isinstance(result, Identification) else load(result)
    return found.given(pole_pairs=pole_pairs, u_dc=u_dc).report(path, pdf=pdf)

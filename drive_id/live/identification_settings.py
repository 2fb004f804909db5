"""Settings of the identification node besides those of the fit."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.settings import check, setting


@dataclass(frozen=True)
class IdentificationSettings:
    """Folders of recordings and results, and what is kept of the live samples."""

    data_directory: str = setting(
        "recordings", "Folder of the recordings that may be requested; relative to the working directory"
    )
    output_directory: str = setting(
        "identifications",
        "Folder in which each fit makes a new one; relative to the working directory",
    )
    picture: bool = setting(False, "Draw the maps beside the result files; takes about a second")
    refit_share: float = setting(
        0.1,
        "Share of one core for fits of the live samples in the background, which make replies short; 0: none",
        minimum=0.0,
        maximum=1.0,
    )
    provisional_map_period: float = setting(
        0.0,
        "Time between provisional flux maps of the live samples, published while they arrive; 0: none",
        unit="s",
        minimum=0.0,
        maximum=3600.0,
    )
    frame_id: str = setting("drive", "Name of the drive in the header of the flux map")

    def __post_init__(self) -> None:
        check(self)

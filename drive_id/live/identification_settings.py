"""Settings of the identification node, beside those of the fit."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.settings import check, setting


@dataclass(frozen=True)
class IdentificationSettings:
    """Where recordings come from, where results go to, and what is kept of the live samples."""

    data_directory: str = setting(
        "recordings", "Folder of the recordings that may be asked for; a relative one is below the working directory"
    )
    output_directory: str = setting(
        "identifications",
        "Folder in which each fit makes one of its own; a relative one is below the working directory",
    )
    picture: bool = setting(False, "Draw the maps beside the result files, which takes about a second")
    frame_id: str = setting("drive", "Name of the drive in the header of the flux map")

    def __post_init__(self) -> None:
        check(self)

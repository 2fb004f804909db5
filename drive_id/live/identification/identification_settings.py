"""Settings of the identification node besides those of the fit."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.common.settings import Checked, setting


@dataclass(frozen=True)
class IdentificationSettings(Checked):
    """Folders of recordings and results, and what is kept of the live samples."""

    data_directory: str = setting(
        "recordings", "Folder of the recordings that may be requested; relative to the working directory"
    )
    output_directory: str = setting(
        "identifications", "Folder in which each fit makes a new one; relative to the working directory"
    )
    signals: str = setting("", "Signals file of a bench with topics of its own; empty: our messages")
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
    time_limit: float = setting(
        3600.0, "Longest time for one request, after which it is ended; 0: unlimited", unit="s",
        minimum=0.0, maximum=1e6,
    )  # fmt: skip
    results_count: int = setting(
        1000, "Number of result folders above which the oldest are removed; 0: unlimited", minimum=0, maximum=1_000_000
    )
    results_size: float = setting(
        10_000.0, "Size of all result folders above which the oldest are removed; 0: unlimited", unit="MB",
        minimum=0.0, maximum=1e9,
    )  # fmt: skip
    operating_point_rate: float = setting(
        50.0, "Rate of operating_point while somebody listens; 0: none", unit="Hz", minimum=0.0, maximum=1000.0
    )
    frame_id: str = setting("drive", "Name of the drive in the header of the flux map")

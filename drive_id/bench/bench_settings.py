"""Everything that can be chosen about a simulated bench beyond the drive itself."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.settings import check, setting


@dataclass(frozen=True)
class BenchSettings:
    """Settings of the simulated bench."""

    machine: str = setting("ipm", "Shipped machine by name, or a machine file (.npz, SyR-e .mat)")
    block_size: int = setting(100, "Samples per message", minimum=1, maximum=10_000)
    time_scale: float = setting(
        1.0,
        "Speed of simulated against real time; other than 1, this node publishes /clock, and all others must set "
        "use_sim_time",
        minimum=0.001,
        maximum=100.0,
    )
    zero_slew_rate: float = setting(
        10000.0, "|di/dt| to zero current when references run out", unit="A/s", minimum=1.0, maximum=1e9
    )
    frame_id: str = setting("drive", "Name of the drive in the blocks' headers")
    truth_file: str = setting("", "File for the truth about the simulated machine (.npz); empty: none is written")

    def __post_init__(self) -> None:
        check(self)

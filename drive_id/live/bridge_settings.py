"""Settings of the node that translates a bench's own topics."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.settings import Checked, setting


@dataclass(frozen=True)
class BridgeSettings(Checked):
    """Signals file and blocks of the bridge."""

    signals: str = setting("", "Signals file that names the bench's topics and fields; required")
    block_period: float = setting(
        0.01, "Time between blocks: shorter ones arrive earlier and cost more", unit="s", minimum=1e-3, maximum=1.0
    )
    queue_depth: int = setting(
        5000, "Messages of each topic that may wait while the node is busy", minimum=1, maximum=1_000_000
    )
    frame_id: str = setting("drive", "Name of the drive in the headers")

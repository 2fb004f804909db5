"""Settings of the recorder."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.common.settings import Checked, setting


@dataclass(frozen=True)
class RecordingSettings(Checked):
    """Where and how live samples are recorded; the fields' metadata describe them."""

    data_directory: str = setting(
        "recordings", "Folder for all recordings; a relative path starts at the working directory"
    )
    compression: str = setting("zstd", "Compression of the chunks", choices=("zstd", "lz4", "none"))
    chunk_size: int = setting(
        65536, "Size of a chunk before compression; a damaged chunk is lost completely", unit="byte",
        minimum=4096, maximum=131072,
    )  # fmt: skip
    flush_period: float = setting(
        1.0, "Longest time until samples are on disk; at most this much is lost if recorder or computer fail",
        unit="s", minimum=0.05, maximum=60.0,
    )  # fmt: skip
    max_file_size: float = setting(
        0.0, "File size at which the recording continues in a new file; 0: never", unit="MB", minimum=0.0, maximum=1e6
    )
    max_file_duration: float = setting(
        0.0, "Duration after which the recording continues in a new file; 0: never", unit="s", minimum=0.0, maximum=1e6
    )
    queue_size: float = setting(
        64.0, "Buffer for messages waiting for a slow disk; when it is full, messages are dropped and counted",
        unit="MB", minimum=0.01, maximum=4096.0,
    )  # fmt: skip
    queue_depth: int = setting(
        5000, "Messages per topic that the middleware may queue for the recorder", minimum=1000, maximum=100000
    )
    least_free_space: float = setting(
        200.0, "Free space of the disk below which a recording is ended and none begins; below ten times as much, "
        "diagnostics warn; 0: neither", unit="MB", minimum=0.0, maximum=1e9,
    )  # fmt: skip
    lease_time: float = setting(
        5.0, "Longest time without a heartbeat on ~/heartbeat, if any came during the recording, which then ends; "
        "longer than lease_time of trajectory_publisher, whose ramp to zero belongs to the recording", unit="s",
        minimum=0.1, maximum=60.0,
    )  # fmt: skip
    silence: float = setting(
        2.0, "Time without a message after which diagnostics warn during a recording; 0: never", unit="s",
        minimum=0.0, maximum=3600.0,
    )  # fmt: skip

    state_topics: tuple[str, ...] = setting(
        ("drive_status", "trajectory_publisher/state", "fit_report"),
        "Topics that tell what happened meanwhile: recorded where somebody publishes them",
    )
    extra_topics: tuple[str, ...] = setting(
        (), "Further topics to record, of any type; the type is looked up when the topic has a publisher"
    )

    def __post_init__(self) -> None:
        for name in ("state_topics", "extra_topics"):
            object.__setattr__(self, name, tuple(getattr(self, name)))  # lists, as files hold them
        super().__post_init__()

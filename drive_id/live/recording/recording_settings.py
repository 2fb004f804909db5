"""Settings of the recorder."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.settings import check, setting


@dataclass(frozen=True)
class RecordingSettings:
    """Where and how live samples are recorded; the fields' metadata describe them."""

    data_directory: str = setting(
        "recordings", "Folder in which all recordings are made; a relative one is below the working directory"
    )
    compression: str = setting("zstd", "Compression of the chunks", choices=("zstd", "lz4", "none"))
    chunk_size: int = setting(
        65536, "Size of a chunk before compression; a damaged one is lost as a whole", unit="byte",
        minimum=4096, maximum=131072,
    )  # fmt: skip
    flush_period: float = setting(
        1.0, "Time after which everything is on the disk; so much is lost when the recorder or the computer dies",
        unit="s", minimum=0.05, maximum=60.0,
    )  # fmt: skip
    max_file_size: float = setting(
        0.0, "Size from which the recording goes on in another file; 0: never", unit="MB", minimum=0.0, maximum=1e6
    )
    max_file_duration: float = setting(
        0.0, "Time after which the recording goes on in another file; 0: never", unit="s", minimum=0.0, maximum=1e6
    )
    queue_size: float = setting(
        64.0, "Memory for messages that wait for a slow disk; what comes when it is full is lost, and counted",
        unit="MB", minimum=0.01, maximum=4096.0,
    )  # fmt: skip
    queue_depth: int = setting(
        5000, "Messages per topic that may wait for the recorder in the middleware", minimum=1000, maximum=100000
    )
    silence: float = setting(
        2.0, "Time without a message after which diagnostics warn of a topic while recording; 0: never", unit="s",
        minimum=0.0, maximum=3600.0,
    )  # fmt: skip

    extra_topics: tuple[str, ...] = setting(
        (), "Further topics to record, of any type; the type is looked up when somebody publishes"
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "extra_topics", tuple(self.extra_topics))  # a list, as files hold it
        check(self)

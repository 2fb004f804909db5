"""Settings of a managed node."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.settings import check, setting


@dataclass(frozen=True)
class ManagedSettings:
    """Who brings a managed node up."""

    autostart: bool = setting(True, "Configure and activate the node at its start, without a lifecycle manager")

    def __post_init__(self) -> None:
        check(self)

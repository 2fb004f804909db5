"""Settings of a managed node."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.settings import Checked, setting


@dataclass(frozen=True)
class ManagedSettings(Checked):
    """Who brings a managed node up."""

    autostart: bool = setting(True, "Configure the node at its start, without a lifecycle manager")
    activate: bool = setting(True, "Activate it as well; false: it subscribes and waits to be activated")

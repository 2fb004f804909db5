"""Every shipped file in config/ loads, and the one of defaults holds the defaults."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from drive_id.bench.settings import SimulationSettings
from drive_id.common.settings import from_mapping
from drive_id.core.fit_settings import FitSettings
from drive_id.files.messages.signals_file import read_signals

CONFIG = Path(__file__).parent.parent / "config"
LOADERS = {
    "fit": lambda path: from_mapping(FitSettings, yaml.safe_load(path.read_text()), path.name),
    "signals": read_signals,
    "simulation": lambda path: from_mapping(SimulationSettings, yaml.safe_load(path.read_text()), path.name),
}


FILES = [path for path in sorted(CONFIG.iterdir()) if path.stem.split("_")[0] in LOADERS]  # the nodes' are tested there


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_shipped_files_load(path):
    LOADERS[path.stem.split("_")[0]](path)


def test_the_file_of_fit_settings_names_all_of_them_with_their_defaults():
    path = CONFIG / "fit.yaml"
    assert LOADERS["fit"](path) == FitSettings()
    assert set(yaml.safe_load(path.read_text())) == set(FitSettings.__dataclass_fields__)

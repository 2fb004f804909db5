"""Settings from plain values: what is taken, what is refused, and in which words."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import get_args, get_type_hints

import numpy as np
import pytest

from drive_id.bench.faults import FaultSettings
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.common.settings import Checked, from_mapping, setting
from drive_id.core.experiment.encoder import Encoder
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.recording.recording_settings import RecordingSettings
from drive_id.live.translator import BridgeSettings


@dataclass(frozen=True)
class Everything(Checked):
    """One field of each kind."""

    flag: bool = setting(False, "a flag")
    count: int = setting(3, "a count", minimum=1, maximum=10)
    size: float = setting(1.5, "a size", unit="A", minimum=0.0)
    name: str = setting("a", "a name", choices=("a", "b"))
    optional: float | None = setting(None, "may be missing", maximum=2.0)
    limit: int | None = setting(4, "may be missing")
    either: float | str | None = setting(None, "a number or a path")
    several: tuple[float, ...] = setting((), "any number", minimum=0.0)
    three: tuple[int, int, int] = setting((1, 2, 3), "of each phase")


def refused(mapping: dict, said: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        from_mapping(Everything, mapping, "file.yaml")
    text = str(caught.value)
    assert said in text
    assert "file.yaml" in text
    assert text.endswith((".", "?"))
    assert "\n" not in text
    assert len(text) < 300


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"several": 4.0}, r"several is 4\.0: it must be a sequence, as \(4\.0,\)"),
        ({"several": [-1.0]}, "several is -1"),
        ({"size": "large"}, "size is 'large': it must be a number"),
    ],
)
def test_values_of_another_kind_in_python_are_refused(given, said):
    with pytest.raises(ConfigurationError, match=said):
        Everything(**given)


def test_nothing_given_is_the_defaults():
    assert from_mapping(Everything, {}, "file.yaml") == Everything()


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("flag", True, True),
        ("count", 10, 10),
        ("size", 2, 2.0),
        ("size", "1e-3", 1e-3),
        ("size", 0.0, 0.0),
        ("name", "b", "b"),
        ("optional", None, None),
        ("optional", 2, 2.0),
        ("limit", None, None),
        ("limit", 5, 5),
        ("either", "state.period", "state.period"),
        ("either", 3, 3.0),
        ("either", None, None),
        ("several", [], ()),
        ("several", [1, 2.5, "1e3"], (1.0, 2.5, 1000.0)),
        ("several", (1.0,), (1.0,)),
        ("three", [4, 5, 6], (4, 5, 6)),
    ],
)
def test_values_are_taken(name, given, expected):
    value = getattr(from_mapping(Everything, {name: given}, "file.yaml"), name)
    assert value == expected
    assert type(value) is type(expected)
    if isinstance(expected, tuple):
        assert [type(entry) for entry in value] == [type(entry) for entry in expected]


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        ({"flags": True}, "'flags' in file.yaml does not exist: did you mean 'flag'?"),
        ({1: True}, "'1' in file.yaml does not exist"),
        ({None: True}, "'None' in file.yaml does not exist"),
        ({"flag": 1}, "'flag' in file.yaml is 1: it must be true or false."),
        ({"flag": "yes"}, "it must be true or false"),
        ({"flag": None}, "it must be true or false"),
        ({"count": 2.0}, "'count' in file.yaml is 2.0: it must be a whole number."),
        ({"count": "2"}, "it must be a whole number"),
        ({"count": True}, "it must be a whole number"),
        ({"count": None}, "it must be a whole number"),
        ({"count": 0}, "count is 0: it must be at least 1 and at most 10."),
        ({"count": 11}, "count is 11: it must be at least 1 and at most 10."),
        ({"count": 10**400}, "count is 1000"),
        ({"count": 10**5000}, "count is an enormous number"),
        ({"size": True}, "it must be a number"),
        ({"size": "large"}, "'size' in file.yaml is 'large': it must be a number."),
        ({"size": [1.0]}, "it must be a number"),
        ({"size": {"a": 1}}, "it must be a number"),
        ({"size": -1}, "size is -1.0 A: it must be at least 0.0 A."),
        ({"size": float("nan")}, "size is nan: it must be a finite number"),
        ({"size": float("inf")}, "size is inf: it must be a finite number"),
        ({"size": "nan"}, "size is nan: it must be a finite number"),
        ({"size": 10**400}, "it must be a number"),
        ({"size": 5000 * "x"}, "xxx...: it must be a number"),
        ({"name": "c"}, "name is 'c': it must be one of a, b."),
        ({"name": 1}, "'name' in file.yaml is 1: it must be text."),
        ({"optional": 2.5}, "optional is 2.5: it must be at most 2.0."),
        ({"optional": "a"}, "it must be a number or null."),
        ({"limit": 1.5}, "it must be a whole number or null."),
        ({"either": [1]}, "it must be a number or text or null."),
        ({"several": 1.0}, "'several' in file.yaml is 1.0: it must be a list of numbers."),
        ({"several": "12"}, "it must be a list of numbers."),
        ({"several": None}, "it must be a list of numbers."),
        ({"several": [1.0, None]}, "is None: it must be a number"),
        ({"several": [1.0, -1.0]}, "several is -1.0: it must be at least 0.0."),
        ({"several": [1.0, float("nan")]}, "several is nan: it must be a finite number."),
        ({"three": [1, 2]}, "'three' in file.yaml is [1, 2]: it must be a list of 3 whole numbers."),
        ({"three": [1, 2, 3, 4]}, "it must be a list of 3 whole numbers."),
        ({"three": [1, 2, 3.5]}, "is 3.5: it must be a whole number."),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_values_are_refused(mapping, said):
    refused(mapping, said)


def test_a_misspelt_setting_is_guessed():
    with pytest.raises(ConfigurationError) as caught:
        from_mapping(SimulationSettings, {"iron_conductanse": 0.1}, "file.yaml")
    text = str(caught.value)
    assert text == "'iron_conductanse' in file.yaml does not exist: did you mean 'iron_conductance'?"


def test_the_constructor_checks_bounds_without_naming_a_file():
    with pytest.raises(ConfigurationError, match=r"^count is 0: it must be at least 1 and at most 10\.$"):
        Everything(count=0)


@pytest.mark.parametrize("order", [2, 97])
def test_orders_of_harmonics_lie_from_three_to_96(order):
    assert FitSettings(harmonic_orders=(3, 96)).harmonic_orders == (3, 96)
    with pytest.raises(ConfigurationError, match=f"harmonic_orders is {order}: it must be at least 3 and at most 96"):
        FitSettings(harmonic_orders=(6, order))


def test_numbers_of_numpy_are_numbers():
    assert Everything(size=np.float64(2.0)).size == 2.0
    with pytest.raises(ConfigurationError, match="finite"):
        Everything(size=np.float64("nan"))


@pytest.mark.parametrize("settings", [FitSettings, SimulationSettings])
def test_every_setting_of_ours_is_described_and_its_default_within_bounds(settings):
    for name, field in settings.__dataclass_fields__.items():
        assert field.metadata["description"], name
    plain = {name: getattr(settings(), name) for name in settings.__dataclass_fields__}
    assert from_mapping(settings, plain, "defaults") == settings()


OF_NODES = [
    RecordingSettings, IdentificationSettings, BridgeSettings, FitSettings, ExperimentSettings, BenchSettings,
    SimulationSettings, FaultSettings, Encoder,
]  # fmt: skip


@pytest.mark.parametrize("cls", OF_NODES)
def test_every_number_that_is_a_parameter_of_a_node_has_a_range(cls):
    hints = get_type_hints(cls)
    numbers = [each for each in fields(cls) if {int, float} & {hints[each.name], *get_args(hints[each.name])}]
    assert numbers
    for each in numbers:
        assert each.metadata["minimum"] < each.metadata["maximum"], each.name

"""The published schema is that of the code, accepts every shipped signals file, and refuses what the reader refuses."""

from __future__ import annotations

import dataclasses
import json
import re
import runpy
from pathlib import Path

import jsonschema
import pytest

from drive_id.errors import ConfigurationError
from drive_id.files.messages.signal_sources import PhaseSource, ReferenceSource, RotorSource, ScalarSource
from drive_id.files.messages.signals_file import _parsed_yaml, parse_signals

ROOT = Path(__file__).parents[3]
TOOL = runpy.run_path(str(ROOT / "tools" / "signals_schema.py"))
SCHEMA = TOOL["SCHEMA"]
SHIPPED = sorted((ROOT / "config").glob("signals*.yaml"))
COLUMNS = """\
currents: {fields: [a, b]}
voltages: {fields: [u, v], frame: alpha_beta}
resolver: {angle: enc, angle_unit: counts, counts_per_turn: 4096, mechanical: true, pole_pairs: 3}
"""


@pytest.fixture(scope="module")
def validator():
    jsonschema.Draft202012Validator.check_schema(json.loads(SCHEMA.read_text(encoding="utf-8")))
    return jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text(encoding="utf-8")))


def test_the_published_schema_is_that_of_the_code():
    """Else: python tools/signals_schema.py."""
    assert SCHEMA.read_text(encoding="utf-8") == TOOL["schema_json"]()


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_every_shipped_file_is_valid(path, validator):
    tree, _ = _parsed_yaml(path.read_text(encoding="utf-8"), path.name)
    validator.validate(tree)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("frame: alpha_beta", "frame: ab"),
        ("enc,", "enc, direction: 2,"),
        ("[a, b]", "[a, 3]"),
        ("[a, b]", "[a, b], stamp_bits: 4"),
        ("currents:", "current:"),
        ("[a, b]", "[a, b], sample_perod: 1"),
        ("pole_pairs: 3", "pole_pairs: 0"),
        ("[u, v]", "[u, v], scale: {topic: /x}"),
    ],
)
def test_what_the_reader_refuses_is_invalid(old, new, validator):
    good, _ = _parsed_yaml(COLUMNS, "f")
    validator.validate(good)
    parse_signals(COLUMNS, "f")
    changed = COLUMNS.replace(old, new)
    assert changed != COLUMNS
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(_parsed_yaml(changed, "f")[0])
    with pytest.raises(ConfigurationError):
        parse_signals(changed, "f")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[a, b]", "[a, b], sample_perod: 1e-4", "did you mean 'sample_period'"),
        ("enc,", "enc, polepairs: 4,", "did you mean 'pole_pairs'"),
        ("currents:", "curents:", "did you mean 'currents'"),
        ("[u, v]", "[u, v], scale: {feld: u}", "did you mean 'field'"),
        ("resolver:", "optional: {dc_link: {field: u}}\nresolver:", "did you mean 'dc_link_voltage'"),
        ("resolver:", "defaults: {stmp: t}\nresolver:", "did you mean 'stamp'"),
    ],
)
def test_an_unknown_key_is_named_with_its_nearest_neighbour(old, new, said):
    with pytest.raises(ConfigurationError, match=said):
        parse_signals(COLUMNS.replace(old, new), "f")


def test_the_reference_page_and_the_examples_name_every_setting():
    page = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")
    examples = "".join(path.read_text(encoding="utf-8") for path in SHIPPED)
    for kind in (PhaseSource, RotorSource, ReferenceSource, ScalarSource):
        for item in dataclasses.fields(kind):
            assert f"| `{item.name}` |" in page, item.name
            assert re.search(rf"\b{item.name}: ", examples), item.name


def test_the_annotated_draft_of_the_page_can_be_read():
    page = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")
    (draft,) = re.findall(r"^```yaml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert parse_signals(draft, "logs.md").resolver.pole_pairs == 4

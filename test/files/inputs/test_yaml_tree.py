"""YAML: what PyYAML reads, and nothing that grows, crashes or lasts."""

from __future__ import annotations

import time

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from drive_id.files.inputs.yaml_tree import load_yaml

LAUGHS = "a0: &a0 [x, x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
MERGES = "b0: &b0 {x: 1}\n" + "".join(f"b{k}: &b{k} {{<<: [*b{k - 1}, *b{k - 1}]}}\n" for k in range(1, 40))


@pytest.mark.parametrize(
    "text", ["", "a: 1", "[1, 2.5, x]", "a: &x {b: 2}\nc: *x\nd: {<<: *x, e: 1}", "--- |\n text\n", "a: 1:30:15"]
)
def test_what_pyyaml_reads(text):
    assert load_yaml(text) == yaml.safe_load(text)


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.text("ab: \n#'"), st.lists, max_leaves=20))
def test_what_pyyaml_writes(tree):
    assert load_yaml(yaml.safe_dump(tree)) == tree


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "nested too deeply"),
        ("\n".join(" " * k + "a:" for k in range(200)), "nested too deeply"),
        (LAUGHS, "aliases"),
        (MERGES, "aliases"),
        ("a: &a [*a]", "contains itself"),
        ("[" + "a," * 1000 + "]", "too many entries"),
        ("a: 1" + ":1" * 100_000, "number of many digits"),
    ],
)
def test_what_is_refused_at_once(text, said):
    start = time.process_time()
    with pytest.raises(ValueError, match=said):
        load_yaml(text, 1000)
    assert time.process_time() - start < 2.0


@pytest.mark.parametrize("text", ["{", "a: b: c", "a: \x01", "\t- x", "!!python/object:os.system x"])
def test_what_is_no_yaml(text):
    with pytest.raises(yaml.YAMLError):
        load_yaml(text)
